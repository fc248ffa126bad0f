import cvxpy
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from jaxcell.base.certificate import Outcome
from jaxcell.optimize import mixture


def matrices(rows, columns):
    # Whole numbers make columns that coincide or are dependent, as often as not.
    return hnp.arrays(np.float64, (rows, columns), elements=st.integers(-3, 3).map(float))


@st.composite
def problems(draw):
    rows, columns = draw(st.integers(1, 6)), draw(st.integers(1, 6))
    return draw(matrices(rows, columns)), draw(matrices(rows, 1))[:, 0]


def assert_optimal(A, b, optimum):
    """Checks the conditions of Karush, Kuhn and Tucker: none is better than the columns in use."""
    x = np.asarray(optimum.weights)
    assert (x >= 0).all()
    assert x.sum() == pytest.approx(1, abs=1e-12)
    gradient = A.T @ (A @ x - b)
    scale = max(1.0, np.abs(A).max() ** 2)
    assert gradient[x > 0].max() - gradient.min() <= 1e-8 * scale
    np.testing.assert_allclose(optimum.value, A @ x, rtol=1e-14, atol=1e-14)
    assert optimum.distance == pytest.approx(np.linalg.norm(A @ x - b), abs=1e-12)
    assert optimum.certificate.outcome is Outcome.CONVERGED


@given(problems())
def test_is_optimal_and_equals_cvxpy(problem):
    A, b = problem
    optimum = mixture(A, b)
    assert_optimal(A, b, optimum)
    x = cvxpy.Variable(A.shape[1])
    constraints = [x >= 0, cvxpy.sum(x) == 1]
    least = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(A @ x - b)), constraints)
    least.solve(solver="CLARABEL")
    assert optimum.distance**2 == pytest.approx(least.value, rel=1e-6, abs=1e-6)


def test_distributions_over_many_positions():
    draw = np.random.default_rng(0)
    A = draw.dirichlet(np.full(2000, 0.1), 40).T
    truth = draw.dirichlet(np.full(40, 0.05))
    optimum = mixture(A, A @ truth)
    np.testing.assert_allclose(optimum.weights, truth, atol=1e-9)
    assert optimum.distance < 1e-12
    uniform = np.full(2000, 1 / 2000)
    assert_optimal(A, uniform, mixture(A, uniform))


def test_closed_forms():
    # The foot of the perpendicular from the origin on a segment.
    optimum = mixture(np.array([[1.0, 3.0], [2.0, -2.0]]), np.zeros(2))
    np.testing.assert_allclose(optimum.weights, [0.7, 0.3], rtol=1e-14)
    # Beyond the end of a segment.
    optimum = mixture(np.array([[1.0, 3.0], [2.0, 3.0]]), np.zeros(2))
    assert optimum.weights.tolist() == [1, 0]
    assert optimum.distance == pytest.approx(5**0.5)
    # One column.
    assert mixture(np.array([[4.0]]), np.array([1.0])).weights.tolist() == [1]
    # The target is a column.
    optimum = mixture(np.eye(3), np.array([0.0, 1.0, 0.0]))
    assert optimum.weights.tolist() == [0, 1, 0]
    assert optimum.distance == 0


@pytest.mark.parametrize("scale", [1e-150, 1e-6, 1e6, 1e150])
def test_the_scale_does_not_matter(scale):
    A = np.random.default_rng(1).random((5, 4))
    b = np.full(5, 0.5)
    np.testing.assert_allclose(
        mixture(scale * A, scale * b).weights, mixture(A, b).weights, rtol=1e-9, atol=1e-12
    )


def test_columns_that_nearly_coincide():
    draw = np.random.default_rng(3)
    base = draw.random((30, 1))
    A = base + 1e-9 * draw.random((30, 12))
    optimum = mixture(A, np.full(30, 1 / 30))
    assert optimum.certificate.outcome is Outcome.CONVERGED


@pytest.mark.parametrize(
    ("A", "b", "message"),
    [
        (np.ones((3, 2)), np.ones(2), "b: expected 3 numbers, one per row of A, got 2"),
        (np.ones(3), np.ones(3), "A: expected an array of 2 dimensions"),
        (np.ones((3, 0)), np.ones(3), "A: expected an array of 2 dimensions"),
        (np.ones((1, 2)), np.array([np.nan]), r"b\[0\] is nan"),
        (np.array([[1, np.inf]]), np.ones(1), r"A\[0, 1\] is inf"),
        (np.ones((1, 2), np.float32), np.ones(1), "A: expected float64, got float32"),
    ],
)
def test_bad_arrays_are_refused(A, b, message):
    with pytest.raises(ValueError, match=message):
        mixture(A, b)


@pytest.mark.parametrize("of", ["weights", "distance"])
def test_derivatives_are_those_of_a_projection_on_a_segment(of):
    """The third column is farther, so the nearest point is on the segment between the others."""
    A = jnp.array([[0.0, 2.0, 5.0], [1.0, 2.0, 9.0], [3.0, 1.0, 7.0]])
    b = jnp.array([1.0, 1.0, 1.0])

    def found(A, b):
        best = mixture(A, b)
        return best.weights[1] if of == "weights" else best.distance

    def exact(A, b):
        along, off = A[:, 1] - A[:, 0], b - A[:, 0]
        share = along @ off / (along @ along)
        return share if of == "weights" else jnp.sqrt(jnp.sum((off - share * along) ** 2))

    both = 0, 1
    slopes = jax.jit(jax.grad(found, both))(A, b)
    for part, expected in zip(slopes, jax.grad(exact, both)(A, b), strict=True):
        np.testing.assert_allclose(part, expected, rtol=1e-10, atol=1e-13)
    hessians = jax.jit(jax.hessian(found, both))(A, b)
    for row, wanted in zip(hessians, jax.hessian(exact, both)(A, b), strict=True):
        for part, expected in zip(row, wanted, strict=True):
            np.testing.assert_allclose(part, expected, rtol=1e-10, atol=1e-13)
