import itertools
import math

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_chains import complete, random_chain

from jaxcell.mapping.generalized import Chain
from jaxcell.markov.arrival import Distinct, first_arrival
from jaxcell.markov.mean_arrival import mean_first_arrival
from jaxcell.markov.simulation import alias, simulate_arrival
from jaxcell.markov.walks import sample_walks


def leaving():
    """Make a chain that goes from cell 0 to cell 1 with probability 1/4, or leaves."""
    return Chain.from_scipy(np.array([[0, 0.25], [0, 1.0]]))


def hub():
    """Make a chain in which all cells lead to a cell with many branches."""
    first = np.random.default_rng(8).dirichlet(np.full(12, 0.3))
    return Chain.from_scipy(np.vstack([first, np.eye(12)[[0] * 11]]))


def distance(time, law):
    """Compute the distance of the distribution function of samples from that of a law."""
    count = np.bincount(time[np.isfinite(time)].astype(int), minlength=law.size)
    assert count[law.size :].sum() == 0
    return np.abs(np.cumsum(count[: law.size]) / time.size - np.cumsum(law)).max()


def within(runs):
    """Return a distance that is exceeded once in 10^6 times (Dvoretzky, Kiefer, Wolfowitz)."""
    return math.sqrt(math.log(2e6) / (2 * runs))


# Different robots, robots in different cells, and a cell with many branches beside cells with one.
RACES = {
    "different": (
        [random_chain(7, seed) for seed in range(3)],
        [1, [2, 3, 4], np.array([0.1, 0.2, 0.3, 0.1, 0.1, 0.1, 0.1])],
        [0, 5],
    ),
    "distinct": ([Chain.from_scipy(complete(10))] * 4, Distinct(range(10)), 3),
    "hub": ([hub()], [0], 11),
}


@pytest.mark.parametrize("name", RACES)
def test_times_follow_the_exact_law_and_its_mean(name):
    result = simulate_arrival(jax.random.key(1), *RACES[name], 40_000)
    law = np.asarray(first_arrival(*RACES[name], 4000))
    assert distance(np.asarray(result.time), law) < within(40_000)
    mean = mean_first_arrival(*RACES[name]).value
    low, high = result.interval
    assert low < result.mean < high
    assert abs(result.mean - mean) < 2.5 * (high - result.mean)


@pytest.mark.parametrize("starts", [Distinct([0, 1, 2, 4]), [3, np.eye(5)[4]]])
def test_a_batch_of_chains_has_the_times_of_each(starts):
    chains = [random_chain(5, seed) for seed in range(3)]
    image = np.tile(np.arange(5)[:, None], (1, 5))
    matrices = np.stack([chain.to_scipy().toarray() for chain in chains])

    def times(matrix, key):
        return simulate_arrival(key, [Chain(image, matrix.T)] * 2, starts, 0, 50).time

    key = jax.random.key(2)
    found = jax.jit(jax.vmap(times, (0, None)))(matrices, key)
    for time, matrix in zip(found, matrices, strict=True):
        np.testing.assert_array_equal(time, times(matrix, key))
    assert not jax.grad(lambda matrix: times(matrix, key).mean())(matrices[0]).any()


def test_starts_may_be_traced():
    def times(start):
        starts = [start, 2]
        return simulate_arrival(jax.random.key(0), [random_chain(5, 1)] * 2, starts, 0, 50).time

    for start in (np.array([0.2, 0.3, 0.4, 0.1, 0.0]), np.arange(5) > 2, np.array([1, 3])):
        np.testing.assert_array_equal(jax.jit(times)(start), times(start))


def test_all_sets_of_distinct_starts_are_equally_likely():
    # The time of robots on a circle is the distance of the nearest one.
    n, runs = 6, 60_000
    chain = Chain((np.arange(n)[None] - 1) % n, np.ones((1, n)))
    result = simulate_arrival(jax.random.key(3), [chain] * 3, Distinct(range(n)), 0, runs)
    nearest = [min(cells) for cells in itertools.combinations(range(n), 3)]
    law = np.bincount(nearest, minlength=n) / len(nearest)
    assert distance(np.asarray(result.time), law) < within(runs)


def test_mass_that_leaves_never_arrives():
    result = simulate_arrival(jax.random.key(4), [leaving()] * 2, [0, 0], 1, 20_000, horizon=20)
    arrived = np.isfinite(np.asarray(result.time))
    assert set(np.unique(result.time)) == {1.0, math.inf}
    assert arrived.mean() == pytest.approx(7 / 16, abs=within(20_000))
    assert result.mean == math.inf
    low, high = result.interval
    assert 1 < low < 20 * 9 / 16 + 1
    assert high == math.inf


@pytest.mark.parametrize("horizon", [1, 4, 5, 6])
def test_runs_past_the_horizon_are_given_up(horizon):
    n = 9
    chain = Chain((np.arange(n)[None] + 1) % n, np.ones((1, n)))
    result = simulate_arrival(jax.random.key(0), [chain], [n - 5], 0, 3, horizon=horizon)
    assert result.time.tolist() == [5 if horizon >= 5 else math.inf] * 3


def test_robots_that_begin_in_the_target_arrive_at_0():
    result = simulate_arrival(jax.random.key(0), [leaving()] * 2, [0, 1], 1, 20_000)
    assert result.time.tolist() == [0] * 20_000
    assert result.interval == (0, 0)


def test_runs_are_reproducible_from_their_key():
    times = [
        np.asarray(simulate_arrival(jax.random.key(key), [hub()], [0], 11, 20_000, horizon=9).time)
        for key in (5, 5, 6)
    ]
    np.testing.assert_array_equal(times[0], times[1])
    assert (times[0] != times[2]).any()


@given(st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_alias_tables_hold_the_distributions(slots, seed):
    draw = np.random.default_rng(seed)
    image = draw.integers(0, 5, (4, slots))
    probability = draw.dirichlet(np.full(slots, 0.5), 4) * (draw.random((4, slots)) < 0.7)
    probability[:, 0] += 1 - probability.sum(axis=1)
    first, second, part = alias(image, probability)
    assert ((part >= 0) & (part <= 1)).all()
    for row in range(4):
        expected, result = np.zeros(5), np.zeros(5)
        np.add.at(expected, image[row], probability[row])
        np.add.at(result, first[row], part[row] / slots)
        np.add.at(result, second[row], (1 - part[row]) / slots)
        np.testing.assert_allclose(result, expected, atol=1e-15)
        # Impossible outcomes stay impossible.
        assert (result[expected == 0] == 0).all()


@pytest.mark.parametrize(
    ("runs", "horizon", "message"),
    [
        (1, 9, "runs: expected 2 or more, got 1"),
        (2, 0, "horizon: expected 1 to 1073741824 steps, got 0"),
    ],
)
def test_too_few_runs_or_steps_are_refused(runs, horizon, message):
    with pytest.raises(ValueError, match=message):
        simulate_arrival(
            jax.random.key(0), [Chain.from_scipy(complete(3))], [1], 0, runs, horizon=horizon
        )
    with pytest.raises(ValueError, match="robot 0: start: cell 3 does not exist"):
        simulate_arrival(jax.random.key(0), [Chain.from_scipy(complete(3))], [3], 0)


def test_alias_tables_do_not_depend_on_rounding():
    # Equal probabilities differ in their last digit between processors.
    random = np.random.default_rng(0)
    probability = np.array([[0.1, 0.4, 0.4, 0.1], [0.25, 0.25, 0.25, 0.25], [0.5, 0.2, 0.2, 0.1]])
    image = np.tile(np.arange(4), (3, 1))
    first, second, part = alias(image, probability)
    for _ in range(20):
        rounded = probability * (1 + 1e-15 * random.uniform(-1, 1, probability.shape))
        tables = alias(image, rounded)
        np.testing.assert_array_equal(tables[0], first)
        np.testing.assert_array_equal(tables[1][part < 1 - 1e-12], second[part < 1 - 1e-12])
        np.testing.assert_allclose(tables[2], part, atol=1e-12)


def test_walks_follow_the_chain():
    matrix = np.array([[0.0, 0.25, 0.75], [1.0, 0.0, 0.0], [0.5, 0.5, 0.0]])
    starts = np.array([0, 1] * 50)
    walks = sample_walks(Chain.from_scipy(matrix), starts, 200, np.random.default_rng(0))
    assert walks.shape == (201, 100)
    np.testing.assert_array_equal(walks[0], starts)
    steps = np.zeros((3, 3))
    np.add.at(steps, (walks[:-1].ravel(), walks[1:].ravel()), 1)
    # The standard error of a share of some 6,000 steps is below 0.007.
    np.testing.assert_allclose(steps / steps.sum(axis=1, keepdims=True), matrix, atol=0.03)
    assert (steps[matrix == 0] == 0).all()


@pytest.mark.parametrize("horizon", [3, 1000])
def test_the_interval_is_the_same_in_a_program(horizon):
    chain = Chain.from_scipy(np.array([[0.75, 0.25], [0, 1.0]]))

    def interval(chain):
        return simulate_arrival(jax.random.key(2), [chain], [0], 1, 200, horizon=horizon).interval

    low, high = interval(chain)
    assert isinstance(low, float)
    assert isinstance(high, float)
    np.testing.assert_allclose(jax.jit(interval)(chain), (low, high), rtol=1e-12)
