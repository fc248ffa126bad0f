import numpy as np
import pytest
import scipy.optimize
from graphs import grid
from walks import by_walks, delays_of, walk_on

from jaxcell.optimize import Graph
from jaxcell.patrol import maximin_capture
from jaxcell.patrol.perimeter import Movement, Perimeter, detection_polynomials, maximin
from jaxcell.patrol.team import simulate_idleness
from jaxcell.patrol.walks import capture_bound, memory_patrol, walk_capture_probabilities
from jaxcell.patrol.walks.optimal import bound, maximin as search
from jaxcell.patrol.walks.optimal.pursuit import Pursuit
from jaxcell.patrol.walks.steps import SymmetricSteps
from jaxcell.patrol.walks.symmetries import symmetries


KITE = Graph([[0, 1], [1, 2], [2, 0], [2, 3]])
TIMES = np.array([1, 3, 2, 1])
RING = Graph([[i, (i + 1) % 8] for i in range(8)])
STAR = Graph([[0, leaf] for leaf in range(1, 9)])


def random_chain(graph, memory, stay, seed):
    """A chain on pairs of a state of the memory and a vertex, with random probabilities."""
    beside = graph.matrix(np.ones(len(graph.edges))).toarray() + stay * np.eye(graph.vertices)
    weights = np.tile(beside, (memory, memory))
    weights = weights * np.random.default_rng(seed).random(weights.shape)
    return weights / weights.sum(axis=1, keepdims=True)


def walks_from(graph, delays, start, horizon):
    """All walks from a vertex that end within the horizon and cannot go on, as times by vertex."""
    going, ended = [((start,), 0, {})], []
    while going:
        walk, time, seen = going.pop()
        moves = [
            v for v in np.flatnonzero(delays[walk[-1]]) if time + delays[walk[-1], v] <= horizon
        ]
        for there in moves:
            later = time + int(delays[walk[-1], there])
            going.append(((*walk, int(there)), later, {int(there): later} | seen))
        if not moves:
            ended.append(seen)
    return ended


@pytest.mark.parametrize("stay", [False, True])
@pytest.mark.parametrize("times", [1, TIMES])
def test_capture_with_memory_is_the_sum_over_all_walks_of_states(stay, times):
    matrix, attack = random_chain(KITE, 2, stay, 0), np.array([3, 5, 1, 4])
    found = walk_capture_probabilities(KITE, matrix, attack, np.broadcast_to(times, 4))
    expected = by_walks(matrix, delays_of(KITE, times), attack)
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.fixture
def brief(monkeypatch):
    """Searches take a third of their steps, from which linear programs complete them."""
    monkeypatch.setattr(search, "STEPS", 400)


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize("attack", [5, 6])
def test_two_states_are_a_direction_on_a_ring(attack):
    """The exact optimum of the directional model on a perimeter is the least that is expected."""
    best = maximin(detection_polynomials(Perimeter(8, 1, Movement.DNCP), attack))
    walk = maximin_capture(RING, attack, memory=2, starts=2)
    assert walk.value >= best.value * (1 - 1e-3)


@pytest.mark.usefixtures("brief")
def test_memory_helps_and_no_walk_exceeds_the_bound(monkeypatch):
    """Without memory at most 0.1584 is found on this grid."""
    # Few programs.
    monkeypatch.setattr(search, "EXACT", 0)
    graph, attack = grid(3, 3), 4
    walk = maximin_capture(graph, attack, memory=2, starts=1, throw=False)
    assert 0.21 < walk.value < capture_bound(graph, attack)
    exact = walk_capture_probabilities(graph, walk.matrices[0], attack)
    assert walk.value == pytest.approx(exact.min(), rel=1e-9)


@pytest.mark.usefixtures("unchecked")
def test_a_robot_that_acts_alike_in_symmetric_positions_against_all_walks():
    graph, memory, attack = grid(2, 3), 8, 4
    frames = symmetries(delays_of(graph, 1), ["corner", "side", "corner"] * 2)
    steps = SymmetricSteps.of(search._with_memory(graph, memory, False), frames)
    assert len(frames) == 4
    logits = np.random.default_rng(0).normal(size=(1, *steps.own.image.shape))
    chance = steps.chances(logits, 0.0)
    (matrix,) = steps.matrices(chance)
    exact = walk_capture_probabilities(graph, matrix, attack)
    away = 1 - np.tile(np.eye(6), (2, 1))
    late = away
    for _ in range(attack - 1):
        late = away * steps.pull(chance[0], late)
    np.testing.assert_allclose(1 - steps.pull(chance[0], late), exact[:12], atol=1e-12)
    for number, frame in enumerate(frames):
        rows = exact.reshape(4, 2, 6, 6)
        np.testing.assert_allclose(rows[number], rows[0][:, frame][..., frame], atol=1e-12)


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize("times", [None, TIMES])
@pytest.mark.parametrize("states", [1, 2])
def test_copies_of_states_capture_the_same_and_a_search_from_them_is_not_worse(
    monkeypatch, times, states
):
    monkeypatch.setattr(search, "POLISHED", 0)
    known = maximin_capture(KITE, 5, travel_times=times, memory=states, starts=2, throw=False)
    exact = walk_capture_probabilities(KITE, known.matrices[0], 5, times)
    (copies,) = search._copied(known.matrices, 3, 4, 0)
    owners = [0, 0, 0] if states == 1 else [0, 0, 1]
    np.testing.assert_allclose(
        walk_capture_probabilities(KITE, copies, 5, times).reshape(3, 4, 4),
        exact.reshape(states, 4, 4)[owners],
        atol=1e-14,
    )
    # From one random start alone, walks with three states can be worse.
    options = {"travel_times": times, "memory": 3, "starts": 1, "throw": False}
    walk = maximin_capture(KITE, 5, known=known.matrices, **options)
    assert walk.value >= known.value * (1 - 1e-12)
    least = walk_capture_probabilities(KITE, walk.matrices[0], 5, times).min()
    assert walk.value == pytest.approx(least, rel=1e-9)


@pytest.mark.parametrize("shape", [(1, 4, 8), (1, 6, 6), (1, 12, 12)])
def test_known_walks_that_do_not_fit_are_refused(shape):
    with pytest.raises(ValueError, match="known: expected matrices of at most 2 times 4 states"):
        maximin_capture(KITE, 5, memory=2, known=np.zeros(shape))


@pytest.mark.usefixtures("brief", "unchecked")
def test_memory_is_divided_among_symmetries():
    """On a line of nine, whose walk with two states is nearly the best with any memory."""
    line = Graph([[i, i + 1] for i in range(8)])
    walk = maximin_capture(line, 8, memory=2, starts=1, throw=False)
    assert walk.value > 0.147
    exact = walk_capture_probabilities(line, walk.matrices[0], 8)
    assert walk.value == pytest.approx(exact.min(), rel=1e-9)


def test_the_bound_proves_that_walks_are_best():
    """A robot visits all leaves of a star, or two robots visit half of the leaves each."""
    assert capture_bound(STAR, 2) == pytest.approx(1 / 8, abs=1e-12)
    assert maximin_capture(STAR, 2, starts=1).value == pytest.approx(1 / 8, rel=1e-6)
    halves = np.zeros((2, 9, 9))
    halves[:, 1:, 0] = halves[0, 0, 1:5] = halves[1, 0, 5:] = 1
    halves[:, 0] /= 4
    each = [walk_capture_probabilities(STAR, matrix, 2).min(axis=0) for matrix in halves]
    assert (1 - (1 - each[0]) * (1 - each[1])).min() == 1 / 4
    assert capture_bound(STAR, 2, robots=2) == pytest.approx(1 / 4, abs=1e-12)


def test_an_adversary_who_sees_the_robot_all_the_time_lowers_the_bound(monkeypatch):
    """On a line of five, where the walk with two states is nearly the best with any memory."""
    monkeypatch.setattr(bound, "CUTS", 150)
    line = Graph([[i, i + 1] for i in range(4)])
    found = maximin_capture(line, 4, memory=2, starts=1, throw=False).value
    alone = capture_bound(line, 4)
    assert found <= capture_bound(line, 4, captured=found, tests=6) < 1.1 * found
    assert alone > 1.5 * found


@pytest.mark.parametrize(
    ("delays", "attack", "captured"),
    [
        # A robot that goes round is at both in time, and on a line never after one of them.
        (np.roll(np.eye(4, dtype=int), 1, axis=1), 4, 1.0),
        (np.eye(3, k=1, dtype=int) + np.eye(3, k=-1, dtype=int), 1, 0.0),
        # From the middle both ways are equally good, and from an end a robot comes back or not.
        (np.eye(3, k=1, dtype=int) + np.eye(3, k=-1, dtype=int), 3, 0.5),
        (np.eye(3, k=1, dtype=int) + 2 * np.eye(3, k=-1, dtype=int), 7, 1.0),
    ],
)
def test_the_pursuit_of_known_games(delays, attack, captured):
    n = len(delays)
    pursuit = Pursuit(delays, np.full(n, attack), [0, n - 1])
    bound = pursuit.bound(max(0.0, captured - 0.02), 1.0, 8, 200)
    assert captured - 1e-9 <= bound <= captured + 0.02


@pytest.mark.parametrize(
    ("graph", "attack", "times", "tight"),
    [
        (grid(3, 3), np.full(9, 4), 1, True),
        (KITE, np.array([4, 5, 3, 6]), TIMES, False),
        (KITE, np.full(4, 4), 1, False),
        (RING, np.full(8, 7), 1, False),
    ],
)
def test_the_bound_against_the_games_with_all_walks(graph, attack, times, tight):
    """It is not below the least value of these games, and equal where visits do not repeat."""
    delays = delays_of(graph, times) - np.eye(graph.vertices, dtype=int)
    values = []
    for start in range(graph.vertices):
        walks = walks_from(graph, delays, start, attack.max())
        in_time = np.array(
            [[walk.get(v, np.inf) <= attack[v] for v in range(graph.vertices)] for walk in walks]
        )
        rows = np.unique(in_time, axis=0).astype(float)
        game = scipy.optimize.linprog(
            np.append(np.zeros(len(rows)), -1),
            A_ub=np.column_stack([-rows.T, np.ones(graph.vertices)]),
            b_ub=np.zeros(graph.vertices),
            A_eq=np.append(np.ones(len(rows)), 0)[None],
            b_eq=[1],
        )
        values.append(-game.fun)
    bound = capture_bound(graph, attack, travel_times=np.broadcast_to(times, len(graph.edges)))
    assert min(1, min(values)) - 1e-9 <= bound <= 1
    if tight:
        assert bound == pytest.approx(min(values), abs=1e-9)


@pytest.mark.usefixtures("unchecked", "brief")
def test_walks_with_memory_against_a_simulation():
    graph = grid(2, 3)
    patrol = memory_patrol(graph, 4, 2, walk_on(graph)[None], names="abcdef", tests=1)
    assert patrol.walk == ["memory 1", "memory 2", "tour"]
    assert patrol.memory == 2
    assert patrol.state_vertex == [*"abcdefabcdef"]
    exact = walk_capture_probabilities(graph, patrol.chance[0], 4)
    assert patrol.least_capture[1] == pytest.approx(exact.min(), abs=1e-9)
    np.testing.assert_allclose(patrol.captured, exact.min(axis=0), atol=1e-9)
    assert patrol.gap == pytest.approx(1 - patrol.least_capture.max() / patrol.upper_bound)
    simulated = simulate_idleness(graph, patrol.chance, attack_time=4)
    assert simulated.least_capture[0] == pytest.approx(patrol.any_time[1], abs=0.03)
    assert simulated.least_capture[1] == pytest.approx(patrol.any_time[2], abs=0.03)


@pytest.mark.usefixtures("unchecked")
def test_several_robots_are_independent():
    patrol = memory_patrol(KITE, 3, 1, np.stack([random_chain(KITE, 1, False, s) for s in (0, 1)]))
    each = [walk_capture_probabilities(KITE, matrix, 3).min(axis=0) for matrix in patrol.chance]
    assert patrol.walk == ["memory 1", "round"]
    both = (1 - (1 - each[0]) * (1 - each[1])).min()
    assert patrol.least_capture[0] == pytest.approx(both)
    assert patrol.least_capture.max() <= patrol.upper_bound == capture_bound(KITE, 3, robots=2)


def test_a_tour_that_is_in_time_everywhere_captures_all():
    for attack, least in ((7, 0.0), (8, 1.0)):
        patrol = memory_patrol(RING, attack, 1, walk_on(RING)[None], tests=0)
        assert patrol.least_capture[1] == least
        assert patrol.any_time[1] == attack / 8


@pytest.mark.parametrize(
    ("edges", "attack", "stay", "best"),
    [
        # A robot that stays with 1 / golden ratio squared, and otherwise goes to either vertex.
        ([(0, 1), (0, 2), (1, 2)], 2, True, (5**0.5 - 1) / 2),
        # The best walk that many starts find.
        ([(v, (v + 1) % 5) for v in range(5)], 3, False, 0.43016),
    ],
)
def test_bound_from_attacks_on_all_vertices_is_nearly_attained(edges, attack, stay, best):
    bound = capture_bound(Graph(edges), attack, stay=stay, captured=best, tests=8)
    assert best <= bound < best + 0.003
