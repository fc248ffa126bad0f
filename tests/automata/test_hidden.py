"""Beliefs and sets, compared with an enumeration of all paths."""

import itertools

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, settings, strategies as st

from jaxcell.automata import Belief, HiddenMap, expected_entropy


def random_map(seed, cells=4):
    """Draw a map of two configurations and one angle."""
    rng = np.random.default_rng(seed)
    both = rng.dirichlet(np.ones(2 * cells) / 3, cells)
    both[both < 0.05] = 0
    both /= both.sum(axis=1, keepdims=True)
    start = rng.dirichlet(np.ones(cells))
    return HiddenMap.of(both[:, :cells], both[:, cells:], np.arange(cells) // 2, start)


def all_paths(hidden, observations):
    """Compute the joint probability of every path and the observations."""
    parts = [part.toarray() for part in (hidden.moves, *hidden.bumps)]
    paths = {}
    for path in itertools.product(range(hidden.cells), repeat=len(observations) + 1):
        probability = hidden.start[path[0]]
        for (a, b), o in zip(itertools.pairwise(path), observations, strict=True):
            probability *= parts[o][a, b]
        paths[path] = probability
    return paths


cases = given(st.integers(0, 10_000), st.lists(st.integers(0, 1), min_size=1, max_size=4))
few = settings(max_examples=30, deadline=None)


@few
@given(st.integers(0, 10_000), st.lists(st.integers(0, 2), min_size=1, max_size=4), st.booleans())
def test_beliefs_are_those_of_all_paths(seed, events, turning):
    hidden = map_with_angles(seed) if turning else random_map(seed)
    events = events if turning else np.minimum(events, 1).tolist()
    paths, belief = all_paths(hidden, events), Belief(hidden)
    total = sum(paths.values())
    if total == 0:
        for find in (belief.smoothed, belief.likeliest_path):
            with pytest.raises(ValueError, match="expected a run that is possible on the map"):
                find(events)
        return
    weight = np.zeros((len(events) + 1, hidden.cells))
    for path, probability in paths.items():
        for time, cell in enumerate(path):
            weight[time, cell] += probability / total
    np.testing.assert_allclose(belief.smoothed(events), weight, atol=1e-12)
    best = belief.likeliest_path(events)
    assert paths[tuple(best.tolist())] == pytest.approx(max(paths.values()))
    if turning:
        return
    state = belief.start()
    for observation in events:
        state = belief.observe(state, observation)
    here = state.weight.sum()
    np.testing.assert_allclose(state.weight / here, weight[-1], atol=1e-12)
    assert here + state.nowhere == pytest.approx(1)


@few
@cases
def test_nowhere_is_the_posterior_of_getting_lost_at_any_time(seed, observations):
    hidden = random_map(seed)
    state = Belief(hidden).start()
    for observation in observations:
        state = Belief(hidden).observe(state, observation)
    # Sum over the times at which the robot may get lost.
    lost = 1e-4
    on_map = (1 - lost) ** len(observations) * sum(all_paths(hidden, observations).values())
    off = 0.0
    for time in range(len(observations)):
        before = sum(all_paths(hidden, observations[:time]).values())
        off += (1 - lost) ** time * lost * before * 0.5 ** (len(observations) - time)
    assert state.nowhere == pytest.approx(off / (off + on_map))


def test_products_with_few_nonzero_cells_equal_those_with_the_whole_matrix():
    hidden = random_map(1, cells=40)
    weight = np.eye(40)[7] / 2
    for event, part in enumerate((hidden.moves, *hidden.bumps)):
        expected = weight @ part.toarray()
        np.testing.assert_allclose(hidden.after(event, weight), expected, atol=1e-15)


def test_impossible_observation_proves_that_the_robot_is_nowhere():
    hidden = HiddenMap.of(np.eye(2), np.zeros((2, 2)), np.arange(2), np.ones(2) / 2)
    belief = Belief(hidden)
    state = belief.observe(belief.start(), 1)
    assert state.nowhere == 1
    assert belief.estimate(state).cells.size == 0


def test_robot_is_probably_nowhere_if_a_coin_explains_its_run_better():
    # The map expects a bump in one of twenty steps, but the robot always bumps.
    moves, bumps = np.array([[0.95]]), np.array([[0.05]])
    belief = Belief(HiddenMap.of(moves, bumps, np.zeros(1, int), np.ones(1)))
    state = belief.start()
    for _ in range(12):
        state = belief.observe(state, 1)
    assert state.nowhere > 0.99
    for _ in range(2):
        before, state = state.nowhere, belief.observe(state, 0)
        assert state.nowhere < before


def map_with_angles(seed, cells=3, angles=2):
    """Draw a map whose robot bumps soon, wherever it is."""
    rng = np.random.default_rng(seed)
    ahead = rng.uniform(0, 0.15, cells)
    moves = ahead[:, None] * rng.dirichlet(np.ones(cells), cells)
    bumps = [(1 - ahead)[:, None] * rng.dirichlet(np.ones(cells) / 3, cells) for _ in range(angles)]
    return HiddenMap.of(moves, bumps, np.array([0, 1, 1]), rng.dirichlet(np.ones(cells)))


def entropy_of_all_paths(hidden, weight):
    """Compute the entropy at the next bump by enumeration of the paths until then."""
    moves, outcomes = hidden.moves.toarray(), {}
    ahead = moves.sum(axis=1)
    longest = 0
    while weight @ np.linalg.matrix_power(moves, longest) @ np.ones(hidden.cells) >= 1e-3:
        longest += 1
    for steps in range(longest + 1):
        for path in itertools.product(range(hidden.cells), repeat=steps + 1):
            probability = weight[path[0]]
            for a, b in itertools.pairwise(path):
                probability *= moves[a, b]
            # All paths of the longest length are one outcome, with or without a bump at their end.
            probability *= 1 - ahead[path[-1]] if steps < longest else 1
            at = steps, hidden.configuration[path[-1]]
            outcomes[at] = outcomes.get(at, 0.0) + probability
    totals = {n: sum(p for (m, _), p in outcomes.items() if m == n) for n, _ in outcomes}
    return -sum(p * np.log2(p / totals[n]) for (n, _), p in outcomes.items() if p > 0)


@few
@given(st.integers(0, 10_000), st.lists(st.integers(0, 1), max_size=3))
def test_turn_minimises_the_entropy_at_the_next_bump(seed, observations):
    hidden = map_with_angles(seed)
    belief = Belief(hidden)
    state = belief.start()
    for observation in observations:
        state = belief.observe(state, observation)
        assert (state.turn is None) == (not observation)
    left = []
    for angle in range(2):
        bumps = hidden.bumps[angle].toarray()
        weight = state.weight @ bumps / (state.weight @ bumps).sum()
        left.append(entropy_of_all_paths(hidden, weight))
        assert expected_entropy(hidden, weight) == pytest.approx(left[-1], abs=1e-9)
    after = belief.observe(state, 1)
    assert after.turn == np.argmin(left)
    one = HiddenMap.of(hidden.moves, hidden.bumps[after.turn], hidden.configuration, hidden.start)
    np.testing.assert_array_equal(Belief(one).observe(state, 1).weight, after.weight)


def test_entropy_of_a_robot_that_never_bumps():
    hidden = HiddenMap.of(np.eye(4), np.zeros((4, 4)), np.arange(4), np.ones(4) / 4)
    assert expected_entropy(hidden, np.ones(4)) == 2
    assert expected_entropy(hidden, np.zeros(4)) == 0
    assert expected_entropy(hidden, np.array([0.5, 0.5, 5e-324, 0.0])) == 1


def test_bump_probabilities_that_depend_on_the_angle_are_refused():
    with pytest.raises(ValueError, match="bumps: expected the same probability of a bump"):
        HiddenMap.of(
            np.zeros((2, 2)), [np.eye(2), np.eye(2) / 2], np.arange(2), np.array([0.5, 0.5])
        )


@pytest.mark.parametrize("share", [0.0, -1.0, 1.5, float("nan")])
def test_shares_out_of_range_are_refused(share):
    with pytest.raises(ValueError, match="share: expected more than 0 and at most 1"):
        Belief(random_map(0), share=share)


@pytest.mark.parametrize("hidden", [random_map(5), map_with_angles(5, angles=3)])
def test_hidden_map_is_read_back(tmp_path, hidden):
    path = tmp_path / "belief.jxb"
    hidden.save(path)
    again = HiddenMap.load(path)
    np.testing.assert_allclose(again.moves.toarray(), hidden.moves.toarray(), atol=1e-9)
    for ours, theirs in zip(again.bumps, hidden.bumps, strict=True):
        np.testing.assert_allclose(ours.toarray(), theirs.toarray(), atol=1e-9)
    np.testing.assert_array_equal(again.configuration, hidden.configuration)
    assert path.read_bytes() == (again.save(path), path.read_bytes())[1]


@pytest.mark.parametrize(
    ("moves", "start", "match"),
    [
        (np.eye(2), np.ones(3) / 3, "expected 3 rows"),
        (2 * np.eye(2), np.ones(2) / 2, "sum to at most 1"),
        (-np.eye(2), np.ones(2) / 2, "sum to at most 1"),
        (np.full((2, 2), np.nan), np.ones(2) / 2, "sum to at most 1"),
        (np.eye(2), np.ones(2), "start: expected a distribution"),
    ],
)
def test_bad_hidden_maps_are_refused(moves, start, match):
    zero = np.zeros_like(moves)
    with pytest.raises(ValueError, match=match):
        HiddenMap.of(moves, zero, np.zeros(start.size, int), start)


def test_large_hidden_map_is_read_back(tmp_path):
    """The probabilities at the start are rounded in the file, and there are many of them."""
    cells = 50_000
    part = scipy.sparse.eye_array(cells) / 2
    hidden = HiddenMap.of(part, part, np.arange(cells), np.full(cells, 1 / cells))
    hidden.save(tmp_path / "belief.jxb")
    again = HiddenMap.load(tmp_path / "belief.jxb")
    np.testing.assert_allclose(again.start, hidden.start, atol=2.0**-30)


def test_likeliest_path_allows_probabilities_rounded_to_0(tmp_path):
    moves = np.array([[1 - 1e-12, 1e-12], [0.0, 1.0]])
    HiddenMap.of(moves, 0 * moves, np.arange(2), np.array([0.9, 0.1])).save(tmp_path / "belief.jxb")
    hidden = HiddenMap.load(tmp_path / "belief.jxb")
    assert Belief(hidden).likeliest_path([0, 0]).tolist() == [0, 0, 0]
