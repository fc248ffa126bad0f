"""Chains with correlated normal noise, compared with a distribution function of SciPy and runs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from jaxcell import dynamics
from jaxcell.space import Box


def rectangles(mean, covariance, low, high):
    """Compute the probabilities of rectangles whose corners are arrays `[rectangles, 2]`."""
    law = multivariate_normal(mean, covariance)
    corners = [[np.where([right, up], high, low) for right in (0, 1)] for up in (0, 1)]
    below = [[law.cdf(np.clip(corner, -60, 60)) for corner in row] for row in corners]
    return below[1][1] - below[1][0] - below[0][1] + below[0][0]


@pytest.mark.parametrize("correlation", [0.5, -0.95])
@pytest.mark.parametrize(
    "kinds", [("sink", "sink"), ("clamp", "sink"), ("sink", "clamp"), ("periodic", "periodic")]
)
def test_cells_have_the_probabilities_of_the_bivariate_normal_law(kinds, correlation):
    deviation = np.array([0.4, 0.25])
    covariance = np.outer(deviation, deviation) * [[1, correlation], [correlation, 1]]
    lower, upper, mean = np.array([-1, -0.9]), np.array([0.8, 0.9]), np.array([-0.33, 0.52])
    box = Box(lower, upper, [12, 12], kinds)
    row = dynamics.chain(lambda x, p: 0 * x + mean, box, noise=covariance).to_scipy()[[17]]
    centre = box.centre(np.arange(144, dtype=np.int32))
    low, high = centre - box.width / 2, centre + box.width / 2
    clamped = np.array(kinds) == "clamp"
    low = np.where(clamped & (low < lower + 1e-9), -np.inf, low)
    high = np.where(clamped & (high > upper - 1e-9), np.inf, high)
    turns = range(-2, 3) if kinds[0] == "periodic" else [0]
    moves = [np.array([i, j]) * (upper - lower) for i in turns for j in turns]
    known = sum(rectangles(mean, covariance, low + move, high + move) for move in moves)
    assert known.max() < 0.3
    np.testing.assert_allclose(row.toarray()[0, :144], known, rtol=0, atol=1e-8)


@pytest.mark.parametrize("kinds", ["clamp", "periodic", ("periodic", "clamp")])
def test_correlated_noise_loses_no_mass(kinds):
    box = Box([-1, -1], [1, 1], [10, 9], kinds)
    noise = np.array([[0.04, -0.03], [-0.03, 0.09]])
    chain = dynamics.chain(lambda x, p: 3 * x, box, noise=noise, deviations=3.0)
    np.testing.assert_allclose(chain.probability.sum(axis=0), 1, rtol=1e-13)


def test_time_to_leave_is_that_of_runs():
    box = Box([-1, -1], [1, 1], [20, 20])
    covariance = np.array([[0.09, 0.06], [0.06, 0.0625]])

    def turned(x, p):
        return 0.8 * jnp.stack([x[0] - 0.3 * x[1], x[1] + 0.3 * x[0]])

    found = dynamics.escape(turned, box, noise=covariance, start=[0.1, 0.0])
    apart = dynamics.escape(turned, box, noise=(0.3, 0.25), start=[0.1, 0.0])
    rng, runs = np.random.default_rng(1), 100_000
    place, time = np.tile([0.1, 0.0], (runs, 1)), np.zeros(runs)
    root = np.linalg.cholesky(covariance)
    alive = np.arange(runs)
    while alive.size:
        time[alive] += 1
        x, y = place[alive].T
        image = 0.8 * np.stack([x - 0.3 * y, y + 0.3 * x], axis=1)
        place[alive] = image + rng.normal(size=(alive.size, 2)) @ root.T
        alive = alive[(np.abs(place[alive]) < 1).all(axis=1)]
    error = time.std() / runs**0.5
    assert abs(found.mean_time - time.mean()) < min(3 * error, found.mean_time_error)
    assert abs(apart.mean_time - time.mean()) > 20 * error


@pytest.mark.parametrize(
    ("noise", "axes", "message"),
    [
        (np.eye(3), 3, "noise: a covariance matrix is for a box with two axes, got 3"),
        (np.eye(3), 2, r"noise: expected a covariance matrix of two rows .* got \[3, 3\]"),
        (np.array([[1, 2], [2, 1]]), 2, "noise: expected .* eigenvalues above 0, got -1;"),
        (0.1 * np.ones((2, 2)), 2, "noise: expected .* eigenvalues above 0, got .*; noise along"),
        (np.array([[1, 0.1], [0.2, 1]]), 2, "noise: expected a symmetric covariance .* got 0.1 "),
    ],
)
def test_wrong_matrices_are_refused(noise, axes, message):
    with pytest.raises(ValueError, match=message):
        dynamics.chain(lambda x, p: x, Box([0] * axes, [1] * axes, [4] * axes), noise=noise)


def test_a_matrix_is_refused_where_only_deviations_are_known():
    box, noise = Box([0, 0], [1, 1], [4, 4]), np.array([[1, 0.5], [0.5, 1]])
    with pytest.raises(ValueError, match="gradient: there is none by"):
        dynamics.escape(lambda x, p: x, box, noise=noise, gradient=True)
    with pytest.raises(ValueError, match=r"noise: a flow has independent .* \(numpy.linalg"):
        dynamics.escape(dynamics.flow(lambda x, p: -x, dt=0.1), box, noise=noise)
    only = "noise: a covariance matrix is only for maps"
    with pytest.raises(ValueError, match=only):
        jax.jit(lambda a: dynamics.chain(lambda x, p: a * x, box, a, noise=noise).probability)(0.5)
