"""Rare events of maps with normal noise, compared with Nystrom's method on the exact kernel."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from jaxcell import dynamics, mapping, markov
from jaxcell.space import Box


def legendre(low, high, count=400):
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return low + (nodes + 1) * (high - low) / 2, weights * (high - low) / 2


def summed(map, noise, low, high, gain, places):
    """Sum gains until `low` to `high` is left, from places; the kernel is a normal density."""
    nodes, weights = legendre(low, high)

    def step(x):
        return norm.pdf(nodes, map(x)[:, None], noise) * weights

    value = np.linalg.solve(np.eye(nodes.size) - step(nodes), gain(nodes))
    return gain(places) + step(places) @ value


def leaving_times(chain):
    return markov.absorption_times(chain, mapping.persistent_groups(chain)).value


# Faces of cells, from 3.5 to 5 standard deviations of the stationary distribution.
@pytest.mark.parametrize("height", [1.0, 1.28, 1.44])
def test_time_to_exceed_several_deviations_equals_that_of_the_exact_kernel(height):
    box = Box([-2.4], [2.4], [240], "clamp")
    places = box.ticks(0)
    chain = dynamics.chain(lambda x, p: x / 2, box, noise=0.25)
    found = markov.hitting_times(chain, np.abs(places) > height)
    (exact,) = summed(lambda x: x / 2, 0.25, -height, height, np.ones_like, np.zeros(1))
    time, moved = (np.interp(0, places, x) for x in (found.value, found.moved))
    assert abs(time - exact) < moved < 0.02 * exact


def test_time_to_extinction_of_a_noisy_ricker_map():
    # In logarithms. Nystrom's method with 400 and 800 nodes agree on 11,137 years.
    box = Box([-3], [2], [400])
    chain = dynamics.chain(lambda x, p: x + 1.5 * (1 - jnp.exp(x)), box, noise=0.35)
    assert int(mapping.persistent_groups(chain).count) == 0
    time, moved = (
        np.interp(0, box.ticks(0), x)
        for x in (leaving_times(chain), dynamics.moved(leaving_times, chain))
    )
    assert abs(time - 11136.608) < moved < 120


def test_events_beyond_the_cut_of_the_noise_move_without_bound():
    # The next point is 0 up to noise of 0.1: 0.7 is seven standard deviations away.
    box = Box([-1], [1], [100], "clamp")
    target = box.ticks(0) > 0.7
    chain = dynamics.chain(lambda x, p: 0 * x, box, noise=0.1, deviations=6.0)
    found = markov.hitting_times(chain, target)
    assert np.isinf(found.value[~target]).all()
    assert np.isinf(found.moved[~target]).all()


@pytest.mark.parametrize("deviations", [2.0, 4.0, 6.0, 7.0])
def test_events_within_the_cut_of_the_noise_have_all_their_digits(deviations):
    box = Box([-1], [1], [100], "clamp")
    target = box.ticks(0) > 0.1 * deviations
    found = markov.hitting_times(dynamics.chain(lambda x, p: 0 * x, box, noise=0.1), target)
    np.testing.assert_allclose(found.value[~target], 1 / norm.sf(deviations), rtol=1e-9)


def test_mean_first_passage_on_coarse_cells_in_three_dimensions():
    # Three competing species: the shares of space, and the time until the first falls below 0.2.
    weights = np.array([[1, 0.6, 0.7], [0.7, 1, 0.6], [0.6, 0.7, 1]])
    noise, cells = 0.06, 12

    def grow(x, p):
        return x * jnp.exp(0.8 * (1 - jnp.asarray(weights) @ x))

    box = Box([0] * 3, [1] * 3, [cells] * 3, "clamp")
    chain = dynamics.chain(grow, box, noise=noise)
    target = np.repeat(np.arange(cells) < 2, cells**2)
    found = markov.hitting_times(chain, target)
    at = int(box.index(np.full(3, 0.43)))
    rng, walks = np.random.default_rng(0), 4000
    x, times, alive = np.tile(box.centre(np.array([at])), (walks, 1)), np.zeros(walks), None
    alive = np.ones(walks, bool)
    while alive.any():
        mean = x[alive] * np.exp(0.8 * (1 - x[alive] @ weights.T))
        x[alive] = np.clip(mean + noise * rng.standard_normal(mean.shape), 0, 1)
        times += alive
        alive &= x[:, 0] >= 2 / cells
    error = abs(float(found.value[at]) - times.mean())
    assert error < float(found.moved[at]) + 4 * times.std() / np.sqrt(walks)
    # Cells of this size are too coarse, and the estimate says so.
    assert found.moved[at] > 0.1 * found.value[at]


MAPS = {
    "linear": lambda x, p: p * x,
    "cubic": lambda x, p: x + 0.6 * p * (x - x**3),
    "step": lambda x, p: 1.6 * jnp.tanh(2 * p * x),
    "sine": lambda x, p: x + p * jnp.sin(2.5 * x),
    "ricker": lambda x, p: jnp.maximum(x + 1.5 * p * (1 - jnp.exp(x)), -5),
}
RANDOM = 20


@pytest.mark.parametrize("name", MAPS)
def test_errors_of_random_systems_are_below_their_estimates(name):
    """Compares 20 systems per map, each by a time and a probability: 200 estimates."""
    rng, ratios = np.random.default_rng(len(name)), []
    while len(ratios) < 2 * RANDOM:
        share, noise = rng.uniform([0.3, 0.2], [0.9, 0.5])
        cells = int(rng.choice([40, 100]))
        box, inside = Box([-2], [2], [cells]), int(cells * rng.uniform(0.75, 0.92))
        places, face = box.ticks(0), -2 + inside * 4 / cells

        def image(x, share=share):
            return np.asarray(MAPS[name](jnp.asarray(x), share))

        times = summed(image, noise, -2, 2, np.ones_like, places)
        # The exact solution itself loses as many digits as the time has.
        if not 0 < times.max() < 1e10:
            continue
        chain = dynamics.chain(MAPS[name], box, jnp.asarray(share), noise=noise)
        error = np.abs(np.asarray(leaving_times(chain)) - times).max()
        ratios.append(dynamics.moved(leaving_times, chain).max() / error)

        def enters(x, image=image, noise=noise, face=face):
            return norm.sf(face, image(x), noise) - norm.sf(2, image(x), noise)

        before = places[:inside]
        arrives = summed(image, noise, -2, face, enters, before)
        found = markov.arrival_probabilities(chain, places > face)
        error = np.abs(np.asarray(found.value)[:inside] - arrives).max()
        ratios.append(np.asarray(found.moved)[:inside].max() / error)
    assert np.quantile(ratios, 0.05) > 1
    assert np.median(ratios) < 10


def test_errors_of_long_run_distributions_and_first_passages_are_below_their_estimates():
    def distribution(chain):
        return markov.limiting_distribution(chain, mapping.persistent_groups(chain)).value

    def arrivals(chain):
        return markov.first_passage(chain, 30, np.arange(60) >= 50, 12)

    box = Box([0], [2 * np.pi], [60], "periodic")
    nodes = np.linspace(0, 2 * np.pi, 600, endpoint=False)
    faces = np.linspace(0, 2 * np.pi, 61)
    for share, noise in [(0.9, 0.3), (0.5, 0.5), (1.4, 0.2), (1.8, 0.4)]:

        def image(x, share=share):
            return x + 0.4 + share * np.sin(x)

        def kernel(ends, x, image=image, noise=noise):
            turns = 2 * np.pi * np.arange(-3, 4)[:, None, None]
            return norm.pdf(ends + turns, image(x)[:, None], noise).sum(axis=0)

        chain = dynamics.chain(
            lambda x, p: x + 0.4 + p * jnp.sin(x), box, jnp.asarray(share), noise=noise
        )
        step = kernel(nodes, nodes) * nodes[1]
        density = np.linalg.matrix_power(step, 400)[0] / nodes[1]
        within = 2 * np.pi * np.arange(-3, 4)[:, None, None]
        below = norm.cdf(faces + within, image(nodes)[:, None], noise).sum(axis=0)
        exact = density * nodes[1] @ np.diff(below)
        error = np.abs(np.asarray(distribution(chain)) - exact).max()
        assert error < dynamics.moved(distribution, chain).max() < 30 * error + 1e-6

        # Steps from the middle of cell 30 until cells 50 to 59, by a rule on the other arc.
        arc, weights = legendre(0, faces[50], 300)
        hits = np.diff(
            norm.cdf(
                np.stack([faces[50] + within[:, 0], 2 * np.pi + within[:, 0]], -1)[:, 0],
                image(arc)[:, None, None],
                noise,
            )
        ).sum(axis=(1, 2))
        first, weight = legendre(faces[30], faces[31], 16)
        mass = weight / (faces[31] - faces[30])
        law, start = (
            [0.0],
            np.diff(
                norm.cdf(
                    np.stack([faces[50] + within[:, 0], 2 * np.pi + within[:, 0]], -1)[:, 0],
                    image(first)[:, None, None],
                    noise,
                )
            ).sum(axis=(1, 2)),
        )
        law.append(mass @ start)
        spread = mass @ kernel(arc, first) * weights
        for _ in range(11):
            law.append(spread @ hits)
            spread = spread @ kernel(arc, arc) * weights
        error = np.abs(np.asarray(arrivals(chain)) - law).max()
        assert error < dynamics.moved(arrivals, chain).max()
