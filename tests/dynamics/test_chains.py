import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from scipy.stats import norm

from jaxcell import dynamics, mapping, markov
from jaxcell.dynamics import systems
from jaxcell.space import Box


def limiting(chain):
    return np.asarray(markov.limiting_distribution(chain, mapping.persistent_groups(chain)).value)


def test_chain_of_logistic_map_equals_ulams_matrix():
    cells, samples = 64, 400
    chain = dynamics.chain(
        lambda x, p: 4 * x * (1 - x), Box([0], [1], [cells], "clamp"), samples=samples
    )
    # The exact shares of a cell, by both branches of the inverse.
    edges = np.linspace(0, 1, cells + 1)
    low = (1 - np.sqrt(1 - edges)) / 2
    exact = np.zeros((cells, cells))
    for ends in (low, 1 - low):
        left, right = np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:])
        both = np.minimum(right, edges[1:, None]) - np.maximum(left, edges[:-1, None])
        exact += np.maximum(both, 0) * cells
    np.testing.assert_allclose(exact.sum(axis=1), 1)
    # Points are spread evenly, so the errors are smaller than those of random points.
    assert np.abs(chain.to_scipy().toarray() - exact).max() < 0.01
    # The density is that of the arc sine, from which the exact matrix of 64 cells differs by 0.14.
    density = np.diff(2 / np.pi * np.arcsin(np.sqrt(edges)))
    assert np.abs(limiting(chain) - density).sum() < 0.2


def test_noise_has_the_moments_of_a_linear_map():
    box, decay, noise = Box([-3, -1], [3, 1], [150, 3], "clamp"), 0.6, 0.4

    def linear(x, p):
        return jnp.stack([decay * x[0], x[1]])

    chain = dynamics.chain(linear, box, noise=(noise, 0.0))
    places = box.centre(np.arange(box.size, dtype=np.int32))[:, 0]
    here = int(box.index(np.array([1.0, 0.0])))
    row = chain.to_scipy().toarray()[here]
    found = [float(row @ (places - decay * places[here]) ** k) for k in (0, 1, 2, 4)]
    np.testing.assert_allclose(found, [1, 0, noise**2, 3 * noise**4], atol=0.001)
    # In the limit each of the three rows is normal, of this deviation.
    mass = limiting(chain)
    assert mass @ places**2 == pytest.approx(noise**2 / (1 - decay**2), rel=0.002)
    np.testing.assert_allclose(mass.reshape(150, 3).sum(axis=0), 1 / 3)


def test_far_probabilities_have_all_their_digits():
    # The image of each cell is the point (0, 0).
    box = Box([-1.2, -1], [1.2, 1], [24, 20], ("sink", "clamp"))
    with pytest.warns(UserWarning, match="noise: leads out of the box"):
        row = dynamics.chain(lambda x, p: 0 * x, box, noise=(0.15, 0.125)).to_scipy()[[0]]
    row = row.toarray().reshape(24, 20)
    faces = np.linspace(-1.2, 1.2, 25)[12:] / 0.15, np.linspace(-1, 1, 21)[10:] / 0.125
    along, aside = (norm.sf(x[:-1]) - norm.sf(x[1:]) for x in faces)
    # Beyond the last cell there are more cells of a clamped axis, and the sink of the other one.
    aside[-1] = norm.sf(faces[1][-2])
    assert along[-1] * aside[-1] < 1e-25
    np.testing.assert_allclose(row[12:, 10:], np.outer(along, aside), rtol=1e-10)
    np.testing.assert_allclose(row[:12, :10], row[:11:-1, :9:-1], rtol=1e-10)


@pytest.mark.parametrize("kind", ["clamp", "periodic"])
def test_noise_that_is_cut_loses_no_mass(kind):
    chain = dynamics.chain(
        lambda x, p: 3 * x, Box([-1], [1], [80], kind), noise=0.1, deviations=2.0
    )
    np.testing.assert_allclose(chain.probability.sum(axis=0), 1, rtol=1e-14)
    np.testing.assert_allclose(chain.half.probability.sum(axis=0), 1, rtol=1e-14)


def test_wide_noise_on_a_ring_is_uniform():
    chain = dynamics.chain(lambda x, p: x, Box([0], [1], [7], "periodic"), noise=3.0)
    np.testing.assert_allclose(chain.to_scipy().toarray(), 1 / 7, rtol=1e-12)


def decays(time, kind):
    """Return a chain of an Ornstein-Uhlenbeck process that exits [-1.5, 1.5], and its numbers."""
    factor = np.exp(-time)
    deviation = np.sqrt((1 - factor**2) / 2)
    box = Box([-4.5 if kind == "clamp" else -1.5], [4.5], [300 if kind == "clamp" else 200], kind)
    chain = dynamics.chain(lambda x, p: factor * x, box, noise=deviation)
    return chain, box.ticks(0), factor, deviation


def integrated(gain, places, factor, deviation):
    """Solve for the sum of gains before the exit, by 200 points of a Gauss-Legendre rule."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    nodes, weights = 1.5 * nodes, 1.5 * weights

    def step(x):
        return norm.pdf(nodes, factor * x[:, None], deviation) * weights

    value = np.linalg.solve(np.eye(200) - step(nodes), gain(nodes))
    return gain(places) + step(places) @ value


@pytest.mark.parametrize(("time", "largest"), [(0.5, 0.004), (0.1, 0.04)])
def test_times_and_committors_move_by_more_than_their_error(time, largest):
    chain, places, *step = decays(time, "clamp")
    times = markov.hitting_times(chain, np.abs(places) > 1.5)
    near = np.abs(places) < 1
    exact = integrated(lambda x: np.ones(x.size), places[near], *step)
    error = np.abs(np.asarray(times.value)[near] / exact - 1)
    assert error.max() < (np.asarray(times.moved)[near] / exact).max() < largest

    chain, places, factor, deviation = decays(time, "sink")
    found = markov.arrival_probabilities(chain, places > 1.5)
    near = np.abs(places) < 1
    exact = integrated(
        lambda x: norm.sf(1.5, factor * x, deviation), places[near], factor, deviation
    )
    error = np.abs(np.asarray(found.value)[near] - exact)
    assert error.max() < np.asarray(found.moved)[near].max() < 0.06


def test_images_outside_the_box_go_to_the_sink():
    box = Box([0], [1], [4])
    chain = dynamics.chain(lambda x, p: x + 0.5, box, samples=8)
    np.testing.assert_allclose(chain.leaving, [0, 0, 1, 1])
    assert chain.to_scipy().toarray()[:2, 2:].tolist() == [[1, 0], [0, 1]]


def test_chain_is_reproducible_from_its_key():
    box = Box([0], [1], [8], "periodic")
    one, same, other = (
        dynamics.chain(lambda x, p: x, box, noise=0.3, key=jax.random.key(k)) for k in (1, 1, 2)
    )
    probability = np.asarray(one.probability)
    np.testing.assert_array_equal(probability, same.probability)
    assert (probability != np.asarray(other.probability)).any()


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"deviations": 0.5}, "deviations"),
        ({"deviations": float("inf")}, "deviations"),
        ({"samples": 0}, "samples"),
        ({"noise": -1.0}, "noise"),
        ({"noise": float("nan")}, "noise"),
    ],
)
def test_bad_options_are_refused(options, field):
    with pytest.raises(ValueError, match=field):
        dynamics.chain(lambda x, p: x, Box([0], [1], [4]), **options)


def test_groups_of_duffing_chain_equal_sun_and_xiong():
    duffing = systems.duffing
    box = Box(duffing.box.lower, duffing.box.upper, [100, 100])
    chain = dynamics.chain(duffing.map, box, duffing.params, samples=25)
    # Their random points gave 42,139 images, one persistent group of 420 cells, and two transient
    # classes of 21 and 3 cells. Points that are spread evenly reach a few more cells.
    matrix = chain.to_scipy()
    assert 42_139 < matrix.nnz < 1.05 * 42_139
    groups = mapping.persistent_groups(chain)
    persistent = np.asarray(groups.group) >= 0
    _, component = connected_components(matrix, directed=True, connection="strong")
    sizes = np.sort(np.bincount(component[~persistent]))[::-1]
    assert int(groups.count) == 1
    assert np.count_nonzero(persistent) == pytest.approx(420, rel=0.03)
    assert 15 < sizes[sizes > 1].sum() < 35


def test_a_box_that_is_left_too_rarely_for_64_bits_is_reported():
    with pytest.warns(UserWarning, match="noise: leads out of the box with less than 1e-12"):
        dynamics.chain(lambda x, p: 0 * x, Box([-1], [1], [40]), noise=0.12)


def _parabola(x, p):
    return p * x * (1 - x)


def _shear(x, p):
    return jnp.stack([p * x[0] + 0.3 * x[1], jnp.sin(x[0])])


@pytest.mark.parametrize(
    ("map", "box", "noise"),
    [
        (_parabola, Box([0], [1], cells=[40]), 0.05),
        (_parabola, Box([0], [1], cells=[40], axes="periodic"), 0.3),
        (_parabola, Box([0], [1], cells=[40]), 0.0),
        (_shear, Box([-1, -1], [1, 1], cells=[9, 12], axes=["clamp", "sink"]), (0.1, 0.3)),
        (_shear, Box([-1, -1], [1, 1], cells=[9, 12], axes=["sink", "periodic"]), (0.0, 0.1)),
    ],
)
def test_a_traced_chain_has_the_probabilities_of_the_chain_of_each_parameter(map, box, noise):
    def chain(param):
        return dynamics.chain(map, box, param, samples=5, noise=noise)

    found = jax.jit(jax.vmap(chain))(jnp.array([3.2, 0.7]))
    assert found.half is None
    for k, param in enumerate([3.2, 0.7]):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            expected = chain(param).to_scipy().toarray()
        np.testing.assert_array_equal(found.image[k][:, -1], np.arange(box.size))
        np.testing.assert_allclose(found.probability[k].T, expected, rtol=1e-9, atol=1e-14)


def test_a_chain_has_derivatives_by_its_parameters_and_its_noise():
    box = Box([0], [1], cells=[40])
    worth = np.random.default_rng(0).random(box.size)

    def mean_square(param, noise):
        chain = dynamics.chain(_parabola, box, param, samples=5, noise=noise)
        return jnp.mean(chain.pull(worth) ** 2)

    found = jax.grad(mean_square, (0, 1))(3.2, 0.05)
    step = 1e-5
    by_param = mean_square(3.2 + step, 0.05) - mean_square(3.2 - step, 0.05)
    by_noise = mean_square(3.2, 0.05 + step) - mean_square(3.2, 0.05 - step)
    np.testing.assert_allclose(found, (by_param / (2 * step), by_noise / (2 * step)), rtol=1e-6)


def test_traced_noise_along_a_periodic_axis_is_refused():
    ring = Box([0], [1], cells=[8], axes="periodic")
    with pytest.raises(ValueError, match="noise: along a periodic axis expected a number"):
        jax.jit(lambda noise: dynamics.chain(_parabola, ring, 3.2, noise=noise))(0.1)
