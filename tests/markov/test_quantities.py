import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special
from graphs import SMALL
from hypothesis import assume, given, strategies as st
from random_chains import complete
from walks import times_by_solves

from jaxcell.mapping.generalized import Chain
from jaxcell.markov import dense
from jaxcell.markov.quantities import (
    commute_times,
    entropy_rate,
    hitting_matrix,
    kemeny_constant,
    mixing_time,
    slem,
)


METROPOLIS = 1 / np.bincount(SMALL.edges.ravel())[SMALL.edges].max(axis=1)


def walk(weights):
    matrix = SMALL.matrix(weights).toarray()
    return matrix / matrix.sum(axis=1, keepdims=True)


@st.composite
def irreducible(draw):
    """Draw a matrix with few edges, among them those of a circle through all cells."""
    # There are few sizes, because JAX compiles once per size.
    n = draw(st.sampled_from([6, 6, 1]))
    matrix = np.roll(np.eye(n), 1, axis=1)
    edges = draw(st.lists(st.tuples(*[st.integers(0, n - 1)] * 2, st.integers(1, 5)), max_size=12))
    for i, j, weight in edges:
        matrix[i, j] += weight
    return matrix / matrix.sum(axis=1, keepdims=True)


@given(irreducible())
def test_quantities_equal_their_definitions(matrix):
    chain, expected = Chain.from_scipy(matrix), times_by_solves(matrix)
    result = hitting_matrix(chain)
    np.testing.assert_allclose(result.value, expected, rtol=1e-9)
    assert result.certificate.residual < 1e-11
    np.testing.assert_allclose(commute_times(chain).value, expected + expected.T, rtol=1e-9)
    values, vectors = np.linalg.eig(matrix.T)
    order = np.argsort(-values.real)
    share = vectors[:, order[0]].real / vectors[:, order[0]].real.sum()
    np.testing.assert_allclose(dense.stationary(matrix), share, atol=1e-12)
    others = values[order[1:]]
    kemeny = np.sum(1 / (1 - others)).real
    # Kemeny's constant is the same for each start, and equals two formulas.
    np.testing.assert_allclose(np.asarray(result.value) @ share, kemeny, rtol=1e-9, atol=1e-12)
    assert kemeny_constant(chain) == pytest.approx(kemeny, rel=1e-9, abs=1e-12)
    assert dense.kemeny(matrix) == pytest.approx(kemeny, rel=1e-9, abs=1e-12)
    # The error of a defective eigenvalue is a root of the rounding.
    assert slem(chain) == pytest.approx(np.abs(others).max(initial=0), abs=1e-7)
    entropy = share @ scipy.special.entr(matrix).sum(axis=1)
    assert entropy_rate(chain) == pytest.approx(entropy, abs=1e-12)
    assert dense.entropy_rate(matrix) == pytest.approx(entropy, abs=1e-12)


@given(irreducible(), st.floats(0.02, 0.45))
def test_mixing_time_equals_a_search_step_by_step(matrix, distance):
    result = mixing_time(Chain.from_scipy(matrix), distance)
    share = np.asarray(dense.stationary(matrix))
    power, time = np.eye(len(matrix)), 0
    while (apart := np.abs(power - share).sum(axis=1).max() / 2) > distance and time < 2000:
        # Rounding decides if the distance nearly equals the limit.
        assume(apart > distance + 1e-10)
        power, time = power @ matrix, time + 1
    if time == 2000:
        assert result == math.inf
        assert apart >= 0.5 - 1e-9
    else:
        assert result == time


def test_distance_that_is_met_exactly_counts_as_mixed():
    # After t steps, the distance of a lazy walk between two cells is 1/2 * 0.8^t.
    chain = Chain.from_scipy(np.array([[0.9, 0.1], [0.1, 0.9]]))
    for t in range(1, 12):
        assert mixing_time(chain, 0.5 * 0.8**t) == t


def test_slow_chain_has_known_mixing_time():
    # The distance after t steps is |1 - 2 e|^t / 2.
    e = 2.0**-30
    chain = Chain.from_scipy(np.array([[1 - e, e], [e, 1 - e]]))
    expected = math.ceil(math.log(0.5) / math.log1p(-2 * e))
    assert mixing_time(chain) == pytest.approx(expected, rel=1e-7)


def test_branches_with_one_image_are_one_step():
    chain = Chain(np.array([[1, 0], [1, 0]]), np.full((2, 2), 0.5))
    assert entropy_rate(chain) == 0


FUNCTIONS = {
    "stationary": lambda P: dense.stationary(P)[3],
    "hitting": lambda P: dense.hitting(P)[1, 5] + dense.hitting(P)[6, 2],
    "kemeny": dense.kemeny,
    "entropy_rate": dense.entropy_rate,
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_where_many_entries_are_zero(name):
    draw = np.random.default_rng(1)
    start = draw.normal(size=(8, 8))
    graph = walk(np.ones(13))

    @jax.jit
    @jax.value_and_grad
    def value(x):
        weights = graph * jnp.exp(x)
        return FUNCTIONS[name](weights / weights.sum(axis=1, keepdims=True))

    gradient = np.asarray(value(start)[1])
    assert np.isfinite(gradient).all()
    along = draw.normal(size=(8, 8))
    change = float(value(start + 1e-5 * along)[0] - value(start - 1e-5 * along)[0])
    assert np.sum(gradient * along) == pytest.approx(change / 2e-5, rel=1e-6)


def test_dense_functions_take_batches():
    batch = np.stack([walk(np.ones(13)), walk(METROPOLIS)])
    for function in (dense.stationary, dense.hitting, dense.kemeny, dense.entropy_rate):
        result = np.asarray(jax.vmap(function)(batch))
        for k in range(2):
            np.testing.assert_allclose(result[k], function(batch[k]), rtol=1e-12)


ALL = [hitting_matrix, commute_times, kemeny_constant, slem, mixing_time]


@pytest.mark.parametrize("function", ALL)
@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ([[1, 0], [0, 1]], "cell 1 is in another persistent group than cell 0"),
        ([[1, 0], [0.5, 0.5]], "cell 1 is transient"),
        ([[0, 1], [0.5, 0]], "cell 0 is transient"),
    ],
)
def test_reducible_chains_are_refused(function, matrix, message):
    with pytest.raises(ValueError, match=f"{function.__name__}: .* irreducible chain, .*{message}"):
        function(Chain.from_scipy(np.array(matrix, float)))


def test_entropy_rate_is_that_of_the_only_group():
    # From cell 0 the chain comes to cells 1 and 2, where a step is a toss of a coin of 1 to 3.
    matrix = np.array([[0.5, 0.25, 0.25], [0.0, 0.25, 0.75], [0.0, 0.75, 0.25]])
    expected = -0.25 * math.log(0.25) - 0.75 * math.log(0.75)
    assert entropy_rate(Chain.from_scipy(matrix)) == pytest.approx(expected, rel=1e-14)
    for chain, message in ((np.eye(2), "group, got 2"), (0.5 * np.eye(2), "leave the space")):
        with pytest.raises(ValueError, match=f"entropy_rate: expected a chain that .*{message}"):
            entropy_rate(Chain.from_scipy(chain))


@pytest.mark.parametrize("function", ALL)
def test_chain_too_large_for_its_matrix_is_refused(function):
    cells = 2001 if function is mixing_time else 10001
    cell = np.arange(cells)
    ring = Chain(np.stack([cell, np.roll(cell, -1)]), np.full((2, cells), 0.5))
    match = rf"has {cells} cells, .* more than {cells - 1} take gigabytes"
    with pytest.raises(ValueError, match=match):
        function(ring)


@pytest.mark.parametrize("distance", [0.0, 0.5, -1.0, math.nan])
def test_distances_out_of_range_are_refused(distance):
    with pytest.raises(ValueError, match="distance: expected more than 0 and less than 1/2"):
        mixing_time(Chain.from_scipy(complete(3)), distance)


def test_times_beyond_floats_are_refused():
    e = 1e-200
    chain = Chain.from_scipy(np.array([[1, e, 0], [1, 0, e], [0, 1, 0]]))
    assert hitting_matrix(chain, throw=False).certificate.residual == math.inf
    for function in (hitting_matrix, commute_times):
        with pytest.raises(RuntimeError, match=f"{function.__name__}: the residual stayed"):
            function(chain)


def test_kemeny_constant_beyond_floats_is_refused():
    # From either end to the other, two rare steps must follow each other.
    e = 1e-200
    matrix = np.array([[1, e, 0, 0], [1, 0, e, 0], [0, e, 0, 1], [0, 0, e, 1]])
    with pytest.raises(RuntimeError, match="kemeny_constant: the chain takes more than 1e308"):
        kemeny_constant(Chain.from_scipy(matrix))


def test_mixing_that_rounding_hides_is_reported():
    e = 2.0**-53
    with pytest.raises(RuntimeError, match=r"not mixed after 2\*\*50 steps"):
        mixing_time(Chain.from_scipy(np.array([[1 - e, e], [e, 1 - e]])))
