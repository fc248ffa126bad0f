import cvxpy
import numpy as np
import pytest
from graphs import grid

from jaxcell.optimize import Linear, conic, minimum_commute
from jaxcell.optimize.constraints import room


GRID = grid(3, 4)
EDGES = len(GRID.edges)
UNIT = np.eye(EDGES)


def caps(upper):
    return [Linear(f"cap {e}", UNIT[e], upper=upper) for e in range(EDGES)]


def floors(lower):
    even = np.eye(GRID.vertices)
    return [Linear.on_visits(GRID, f"floor {v}", even[v], lower) for v in range(GRID.vertices)]


random = np.random.default_rng(3)
CASES = {
    "caps": caps(0.07),
    "caps that leave nothing": caps(1 / EDGES),
    "floors": floors(0.07),
    "an edge without weight": [Linear("none", UNIT[3], upper=0)],
    "symmetry, said twice": [
        Linear("a", UNIT[0] - UNIT[5], 0, 0),
        Linear("b", UNIT[1] - UNIT[5], 0, 0),
        Linear("c", UNIT[1] - UNIT[0], 0, 0),
    ],
    "a budget": [Linear("budget", 100 * random.random(EDGES), upper=35)],
    "all together": [*caps(0.09), *floors(0.04), Linear("range", random.random(EDGES), 0.5, 0.6)],
    "what never matters": [Linear("loose", UNIT[0], upper=0.9)],
}


@pytest.mark.parametrize("name", CASES)
def test_least_commute_time_equals_a_cone_program_of_cvxpy(name):
    constraints = CASES[name]
    walk = minimum_commute(GRID, constraints=constraints)
    w = walk.weights
    assert w.min() >= 0
    assert w.sum() == pytest.approx(1, abs=1e-12)
    for one in constraints:
        assert one.lower - 1e-11 <= one.coefficients @ w <= one.upper + 1e-11
    assert walk.certificate.residual <= 1e-8
    least = conic.least_resistance(GRID, constraints).least
    assert walk.commute_time == pytest.approx(4 * least / (GRID.vertices - 1), rel=1e-6)


def test_prices_are_what_a_little_more_is_worth():
    def time(upper):
        cap = [Linear("cap", 3 * UNIT[2] + UNIT[0], upper=upper), Linear("loose", UNIT[1], 0.001)]
        return minimum_commute(GRID, constraints=cap, tolerance=1e-10)

    slope = (time(0.0999).commute_time - time(0.1001).commute_time) / 0.0002
    assert time(0.1).prices == pytest.approx([slope, 0], rel=1e-3, abs=1e-3)


def test_an_emphasis_is_one_more_constraint():
    emphasised = minimum_commute(GRID, [0, 5])
    with_loose = minimum_commute(GRID, [0, 5], constraints=[Linear("loose", UNIT[0], upper=1)])
    np.testing.assert_allclose(with_loose.weights, emphasised.weights, atol=1e-5)
    np.testing.assert_array_equal(with_loose.tour, emphasised.tour)


CONTRADICTION = [
    Linear("much here", UNIT[0], lower=0.6),
    Linear("some there", UNIT[4], lower=0.1),
    Linear("much there", UNIT[1], lower=0.5),
    Linear("little there", UNIT[4], upper=0.2),
]


@pytest.mark.parametrize(
    ("constraints", "message"),
    [
        (CONTRADICTION, "contradict each other: much here, much there$"),
        ([*caps(0.9), Linear("negative", UNIT[0], upper=-1)], "no weights meet negative$"),
        (caps(0.05), "contradict each other: cap 0, cap 1, .*cap 16$"),
        (
            [Linear("apart", UNIT[:2].sum(axis=0), upper=0)],
            "leave no weight for edges between vertex 1 and vertex 0",
        ),
    ],
)
def test_a_smallest_contradiction_is_named(constraints, message):
    with pytest.raises(RuntimeError, match=message):
        minimum_commute(GRID, constraints=constraints)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Linear("a", np.zeros(3)), "a: expected finite coefficients"),
        (lambda: Linear("a", np.ones(3), 2, 1), "a: expected a lower bound up to the upper one"),
        (
            lambda: minimum_commute(GRID, constraints=[Linear("a", np.ones(3), upper=2)]),
            "constraints: a has 3 coefficients; expected 17",
        ),
    ],
)
def test_wrong_constraints_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_the_bound_holds_for_any_prices():
    left = room(EDGES, [*caps(0.1), *floors(0.05)])
    gain = random.random(left.edges)
    w = cvxpy.Variable(EDGES, nonneg=True)
    rules = [cvxpy.sum(w) == 1, w <= 0.1]
    rules += [one.coefficients @ w >= 0.05 for one in floors(0.05)]
    most = cvxpy.Problem(cvxpy.Maximize(gain @ w), rules).solve(solver="CLARABEL")
    for _ in range(20):
        assert left.most(gain, random.normal(size=left.totals.size)) >= most - 1e-8
