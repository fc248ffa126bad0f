import dataclasses
import functools
from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Complex
from scipy.sparse import linalg

from ...base.certificate import Certificate
from ...base.shown import Pictured
from ...base.wide import traced
from ...mapping import Chain, ChainLike, ChainSequence
from ...mapping.traced import first_derivative_only, implicit, like, on_host
from ..traced import CERTIFIED
from .window import Window, leading_order, leading_subspace, steps_of


_Modes: TypeAlias = tuple[Any, Any, Any]
_Matrices: TypeAlias = tuple[scipy.sparse.csr_array, ...]


# Tolerance of the residual of eigenvectors of length 1.
TOLERANCE = 1e-6
# A solution that is larger than the right side by this factor has lost its digits.
_SINGULAR = 1e10
# Share of the largest number of a function above which rounding errors may decide which is larger.
_LARGEST = 1 - 1e-9


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Modes(Pictured):
    """Leading eigenvalues of the matrix of one or several steps of a chain, with eigenvectors.

    Under `grad` and `jvp` all three arrays have derivatives where the eigenvalue is simple.
    """

    value: Complex[Array | np.ndarray, "modes"]
    "The eigenvalues with the largest real parts, in the order of [`leading_modes`][]."
    right: Complex[Array | np.ndarray, "modes cells"]
    """Right eigenvectors: functions with `P f = value f`. If the value is near 1, they are almost
    constant on each basin of attraction. The largest number of each is 1."""
    left: Complex[Array | np.ndarray, "modes cells"]
    """Left eigenvectors: measures with `m P = value m`, which are large where mass gathers. The
    product of a measure and a function is 1 if both belong to the same mode, and 0 otherwise."""
    certificate: Certificate


def leading_modes(
    chain: ChainLike | ChainSequence,
    count: int,
    *,
    steps: int | None = None,
    start: int = 0,
    throw: bool = True,
) -> Modes:
    """Compute the leading eigenvalues of a chain, with right and left eigenvectors.

    Leading eigenvalues are those with the largest real parts; of equal real parts, up to 1e-7, the
    one with the larger modulus leads, and of conjugates the one with the positive imaginary part.

    A mode with eigenvalue `x` decays by a factor e in `-steps / log |x|` steps. Mass that leaves
    the space is lost: if the space has an open edge, even the first eigenvalue is less than 1.

    **Arguments:**

    - `count`: the number of eigenvalues. If this splits a conjugate pair, one more is returned,
        except where JAX traces the chain.
    - `steps`: the number of steps whose product is `P`, by default one per phase of a sequence.
    - `start`: the phase of the first step of a sequence of chains.

    **Returns:** the modes. The residual of the certificate is the largest 2-norm of
    `P f - value f`, or of `m P - value m`, over eigenvectors of length 1. If the matrix has fewer
    eigenvectors, the rest are NaN, and the residual is `inf`.

    Two pairs of cells; in each step the chain moves to the other pair with probability 1/10:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> stay, go = np.full((2, 2), 0.45), np.full((2, 2), 0.05)
        >>> chain = mapping.Chain.from_scipy(np.block([[stay, go], [go, stay]]))
        >>> modes = markov.leading_modes(chain, 2)
        >>> modes.value.real.round(6).tolist()
        [1.0, 0.8]
        >>> np.sign(modes.right[1].real / modes.right[1, 0].real).tolist()
        [1.0, 1.0, -1.0, -1.0]
    """
    each = steps_of(chain, steps, start)
    cells = each[0].cells
    check_count(count, cells)
    compute = functools.partial(_modes, count=count, exactly=traced(each))
    if traced(each):
        vectors = like(complex, count, cells)
        form = (like(complex, count), vectors, vectors), CERTIFIED
        modes, about = on_host(compute, form, each)
        modes = implicit(change_of_modes, modes, each)
    else:
        modes, about = compute(tuple(one.to_scipy() for one in each))
    products, residual = about
    certificate = Certificate(products, residual, TOLERANCE)
    certificate.check("leading_modes", throw)
    value, right, left = modes
    return Modes(value, right, left, certificate)


def _modes(matrices: _Matrices, count: int, exactly: bool) -> tuple[_Modes, tuple[int, float]]:
    window = Window(matrices)
    matrix, options = window.matrix, {"symmetric": False, "copies": True}
    functions = leading_subspace(window.pull, window.cells, count, matrix=matrix, **options)
    vectors, back = functions.basis.shape[1], None if matrix is None else matrix.T
    measures = leading_subspace(window.push, window.cells, vectors, matrix=back, **options)
    values, inner = np.linalg.eig(functions.block)
    order = leading_order(values)
    values, right = values[order], functions.basis @ inner[:, order]
    right = right / right[_largest(right.T), np.arange(vectors)]
    left = measures.basis @ np.linalg.pinv(right.T @ measures.basis)
    splits = np.any(values[count - 1 : count].imag > 0)
    kept = count + 1 if splits and not exactly else count
    values, right, left = values[:kept], right[:, :kept], left[:, :kept]
    residual = max(_residual(window.pull, right, values), _residual(window.push, left, values))
    value, right, left = (np.asarray(v, complex) for v in (values, right.T, left.T))
    if value.size < kept:
        # A matrix with Jordan blocks has fewer eigenvectors than eigenvalues.
        absent, residual = [(0, kept - value.size)], np.inf
        value = np.pad(value, absent, constant_values=np.nan)
        right, left = (np.pad(v, [*absent, (0, 0)], constant_values=np.nan) for v in (right, left))
    return (value, right, left), (functions.products + measures.products, residual)


@first_derivative_only("leading_modes")
def change_of_modes(modes: _Modes, steps: tuple[Chain, ...]) -> _Modes:
    """Compute the modes from their values, for their derivatives.

    With `M` the product of the steps, `M' f + M f' = value' f + value f'`, and `m f = 1`, so
    `value' = m M' f`. Both vectors follow from one bordered matrix, which is singular where the
    eigenvalue is not simple.
    """
    value, right, left = modes
    moved, pushed = _pull(steps, right), _push(steps, left)
    moved, pushed = (x - jax.lax.stop_gradient(x) for x in (moved, pushed))
    change = jnp.sum(left * moved, axis=1)
    fixed = jax.lax.stop_gradient(steps)

    def solve(residual: Any, adjoint: bool) -> Any:
        def apply(x: Any) -> Any:
            vectors, share = x[:, :-1], x[:, -1:]
            step, border, sums = (_push, left, right) if adjoint else (_pull, right, left)
            image = step(fixed, vectors) - value[:, None] * vectors + share * border
            return jnp.hstack([image, jnp.sum(sums * vectors, axis=1, keepdims=True)])

        def on(transposed: bool) -> Callable[..., Any]:
            compute = functools.partial(_bordered, transposed=transposed)
            return lambda _, sides: on_host(
                compute, like(complex, *sides.shape), fixed, *modes, sides
            )

        sides = jnp.pad(-residual, [(0, 0), (0, 1)])
        return jax.lax.custom_linear_solve(apply, sides, on(adjoint), on(not adjoint))[:, :-1]

    function = solve(moved - change[:, None] * right, False)
    measure = solve(pushed - change[:, None] * left, True)
    most = _largest(right)[:, None]
    grown = jnp.take_along_axis(function, most, axis=1)
    return value + change, right + function - grown * right, left + measure + grown * left


def _largest(functions: Any) -> Any:
    """Return the cell where each function is 1: the first of those where it is largest."""
    size = abs(functions)
    return (size >= _LARGEST * size.max(axis=1, keepdims=True)).argmax(axis=1)


def _pull(steps: tuple[Chain, ...], vectors: Any) -> Any:
    for one in reversed(steps):
        vectors = _of_parts(one.pull, vectors)
    return vectors


def _push(steps: tuple[Chain, ...], vectors: Any) -> Any:
    for one in steps:
        vectors = _of_parts(one.push, vectors)
    return vectors


def _of_parts(step: Callable[[Any], Any], vectors: Any) -> Any:
    return jax.lax.complex(*(jax.vmap(step)(part) for part in (vectors.real, vectors.imag)))


def _bordered(
    matrices: _Matrices, value: Any, right: Any, left: Any, sides: Any, transposed: bool
) -> Complex[np.ndarray, "modes bordered"]:
    """Solve `(M - value) x + s right = side` with `left x` given for each mode, or the transpose.

    The values after each of the steps are unknowns, too, so that the system is sparse. A solution
    is NaN if rounding errors have most digits, because the eigenvalue is hardly simple.
    """
    cells, steps = matrices[0].shape[0], len(matrices)
    unit = scipy.sparse.eye_array(cells, format="csr")
    ends = np.append(np.arange(cells), -1)
    found = np.empty(sides.shape, complex)
    for mode, each in enumerate(value):
        if np.isnan(each):
            found[mode] = np.nan
            continue
        blocks: list[list[Any]] = [[None] * (steps + 2) for _ in range(steps + 2)]
        blocks[0][0], blocks[0][1] = -each * unit, unit
        blocks[0][-1], blocks[-1][0] = right[mode][:, None], left[mode][None]
        for n, matrix in enumerate(matrices, start=1):
            blocks[n][n], blocks[n][n + 1 if n < steps else 0] = unit, -matrix
        side = np.zeros((steps + 1) * cells + 1, complex)
        side[ends] = sides[mode]
        whole = scipy.sparse.block_array(blocks, format="csc")
        found[mode] = linalg.splu(whole).solve(side, "T" if transposed else "N")[ends]
        if np.linalg.norm(found[mode]) > _SINGULAR * np.linalg.norm(side):
            found[mode] = np.nan
    return found


def _residual(
    product: Callable[[np.ndarray], np.ndarray], vectors: np.ndarray, values: np.ndarray
) -> float:
    """Return the largest 2-norm of `product(v) - value v` over eigenvectors of length 1."""
    left = product(vectors) - values * vectors
    return float((np.linalg.norm(left, axis=0) / np.linalg.norm(vectors, axis=0)).max())


def check_count(count: int, cells: int) -> None:
    """Raise `ValueError` unless a chain of `cells` cells has at least `count` eigenvalues."""
    if not 1 <= count <= cells:
        raise ValueError(f"count: expected 1 to {cells}, the number of cells, got {count}")
