import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, strategies as st
from random_chains import matrices

from jaxcell.mapping.generalized import Chain


@given(matrices())
def test_chain_of_matrix_has_that_matrix(matrix):
    chain = Chain.from_scipy(matrix)
    back = chain.to_scipy()
    np.testing.assert_array_equal(back.toarray(), matrix)
    assert (back.data > 0).all()
    assert chain.cells == len(matrix)
    # Unused slots stay on the cell at probability 0.
    image, unused = np.asarray(chain.image), np.asarray(chain.probability) == 0
    assert len(image) == max(1, (matrix > 0).sum(axis=1).max())
    np.testing.assert_array_equal(image[unused], np.nonzero(unused)[1])


@given(matrices(), st.randoms(use_true_random=False))
def test_push_and_pull_are_products(matrix, random):
    chain = Chain.from_scipy(matrix)
    v = np.array([random.random() for _ in matrix])
    np.testing.assert_allclose(chain.push(jax.device_put(v)), v @ matrix, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(chain.pull(jax.device_put(v)), matrix @ v, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(chain.leaving, 1 - matrix.sum(axis=1), atol=1e-12)
    later = np.linalg.matrix_power(matrix, 3)
    np.testing.assert_allclose(chain.push(v, 3), v @ later, rtol=1e-13, atol=1e-15)
    assert chain.push(v, 0).tolist() == v.tolist()


def test_leaving_separates_leaks_from_rounding():
    tenth = np.full(10, 0.1)
    matrix = np.zeros((10, 10))
    matrix[0] = tenth
    matrix[1, :9] = tenth[:9]
    matrix[2, 0] = 1 - 1e-9
    matrix[3:, 0] = 1
    leaving = np.asarray(Chain.from_scipy(matrix).leaving)
    np.testing.assert_allclose(leaving, [0, 0.1, 1e-9] + [0] * 7, rtol=1e-6)
    assert leaving[0] == 0.0


def test_chain_does_not_share_memory_with_its_arguments():
    # JAX would share memory at some addresses only.
    for cells in range(1000, 1020):
        image = np.tile(np.arange(cells, dtype=np.int32), (1, 1))
        probability = np.ones((1, cells))
        chain = Chain(image, probability)
        image[:], probability[:] = 0, 0.5
        assert np.asarray(chain.image)[0, -1] == cells - 1
        assert np.asarray(chain.probability)[0, -1] == 1


def test_several_slots_of_a_cell_may_share_an_image():
    chain = Chain(np.array([[1, 0], [1, 1]]), np.array([[0.25, 0.5], [0.75, 0.5]]))
    assert chain.to_scipy().toarray().tolist() == [[0, 1], [0.5, 0.5]]


def test_zeros_kept_in_a_sparse_matrix_are_no_edges():
    matrix = scipy.sparse.csr_array(([1.0, 0.0, 1.0], ([0, 0, 1], [0, 1, 1])), shape=(2, 2))
    assert Chain.from_scipy(matrix).image.shape == (1, 2)
    assert matrix.nnz == 3, "the argument is left as it was"


def test_chain_works_under_jit_and_vmap():
    chain = Chain.from_scipy(np.array([[0.5, 0.5, 0], [0, 0, 1], [0.2, 0.3, 0.4]]))
    ps = jnp.eye(3)

    @jax.jit
    def two_steps(chain, p):
        chain = Chain(chain.image, chain.probability)
        return chain.push(chain.push(p))

    matrix = chain.to_scipy().toarray()
    moved = jax.vmap(two_steps, in_axes=(None, 0))(chain, ps)
    np.testing.assert_allclose(moved, matrix @ matrix, rtol=1e-14)
    scaled = jax.tree.map(lambda x: x, chain)
    assert isinstance(scaled, Chain)
    # Two chains of one shape, as one batch.
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), chain)
    pulled = jax.vmap(lambda c: c.pull(jnp.ones(3)))(batch)
    np.testing.assert_allclose(pulled, [matrix.sum(axis=1)] * 2, rtol=1e-14)


def test_gradient_of_a_step():
    chain = Chain.from_scipy(np.array([[0.5, 0.5], [0.1, 0.9]]))
    reward = jnp.array([1.0, 3.0])
    gradient = jax.grad(lambda p: chain.push(p) @ reward)(jnp.array([0.3, 0.7]))
    np.testing.assert_allclose(gradient, chain.pull(reward), rtol=1e-14)


@pytest.mark.parametrize(
    ("image", "probability", "message"),
    [
        ([[0, 1]], [[0.5, -0.25]], r"probability\[0, 1\] is -0.25"),
        ([[0, 1]], [[0.5, np.nan]], r"probability\[0, 1\] is nan"),
        ([[0, 1]], [[np.inf, 0.5]], "cell 0 sum to .*inf"),
        ([[0, 1], [1, 0]], [[0.5, 0.75], [0.5, 0.75]], "cell 1 sum to .*1.5"),
        ([[0, 2]], [[1.0, 1.0]], r"image\[0, 1\]: cell 2 does not exist; cells are 0 to 1"),
        ([[0, -1]], [[1.0, 1.0]], r"image\[0, 1\]: cell -1 does not exist"),
        ([[0, 1]], [[1.0, 1.0, 1.0]], r"got \[1, 2\] and \[1, 3\]"),
        ([0, 1], [1.0, 1.0], "branches, cells"),
        (np.zeros((0, 2), int), np.zeros((0, 2)), "branches, cells"),
        ([[0.0, 1.0]], [[1.0, 1.0]], "image: expected whole numbers of cells, got float64"),
        ([[0, 1]], np.ones((1, 2), np.float16), "probability: expected float64, got float16"),
    ],
)
def test_bad_arrays_are_refused(image, probability, message):
    with pytest.raises(ValueError, match=message):
        Chain(np.array(image), np.array(probability))


def test_matrix_that_is_not_square_is_refused():
    with pytest.raises(ValueError, match=r"as many rows as columns, got \(2, 3\)"):
        Chain.from_scipy(np.ones((2, 3)) / 3)


@pytest.mark.parametrize("array", [np.float32, jnp.float32])
def test_rows_of_32_bits_are_divided_by_their_sum(array):
    rows = np.array([[0.1, 0.2, 0.7], [0.3, 0.3, 0.4], [0.6, 0.2, 0.2]])
    given = array(rows)
    for chain in (Chain.from_scipy(given), Chain(np.tile(np.arange(3)[:, None], 3), given.T)):
        np.testing.assert_allclose(chain.to_scipy().toarray(), rows, rtol=1e-7)
        np.testing.assert_allclose(chain.probability.sum(axis=0), 1, rtol=0, atol=1e-15)
    switch = Chain.from_scipy(np.array([[0, 1], [1, 0]], bool))
    assert switch.image.tolist() == [[1, 0]]
    assert Chain.from_scipy(array([[0.9]])).leaving.item() == pytest.approx(0.1, abs=1e-7)
    with pytest.raises(ValueError, match=r"cell 0 sum to .*; expected at most 1"):
        Chain.from_scipy(array([[0.50001, 0.5], [0.5, 0.5]]))


def test_a_small_leak_of_64_bits_stays():
    leak = 1e-8
    assert Chain.from_scipy(np.array([[1 - leak]])).leaving.item() == pytest.approx(leak)


def test_matrix_is_made_once_and_read_only():
    chain = Chain(np.array([[1, 0]]), np.array([[0.5, 1.0]]))
    matrix = chain.to_scipy()
    assert chain.to_scipy() is matrix
    with pytest.raises(ValueError, match="read-only"):
        matrix.data[0] = 1.0


def test_rows_rounded_to_five_digits_are_mentioned():
    thirds = np.full((3, 3), 0.33333)
    with pytest.warns(UserWarning, match=r"3 of 3 cells .* cell 0 to 0.99999\), as rounded"):
        Chain.from_scipy(thirds)
    with pytest.warns(UserWarning, match="divide the numbers of each cell by their sum"):
        Chain.from_scipy(np.array([[0.5, 0.5, 0], [0.333, 0.333, 0.333], [0, 0, 1]]))
    over = np.array([[0.66667, 0.33334], [0.5, 0.5]])
    with pytest.raises(ValueError, match="expected at most 1; if they are rounded, divide"):
        Chain.from_scipy(over)
    Chain.from_scipy(over / over.sum(axis=1, keepdims=True))


@pytest.mark.parametrize(
    "row",
    [
        # A rest that is larger than rounding, or numbers that have all their digits.
        [0.3, 0.3, 0.3],
        [0.5, 0.4995, 0.0],
        [1 / 3, 1 / 3, 1 / 3 - 1e-5],
        [1 - 1e-9, 0.0, 0.0],
    ],
)
def test_probabilities_of_leaving_are_not_taken_for_rounding(row):
    assert Chain.from_scipy(np.array([row, [0.0, 1.0, 0.0], [0.0, 0.0, 0.7]])).can_leave[2]


def test_memory_of_a_hub_is_foretold(monkeypatch):
    monkeypatch.setattr("jaxcell.base.memory.free", lambda: 10**9)
    cells = 15_000
    others = np.arange(1, cells)
    rows = np.concatenate([np.zeros(cells - 1, int), others])
    columns = np.concatenate([others, np.zeros(cells - 1, int)])
    share = np.repeat([1 / (cells - 1), 1.0], cells - 1)
    star = scipy.sparse.csr_array((share, (rows, columns)), shape=(cells, cells))
    with pytest.raises(MemoryError, match=r"the 14999 images of cell 0 .* 5\.\d GB .* mean is 2"):
        Chain.from_scipy(star)
