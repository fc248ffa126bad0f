import itertools
from fractions import Fraction

import numpy as np
import pytest
import scipy.optimize
from graphs import grid
from walks import by_walks, delays_of

from jaxcell.base.certificate import Outcome
from jaxcell.optimize import Graph
from jaxcell.patrol.walks.arrival import (
    blind_capture,
    first_passage,
    on_device,
    walk_capture_probabilities,
    whole_numbers,
)
from jaxcell.patrol.walks.optimal import maximin, sequential_lp
from jaxcell.patrol.walks.optimal.maximin import maximin_capture
from jaxcell.patrol.walks.optimal.polytope import ChainPolytope
from jaxcell.patrol.walks.optimal.sequential_lp import Captures, maximize_least_capture


PATH = Graph([[i, i + 1] for i in range(8)])
GRID = grid(3, 3)
# Of one shape, for which programs are compiled once.
KITE = Graph([[0, 1], [1, 2], [2, 0], [2, 3]])
STAR = Graph([[0, 1], [0, 2], [0, 3]])
TIMES = np.array([1, 3, 2, 1])


def visited_in(walk, times, here, goal, left):
    """The probability that a walk from `here` visits `goal` within a time, by all its moves."""
    return sum(
        chance * (1 if there == goal else visited_in(walk, times, there, goal, left - time))
        for there, chance in walk[here].items()
        if (time := times[frozenset((here, there))]) <= left
    )


@pytest.mark.parametrize("times", [[1, 1, 1, 1], [1, 3, 2, 1]])
@pytest.mark.parametrize("attack", [2, 5])
def test_blind_capture_is_that_of_every_time_on_every_edge(times, attack):
    """Random walks with weights, whose share of moves along an edge is the share of its weight."""
    edges = [(0, 1), (1, 2), (2, 0), (2, 3)]
    lasts = {frozenset(edge): time for edge, time in zip(edges, times, strict=True)}
    missed, matrices = [Fraction(1)] * 4, []
    for weights in ([1, 1, 1, 1], [3, 1, 4, 2]):
        walk = {vertex: {} for vertex in range(4)}
        for (here, there), weight in zip(edges, weights, strict=True):
            walk[here][there] = walk[there][here] = Fraction(weight)
        walk = {i: {j: w / sum(row.values()) for j, w in row.items()} for i, row in walk.items()}
        matrices.append([[float(walk[i].get(j, 0)) for j in range(4)] for i in range(4)])
        whole = 2 * sum(weight * time for weight, time in zip(weights, times, strict=True))
        for goal in range(4):
            caught = Fraction(0)
            for edge, weight, time in zip(edges, weights, times, strict=True):
                for end, left in itertools.product(edge, range(1, time + 1)):
                    if left <= attack:
                        later = visited_in(walk, lasts, end, goal, attack - left)
                        caught += Fraction(weight, whole) * (1 if end == goal else later)
            missed[goal] *= 1 - caught
    found = blind_capture(KITE, matrices, attack, times)
    np.testing.assert_allclose(found, [float(1 - miss) for miss in missed], atol=1e-14)


def test_blind_capture_of_a_robot_on_a_tour_is_that_of_a_round():
    """On a cycle of edges of 1, 2, 3 and 4 s, and with a memory that tells to and fro apart."""
    cycle = Graph([(0, 1), (1, 2), (2, 3), (3, 0)])
    around = np.roll(np.eye(4), 1, axis=1)
    np.testing.assert_allclose(blind_capture(cycle, [around], 7, [1, 2, 3, 4]), 0.7)
    line, to_and_fro = Graph([(0, 1), (1, 2)]), np.zeros((6, 6))
    for here, there in [(0, 1), (1, 5), (5, 4), (4, 0), (2, 4), (3, 1)]:
        to_and_fro[here, there] = 1
    # The middle is left for 2 and for 10 of 12 s; an attack of 4 s begins in the last 4 of them.
    found = blind_capture(line, [to_and_fro], 4, [1, 5])
    np.testing.assert_allclose(found, [4 / 12, (2 + 4) / 12, 4 / 12])


@pytest.mark.parametrize(
    ("graph", "attack", "optimum"),
    [
        # From end to end all inner moves must go one way, and both directions share them.
        (PATH, 8, 2.0**-7),
        # From leaf to leaf, the one move from the centre must be right.
        (STAR, 3, 1 / 3),
    ],
)
def test_known_optima_from_the_default_start(graph, attack, optimum):
    walk = maximin_capture(graph, attack, starts=1)
    # Which of the starts is best by a rounding error is left open.
    assert walk.value == pytest.approx(optimum, rel=1e-6)
    assert walk.certificate.outcome is Outcome.CONVERGED
    # Another program, whose sums may be in another order.
    least = walk_capture_probabilities(graph, walk.matrices[0], attack).min()
    assert least == pytest.approx(walk.value, rel=1e-14)
    assert walk.chains[0].cells == graph.vertices


def test_no_chain_of_another_solver_is_better():
    attack = np.array([5, 6, 5, 7])
    walk = maximin_capture(KITE, attack, travel_times=TIMES, starts=4, stay=True)
    delays = delays_of(KITE, TIMES)
    least = by_walks(walk.matrices[0], delays, attack).min()
    assert walk.value == pytest.approx(least, rel=1e-9)
    among = ChainPolytope.on(KITE, stay=True)
    arguments = on_device(*whole_numbers(KITE, attack, TIMES))
    sums, sides = among.equalities()
    equal = {"type": "eq", "fun": lambda x: sums @ x[:-1] - sides}

    def captured(moves):
        return np.asarray(first_passage(among.matrix(moves), *arguments))

    above = {"type": "ineq", "fun": lambda x: captured(x[:-1]).ravel() - x[-1]}
    for start in among.starts(4, 1, 7)[:, 0]:
        other = scipy.optimize.minimize(
            lambda x: -x[-1],
            np.append(start, 0.0),
            bounds=[(0, 1)] * (start.size + 1),
            constraints=[equal, above],
            method="SLSQP",
        )
        if np.abs(equal["fun"](other.x)).max() < 1e-9 and above["fun"](other.x).min() > -1e-9:
            assert walk.value >= other.x[-1] * (1 - 1e-4)


def test_robots_are_all_where_they_are_worst():
    walk = maximin_capture(KITE, 3, robots=2, starts=1)
    each = [by_walks(matrix, delays_of(KITE, 1), np.full(4, 3)) for matrix in walk.matrices]
    least = min(
        1 - (1 - each[0][first, target]) * (1 - each[1][second, target])
        for first, second, target in itertools.product(range(4), repeat=3)
    )
    assert walk.value == pytest.approx(least, rel=1e-9)
    # Two that do the same are not better.
    one = maximin_capture(KITE, 3, starts=1).value
    assert walk.value >= 1 - (1 - one) ** 2 - 1e-6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"attack_time": 0}, "attack_time: expected at least 1, got 0 for vertex 0"),
        ({"attack_time": [3, 3, 0, 3]}, "attack_time: expected at least 1, got 0 for vertex 2"),
        ({"attack_time": 2.5}, "attack_time: expected a whole number, or 4, one per vertex"),
        ({"attack_time": 1}, "needs 2 from vertex 0 to vertex 3, where an attack takes 1"),
        ({"attack_time": 9, "travel_times": [1, 1]}, "travel_times: expected a whole number, or 4"),
        ({"attack_time": 4, "travel_times": [1, 1, 1, 5]}, "needs 10 from vertex 3 to vertex 3"),
        ({"attack_time": 9, "robots": 0}, "robots: expected a whole number of at least 1, got 0"),
        ({"attack_time": 9, "starts": 0}, "starts: expected a whole number of at least 1, got 0"),
        ({"attack_time": 9, "memory": 0}, "memory: expected a whole number of at least 1, got 0"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        maximin_capture(KITE, **arguments)


def test_a_robot_that_may_stay_captures_in_one_step_where_it_is():
    """On a triangle it goes on to each vertex, or stays, with equal probabilities."""
    triangle = Graph([[0, 1], [1, 2], [2, 0]])
    assert maximin_capture(triangle, 1, stay=True).value == pytest.approx(1 / 3)


def test_wrong_matrices_are_refused():
    with pytest.raises(
        ValueError, match=r"matrix: expected \[4, 4\], or a multiple .* got \[2, 2\]"
    ):
        walk_capture_probabilities(KITE, np.eye(2), 3)
    with pytest.raises(ValueError, match="rows of numbers of at least 0 that sum to 1"):
        walk_capture_probabilities(KITE, np.ones((4, 4)), 3)
    with pytest.raises(ValueError, match=r"matrix\[0, 3\] is positive, but not an edge"):
        walk_capture_probabilities(KITE, np.tile([0, 0, 0, 1.0], (4, 1)), 3)


def test_gradients_and_programs_find_more_on_a_grid_than_either():
    # Gradients alone lead to 0.1812, descent and programs to 0.1564.
    graph = grid(4, 4)
    walk = maximin_capture(graph, 8, starts=1)
    assert walk.value > 0.1819
    exact = walk_capture_probabilities(graph, walk.matrices[0], 8)
    assert walk.value == pytest.approx(exact.min(), abs=1e-9)


@pytest.mark.parametrize(
    ("graph", "attack", "times", "start", "target"),
    [
        (GRID, 5, None, [0, 3, 4, 8], [0, 5, 2, 7]),
        (KITE, np.array([5, 6, 5, 7]), TIMES, [0, 3, 1, 2, 2], [0, 1, 3, 3, 0]),
    ],
)
@pytest.mark.parametrize("stay", [False, True])
def test_slopes_of_some_attacks_against_differences(graph, attack, times, start, target, stay):
    among = ChainPolytope.on(graph, stay=stay)
    moves = among.starts(2, 2, 0)[1]
    random = np.random.default_rng(0)
    durations = np.broadcast_to(attack, graph.vertices)
    given = durations, delays_of(graph, 1 if times is None else times)
    here = Captures(among, moves, *given)
    for robot in range(2):
        exact = walk_capture_probabilities(graph, among.matrix(moves[robot]), attack, times)
        np.testing.assert_allclose(here.probability[robot], exact, atol=1e-14)
        change = 1e-5 * random.normal(size=moves.shape[1])
        up, down = (Captures(among, moves + way * change, *given) for way in (1, -1))
        expected = (up.probability[robot] - down.probability[robot]) / 2
        np.testing.assert_allclose(here.along(robot, change), expected, atol=1e-13)
        along = here.slopes(robot, np.array(start), np.array(target)) @ change
        np.testing.assert_allclose(along, expected[start, target], atol=1e-13)


def test_programs_of_few_attacks_end_where_those_of_all_do(monkeypatch):
    among = ChainPolytope.on(GRID)
    moves = among.starts(1, 1, 0)[0]

    def law(moves):
        return Captures(among, moves, np.full(9, 4))

    few = maximize_least_capture(law, among, moves, 1e-4)
    monkeypatch.setattr(sequential_lp, "NEAR", np.inf)
    monkeypatch.setattr(sequential_lp, "MOST", 1000)
    every = maximize_least_capture(law, among, moves, 1e-4)
    assert few[1] == pytest.approx(every[1], rel=2e-4)
    assert few[2] <= 1e-4
    # Without a distance, attacks that were left out are added: the gain is that of all.
    sure = sequential_lp._program(among, few[0], law(few[0]), 1.0)[1]
    monkeypatch.undo()
    assert sequential_lp._program(among, few[0], law(few[0]), 1.0)[1] == pytest.approx(
        sure, abs=1e-6
    )


def test_too_large_for_linear_programs(monkeypatch):
    monkeypatch.setattr(maximin, "POLISHED", 0)
    monkeypatch.setattr(maximin, "STEPS", 300)
    walk = maximin_capture(GRID, 4, starts=1, throw=False)
    assert walk.value == pytest.approx(walk_capture_probabilities(GRID, walk.matrices[0], 4).min())
    assert walk.value > 0.15
    assert walk.certificate.tolerance == 0.02


def test_with_travel_times_too_large_for_linear_programs(monkeypatch):
    """Harder and harder soft minima come within a thousandth of the linear programs."""
    options = {"travel_times": TIMES, "starts": 2, "stay": True, "throw": False}
    best = maximin_capture(KITE, 6, **options).value
    monkeypatch.setattr(maximin, "POLISHED", 0)
    walk = maximin_capture(KITE, 6, **options)
    assert best * (1 - 1e-3) < walk.value <= best * (1 + 1e-9)
    assert walk.certificate.tolerance == 0.02
