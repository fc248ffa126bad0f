"""Derivatives of leading modes, against closed forms and differences of NumPy's eigenvectors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell.mapping import Chain, ChainSequence
from jaxcell.markov import leading_modes


def chain_of(P):
    cells = P.shape[-1]
    return Chain(np.tile(np.arange(cells)[:, None], (1, cells)), P.T)


def eigenvectors(matrix, count):
    """Leading eigenvalues and vectors; the largest number of a right vector is 1, and `m f` is."""
    values, right = np.linalg.eig(matrix)
    order = np.argsort(-values.real, kind="stable")
    left = np.linalg.inv(right)[order]
    right = right[:, order].T
    most = right[np.arange(len(right)), np.abs(right).argmax(axis=1)][:, None]
    return values[order][:count], (right / most)[:count], (left * most)[:count]


def random_matrix(rng, cells):
    P = rng.random((cells, cells)) ** 3
    return P / P.sum(axis=1, keepdims=True)


def test_the_modes_of_two_cells_have_the_derivatives_of_the_closed_form():
    """The value is `1 - p - q`, the function `(1, -q/p)` and the measure `(p, -p) / (p + q)`."""

    def modes(p, q):
        found = leading_modes(chain_of(jnp.array([[1 - p, p], [q, 1 - q]])), 2)
        return found.value[1].real, found.right[1].real, found.left[1].real

    p, q = 0.4, 0.1
    for place, given in enumerate(jax.jit(jax.jacrev(modes, argnums=0))(p, q)):
        expected = [-1, [0, q / p**2], [q / (p + q) ** 2, -q / (p + q) ** 2]][place]
        np.testing.assert_allclose(given, expected, rtol=1e-12, atol=1e-14)
    for place, given in enumerate(jax.jit(jax.jacfwd(modes, argnums=1))(p, q)):
        expected = [-1, [0, -1 / p], [-p / (p + q) ** 2, p / (p + q) ** 2]][place]
        np.testing.assert_allclose(given, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("cells", [6, 230])
@pytest.mark.parametrize("steps", [1, 3])
def test_modes_of_a_batch_have_derivatives(cells, steps):
    rng = np.random.default_rng(cells + steps)
    weights = rng.normal(size=(2, cells))
    matrices = np.stack([random_matrix(rng, cells) for _ in range(3)])
    change = rng.normal(size=matrices.shape) * matrices
    change -= change.sum(axis=2, keepdims=True) * matrices

    def total(P):
        found = leading_modes(chain_of(P), 2, steps=steps)
        return found.value.real.sum() + jnp.sum(weights * (found.right + found.left).real)

    def exact(P):
        values, right, left = eigenvectors(np.linalg.matrix_power(P, steps), 2)
        return values.real.sum() + np.sum(weights * (right + left).real)

    found, slope = (jax.jit(jax.vmap(f))(matrices) for f in (total, jax.grad(total)))
    h = 1e-6
    for P, d, value, gradient in zip(matrices, change, found, slope, strict=True):
        assert np.isclose(value, exact(P), rtol=1e-7)
        central = (exact(P + h * d) - exact(P - h * d)) / (2 * h)
        assert np.isclose(np.sum(gradient * d), central, rtol=1e-5)


def test_modes_of_a_sequence_have_derivatives():
    rng = np.random.default_rng(0)
    first, second = (random_matrix(rng, 5) for _ in range(2))
    image = jnp.tile(jnp.arange(5)[:, None], (2, 1, 5))

    def value(t):
        both = jnp.stack([(1 - t) * first.T + t * second.T, second.T])
        return leading_modes(ChainSequence(image, both), 2).value[1].real

    def exact(t):
        return eigenvectors(((1 - t) * first + t * second) @ second, 2)[0][1].real

    assert np.isclose(jax.jit(value)(0.3), exact(0.3), rtol=1e-10)
    central = (exact(0.3 + 1e-6) - exact(0.3 - 1e-6)) / 2e-6
    assert np.isclose(jax.grad(value)(0.3), central, rtol=1e-6)


def test_vectors_of_an_eigenvalue_that_is_not_simple_have_no_derivative():
    """Two closed cells have the eigenvalue 1 twice, so its eigenvectors are not unique."""
    P = np.array([[1.0, 0, 0], [0, 1, 0], [0.25, 0.25, 0.5]])
    found = jax.jacfwd(lambda P: leading_modes(chain_of(P), 2).right)(P)
    assert np.isnan(found).any()
    whole = jax.jit(lambda P: leading_modes(chain_of(P), 2).value)(P)
    np.testing.assert_allclose(whole, 1, rtol=1e-12)


def test_a_pair_of_values_is_split_in_a_program():
    """The values of a cycle of three cells are the cube roots of 1."""
    P = np.roll(np.eye(3), 1, axis=1)
    assert leading_modes(chain_of(P), 2).value.shape == (3,)
    values = jax.jit(lambda P: leading_modes(chain_of(P), 2).value)(P)
    np.testing.assert_allclose(values[0], 1, atol=1e-12)
    np.testing.assert_allclose(values[1].real, -0.5, atol=1e-12)
