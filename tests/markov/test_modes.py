"""Derivatives of leading modes, against closed forms and differences of NumPy's eigenvectors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse.linalg

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


def periodic_matrix(rng, cells, period):
    """Make a random chain that moves between `period` groups of cells in turn."""
    group = np.append(np.arange(period), rng.integers(0, period, cells - period))
    P = rng.random((cells, cells)) * (group == (group[:, None] + 1) % period)
    return P / P.sum(axis=1, keepdims=True)


def ring_matrix(rng, cells):
    """Make a ring with two shortcuts: many of its values are complex."""
    P = np.roll(np.eye(cells), 1, axis=1)
    for _ in range(2):
        P[rng.integers(cells), rng.integers(cells)] += rng.random()
    return P / P.sum(axis=1, keepdims=True)


def small_matrix(seed):
    rng = np.random.default_rng(seed)
    cells = int(rng.integers(2, 9))
    if seed % 4 == 0:
        return random_matrix(rng, cells)
    if seed % 4 == 1:
        return periodic_matrix(rng, cells, int(rng.integers(2, cells + 1)))
    if seed % 4 == 2:
        return ring_matrix(rng, cells)
    # Every value is there twice.
    half = ring_matrix(rng, cells // 2 + 1)
    cell = rng.permutation(2 * len(half))
    return np.kron(np.eye(2), half)[cell][:, cell]


def in_order(values):
    """Sort as documented, one value at a time."""
    left = list(values)
    found = []
    while left:
        top = max(value.real for value in left)
        ties = [value for value in left if value.real > top - 1e-7 and value.imag > -1e-12]
        first = max(ties, key=abs)
        found.append(first)
        left.remove(first)
        if first.imag > 1e-12:
            pair = min(left, key=lambda value: abs(value - first.conjugate()))
            found.append(pair)
            left.remove(pair)
    return np.array(found)


def residuals(P, modes):
    value = modes.value[:, None]
    right = modes.right @ P.T - value * modes.right
    left = modes.left @ P - value * modes.left
    return [np.abs(part).max() for part in (right, left / np.abs(modes.left).max())]


@pytest.mark.parametrize("seed", range(200))
def test_each_value_has_its_vectors_for_every_count(seed):
    P = small_matrix(seed)
    values, vectors = np.linalg.eig(P)
    if np.linalg.cond(vectors) > 1e6:
        pytest.skip("not enough eigenvectors")
    values = in_order(values)
    for count in range(1, len(P) + 1):
        modes = leading_modes(chain_of(P), count)
        kept = modes.value.size
        # Rounding errors may make a pair of two equal values.
        double = kept > count and abs(values[count] - values[count - 1]) < 1e-7
        assert kept == count + (values[count - 1].imag > 1e-9) or double
        np.testing.assert_allclose(modes.value, values[:kept], atol=1e-7)
        np.testing.assert_allclose(residuals(P, modes), 0, atol=1e-7)
        np.testing.assert_allclose(modes.left @ modes.right.T, np.eye(kept), atol=1e-7)


@pytest.mark.parametrize("seed", range(0, 200, 5))
def test_simple_values_have_derivatives_for_every_count(seed):
    """Derivatives are compared with differences between the modes of two matrices nearby."""
    P = small_matrix(seed)
    values, vectors = np.linalg.eig(P)
    distance = np.abs(values - values[:, None]) + 2 * np.eye(len(P))
    if distance.min() < 1e-3 or np.linalg.cond(vectors) > 1e3:
        pytest.skip("not simple")
    change = np.random.default_rng(seed).normal(size=P.shape) * P
    change -= change.sum(axis=1, keepdims=True) * P
    h = 1e-6
    beside = [eigenvectors(P + step * change, len(P)) for step in (-h, h)]

    def modes(t, count):
        found = leading_modes(chain_of(P + t * change), count)
        return found.value, found.right, found.left

    for count in range(1, len(P) + 1):
        both = jax.jit(lambda t, count=count: jax.jvp(lambda t: modes(t, count), (t,), (1.0,)))
        found, slope = jax.device_get(both(0.0))
        for mode, value in enumerate(found[0]):
            most = np.argmax(np.abs(found[1][mode] - 1) < 1e-12)
            ends = []
            for near, right, left in beside:
                n = np.argmin(np.abs(near - value))
                ends.append((near[n], right[n] / right[n, most], left[n] * right[n, most]))
            for part, low, high in zip(slope, *ends, strict=True):
                np.testing.assert_allclose(part[mode], (high - low) / (2 * h), atol=1e-5)


def six_cells(q):
    """Make a chain of period 2 with the values 1, -1 and two pairs without a real part."""
    image = jnp.array([[5, 0, 1, 2, 3, 2], [0, 1, 2, 3, 4, 4]])
    stays = jnp.ones(6).at[5].set(q)
    return Chain(image, jnp.stack([stays, 1 - stays]))


@pytest.mark.parametrize("count", range(1, 7))
def test_of_pairs_without_a_real_part_the_larger_leads(count):
    """The squares of the values are 1 and the roots of `x^2 + x + 1 - q`."""
    q = 0.896
    large, small = (np.sqrt((1 + side * np.sqrt(4 * q - 3)) / 2) * 1j for side in (1, -1))
    # `2 value dvalue = d(x)`, and `dx = 1 / (2 x + 1)`.
    pairs = [value for each in (large, small) for value in (each, -each)]
    values = np.array([1, *pairs, -1])
    slopes = np.array([0, *(1 / (2 * value * (2 * value**2 + 1)) for value in pairs), 0])
    found, slope = jax.jit(
        lambda q: jax.jvp(lambda q: leading_modes(six_cells(q), count).value, (q,), (1.0,))
    )(q)
    np.testing.assert_allclose(found, values[:count], atol=1e-12)
    np.testing.assert_allclose(slope, slopes[:count], atol=1e-10)
    eager = leading_modes(six_cells(q), count).value
    assert eager.size == [1, 3, 3, 5, 5, 6][count - 1]
    np.testing.assert_allclose(eager, values[: eager.size], atol=1e-12)


def many_cells(name):
    """Make chains of 240 cells with many values that tie in their real parts."""
    rng = np.random.default_rng(3)
    if name == "split":
        # Each of the six cells is split into 40, between which the chain draws again.
        inner = np.tile(rng.dirichlet(np.ones(40)), (40, 1))
        return np.kron(six_cells(0.896).to_scipy().todense(), inner)
    if name == "copies":
        return np.kron(np.eye(2), periodic_matrix(rng, 120, 3))
    return periodic_matrix(rng, 240, 2)


@pytest.mark.parametrize("name", ["split", "copies", "period 2"])
@pytest.mark.parametrize("count", [2, 3, 5])
def test_ties_lead_by_modulus_in_chains_of_many_cells(name, count):
    P = many_cells(name)
    modes = leading_modes(Chain.from_scipy(P), count)
    values = in_order(np.linalg.eigvals(P))[: modes.value.size]
    np.testing.assert_allclose(modes.value, values, atol=1e-7)
    np.testing.assert_allclose(modes.left @ modes.right.T, np.eye(values.size), atol=1e-7)


@pytest.mark.parametrize("found", [1, 3, 4])
def test_vectors_that_arnoldi_does_not_return_are_searched_again(found, monkeypatch):
    """ARPACK may return fewer vectors than it was asked for; here it always does at first."""
    eigs, calls = scipy.sparse.linalg.eigs, []

    def fewer(operator, wanted, **options):
        values, vectors = eigs(operator, wanted, **options)
        calls.append(wanted)
        kept = found if len(calls) == 1 else None
        return values[:kept], vectors[:, :kept]

    monkeypatch.setattr(scipy.sparse.linalg, "eigs", fewer)
    P = many_cells("split")
    modes = leading_modes(Chain.from_scipy(P), 5)
    values = in_order(np.linalg.eigvals(P))[: modes.value.size]
    assert calls[0] == 5
    np.testing.assert_allclose(modes.value, values, atol=1e-7)


def test_a_matrix_with_fewer_eigenvectors_has_no_more_modes():
    """The values of this chain are 1 and, twice, 0 with only one vector."""
    P = np.array([[1.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    with pytest.raises(RuntimeError, match="residual"):
        leading_modes(chain_of(P), 3)
    modes = jax.jit(lambda P: leading_modes(chain_of(P), 3, throw=False))(P)
    assert not modes.certificate.converged
    assert modes.value.shape == (3,)
    np.testing.assert_allclose(modes.value[0], 1, atol=1e-12)
