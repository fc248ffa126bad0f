import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_chains import arrival_law, complete, matrices, random_chain, with_sink

from jaxcell.base.certificate import Outcome
from jaxcell.mapping.generalized import Chain
from jaxcell.markov.arrival import Distinct, first_arrival, mean_product
from jaxcell.markov.hitting import hitting_times
from jaxcell.markov.mean_arrival import mean_first_arrival


STEPS = 12


def joint(walks, starts, there):
    """Return the joint chain of all robots, its start, and the mask of arrival of some robot."""
    matrix = functools.reduce(np.kron, walks)
    start = functools.reduce(np.kron, starts)
    away = functools.reduce(np.kron, [(~there).astype(float)] * len(walks))
    return matrix, start, away == 0


@given(matrices(), st.integers(0, 2**32 - 1))
def test_law_of_two_robots_equals_the_joint_chain(matrix, seed):
    cells = len(matrix)
    draw = np.random.default_rng(seed)
    other = draw.permutation(cells)
    walks = [matrix, matrix[other][:, other]]
    starts = draw.dirichlet(np.ones(cells), 2)
    there = draw.random(cells) < 0.4
    there[draw.integers(cells)] = True
    chains = [Chain.from_scipy(walk) for walk in walks]
    result = np.asarray(first_arrival(chains, list(starts), there, STEPS))
    # A robot may leave before others.
    padded = [np.append(start, 0) for start in starts]
    race = joint([with_sink(walk) for walk in walks], padded, np.append(there, False))
    expected = arrival_law(*race, STEPS)
    np.testing.assert_allclose(result, expected, atol=1e-13)
    assert (result >= 0).all()


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_law_of_distinct_starts_is_the_mean_over_all_sets_of_starts(robots):
    chain, there = random_chain(5, 7), np.arange(5) == 2
    matrix = chain.to_scipy().toarray()
    choices = [0, 2, 3, 4]
    laws = [
        arrival_law(*joint([matrix] * robots, [np.eye(5)[cell] for cell in cells], there), STEPS)
        for cells in itertools.combinations(choices, robots)
    ]
    result = first_arrival([chain] * robots, Distinct(choices), 2, STEPS)
    np.testing.assert_allclose(result, np.mean(laws, axis=0), atol=1e-14)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8), st.data())
def test_mean_product_is_the_mean_over_all_sets(values, data):
    count = data.draw(st.integers(1, len(values)))
    sets = [math.prod(chosen) for chosen in itertools.combinations(values, count)]
    result = mean_product(np.array([values, values[::-1]]), count)
    np.testing.assert_allclose(result, np.mean(sets), rtol=1e-12, atol=1e-300)


def test_mean_product_of_many_values_does_not_overflow():
    # The mean of equal values is a power, although the polynomial has 10^88 terms.
    assert mean_product(np.full((1, 300), 0.9), 150)[0] == pytest.approx(0.9**150, rel=1e-11)


@pytest.mark.parametrize("robots", [1, 2, 4, 8, 16, 64])
def test_complete_graph_has_known_values(robots):
    # A robot outside the target finds it with probability 1/63 per step (Alam 2018, Table 4.1).
    result = mean_first_arrival([Chain.from_scipy(complete(64))] * robots, Distinct(range(64)), 5)
    expected = (1 - robots / 64) / (1 - (62 / 63) ** robots)
    assert result.value == pytest.approx(expected, rel=1e-10)


@given(matrices(), st.data())
def test_mean_of_two_robots_equals_solve_of_joint_chain(matrix, data):
    cells = len(matrix)
    starts = [data.draw(st.integers(0, cells - 1)) for _ in range(2)]
    target = data.draw(st.integers(0, cells - 1))
    walk = with_sink(matrix)
    there = np.arange(cells + 1) == target
    whole, _, arrived = joint([walk, walk], [there, there], there)
    times = np.asarray(hitting_times(Chain.from_scipy(whole), arrived).value)
    expected = times[starts[0] * (cells + 1) + starts[1]]
    chain = Chain.from_scipy(matrix)
    result = mean_first_arrival([chain, chain], starts, target)
    assert result.value == pytest.approx(expected, rel=1e-8)
    assert result.certificate.outcome is Outcome.CONVERGED


def test_tail_is_bounded_before_it_is_negligible():
    e = 1e-7
    chain = Chain.from_scipy(np.array([[1 - e, 0, e], [0.5, 0.5, 0], [0, 0, 1]]))
    result = mean_first_arrival([chain, chain], [0, 1], 2)
    assert result.certificate.iterations < 1000
    # After each step, the second robot is in the cell of the first or still waits in its own.
    together = 1 / (1 - (1 - e) ** 2)
    expected = (1 + (1 - e) / 2 * together) / (1 - (1 - e) / 2)
    assert result.value == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("starts", "expected"),
    [([0, 0], math.inf), ([0, 1], 2.0), ([3, 0], 0.0), ([[0, 1], 0], math.inf), ([2, 2], math.inf)],
)
def test_mean_is_finite_if_one_robot_surely_arrives(starts, expected):
    # A robot may leave from cell 0, and stays in cell 2. From cell 1 it takes two steps on average.
    chain = Chain.from_scipy(
        np.array([[0.5, 0, 0, 0], [0, 0.5, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]])
    )
    assert mean_first_arrival([chain, chain], starts, 3).value == pytest.approx(expected)


@pytest.mark.parametrize(("robots", "finite"), [(1, False), (2, False), (3, True)])
def test_mean_is_infinite_if_all_distinct_starts_may_fail(robots, finite):
    chain = Chain.from_scipy(np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0.5, 0.5], [0, 0, 0, 1]]))
    mean = mean_first_arrival([chain] * robots, Distinct([0, 1, 2, 3]), 3).value
    assert math.isfinite(mean) == finite


def test_mean_that_takes_too_many_steps_is_reported():
    n = 200
    chain = Chain.from_scipy((np.roll(np.eye(n), 1, axis=1) + np.roll(np.eye(n), -1, axis=1)) / 2)
    result = mean_first_arrival([chain, chain], [1, 100], 0, max_steps=500, throw=False)
    assert result.certificate.outcome is Outcome.STALLED
    with pytest.raises(RuntimeError, match="mean_first_arrival: the residual stayed"):
        mean_first_arrival([chain, chain], [1, 100], 0, max_steps=500)
    # The residual bounds the error here too.
    truth = mean_first_arrival([chain, chain], [1, 100], 0).value
    assert abs(result.value - truth) <= result.certificate.residual * result.value


FOUR, FIVE = Chain.from_scipy(complete(4)), Chain.from_scipy(complete(5))


@pytest.mark.parametrize(
    ("chains", "starts", "message"),
    [
        ([], [], "chains: expected a chain for each robot, got none"),
        ([FOUR, FIVE], [0, 0], "chain of robot 1 has 5 cells, and the chain of robot 0 has 4"),
        ([FOUR, FOUR], [0], "starts: expected a start for each of 2 robots, got 1"),
        ([FOUR, FOUR], [0, 4], "robot 1: start: cell 4 does not exist"),
        (
            [FOUR, Chain.from_scipy(complete(4))],
            Distinct([0, 1]),
            "distinct starts are for robots of one chain",
        ),
        ([FOUR] * 3, Distinct([0, 1]), "3 robots cannot begin in 2 different cells"),
        ([FOUR], Distinct([]), "starts: expected at least one cell, got none"),
        ([FOUR], Distinct([0.5, 0.5, 0.0, 0.0]), "starts: expected whole numbers of cells"),
    ],
)
def test_bad_robots_are_refused(chains, starts, message):
    for function in (functools.partial(first_arrival, steps=3), mean_first_arrival):
        with pytest.raises(ValueError, match=message):
            function(chains, starts, 0)


def test_bad_tolerances_are_refused():
    with pytest.raises(ValueError, match="tolerance: expected a positive number, got 0"):
        mean_first_arrival([FOUR], [0], 1, tolerance=0.0)


def test_the_law_has_the_derivatives_of_geometric_laws():
    """Robots that arrive with probabilities p and 2 p in each step, in a compiled batch."""
    steps = np.arange(STEPS + 1)

    def law(p, starts):
        rows = [[1 - p, 0, p], [0, 1 - 2 * p, 2 * p], [0, 0, 1]]
        P = jnp.stack([jnp.stack([jnp.asarray(x, float) for x in row]) for row in rows])
        chain = Chain(jnp.arange(3)[:, None] * jnp.ones((1, 3), int), P.T)
        return first_arrival([chain, chain], starts, 2, STEPS)

    def none_before(p, starts):
        """The probability that neither robot has arrived before each step, and its derivative."""
        one, two = {(0, 0): (p, p), (0, 1): (p, 2 * p), "distinct": (p, 2 * p)}[starts]
        left = (1 - one) * (1 - two)
        slope = -(one / p) * (1 - two) - (two / p) * (1 - one)
        n = np.arange(STEPS + 2) - 1
        value = np.where(n < 0, 1.0, left ** np.maximum(n, 0.0))
        return value, np.where(n < 1, 0.0, n * left ** np.maximum(n - 1, 0.0) * slope)

    some = np.array([0.1, 0.3, 0.45])
    for starts in ((0, 0), (0, 1), "distinct"):
        given = Distinct([0, 1]) if starts == "distinct" else list(starts)
        each = functools.partial(law, starts=given)
        found = jax.jit(jax.vmap(each))(some)
        slopes = jax.vmap(jax.jacrev(each))(some)
        assert found.shape == slopes.shape == (some.size, steps.size)
        for row, slope, p in zip(found, slopes, some, strict=True):
            value, derivative = none_before(p, starts)
            np.testing.assert_allclose(row, -np.diff(value), rtol=1e-12, atol=1e-15)
            np.testing.assert_allclose(slope, -np.diff(derivative), rtol=1e-11, atol=1e-13)


def test_the_law_and_the_mean_are_linear_in_traced_starts():
    chain, there = random_chain(6, 0), np.arange(6) == 5

    def law(start, other=1):
        return first_arrival([chain, chain], [start, other], 5, STEPS)

    from_each = np.stack([law(cell) for cell in range(6)])
    np.testing.assert_allclose(jax.jit(jax.vmap(law))(np.arange(6)), from_each, rtol=1e-14)
    start = np.random.default_rng(0).dirichlet(np.ones(6))
    np.testing.assert_allclose(jax.jit(law)(start), start @ from_each, rtol=1e-13)
    slopes = np.asarray(jax.jacfwd(law)(start)).T
    # Changes of a distribution sum to 0.
    np.testing.assert_allclose(slopes - slopes[0], from_each - from_each[0], atol=1e-13)
    np.testing.assert_allclose(jax.jit(law)(there), law(5), rtol=1e-14)

    def mean(start):
        return mean_first_arrival([chain, chain], [start, 1], 5).value

    times = [mean(cell) for cell in range(6)]
    value, slope = jax.jit(jax.value_and_grad(mean))(start)
    np.testing.assert_allclose(value, start @ times, rtol=1e-13)
    np.testing.assert_allclose(slope, times, rtol=1e-12)


def test_the_mean_has_the_derivatives_of_geometric_laws():
    """In a compiled batch. In each step a robot arrives, leaves the space, or stays in its cell."""

    def mean(p, leaving, starts):
        rows = [[1 - p - leaving * p, 0, p], [0, 1 - 2 * p, 2 * p], [0, 0, 1]]
        P = jnp.stack([jnp.stack([jnp.asarray(x, float) for x in row]) for row in rows])
        chain = Chain(jnp.arange(3)[:, None] * jnp.ones((1, 3), int), P.T)
        return mean_first_arrival([chain, chain], starts, 2).value

    def both(first, second):
        """The mean time of robots that arrive with these probabilities."""
        return 1 / (1 - (1 - first) * (1 - second))

    some = np.array([0.1, 0.2, 0.3])
    # A robot that arrives or leaves with probability p has arrived in half of the cases.
    cases = [
        (0.0, [0, 0], lambda p: both(p, p)),
        (0.0, [0, 1], lambda p: both(p, 2 * p)),
        (0.0, Distinct([0, 1]), lambda p: both(p, 2 * p)),
        (0.0, [[0.5, 0.5, 0], 1], lambda p: both(p, 2 * p) / 2 + both(2 * p, 2 * p) / 2),
        (0.0, [0, 2], lambda p: 0 * p),
        (1.0, [0, 1], lambda p: both(2 * p, 2 * p) / 2 + 1 / (4 * p)),
    ]
    for leaving, starts, exact in cases:
        each = functools.partial(mean, leaving=leaving, starts=starts)
        found, slopes = (jax.jit(jax.vmap(f))(some) for f in (each, jax.grad(each)))
        np.testing.assert_allclose(found, exact(some), rtol=1e-13)
        step = 1e-4
        central = (exact(some + step) - exact(some - step)) / (2 * step)
        np.testing.assert_allclose(slopes, central, rtol=1e-5)
    lost = functools.partial(mean, leaving=1.0, starts=[0, 0])
    assert np.isinf(jax.jit(lost)(0.1))
    with pytest.raises(ValueError, match=r"joint states; under jit, vmap and grad at most 2,500"):
        jax.jit(lambda p: mean_first_arrival([chain_of(60, p)] * 2, [0, 1], 2).value)(0.5)


def chain_of(cells, p):
    return Chain(jnp.arange(cells)[None], jnp.full((1, cells), p))
