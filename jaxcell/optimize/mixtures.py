import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Float

from ..base.certificate import Certificate, Real
from ..base.divided import put_on_device
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import traced
from ..mapping.traced import implicit, like, on_host
from .validation import finite


# Tolerance relative to the largest squared distance of a column from the target.
_TOLERANCE = 1e-12


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Mixture(Pictured):
    """The mixture of the columns of a matrix that is nearest to a target."""

    weights: Float[Array, "columns"]
    "The weight of each column. Weights are not negative and sum to 1."
    value: Float[Array, "rows"]
    "The mixture, `A weights`."
    distance: Real
    "The Euclidean distance of the mixture from the target."
    certificate: Certificate


def mixture(A: Any, b: Any, *, throw: bool = True) -> Mixture:
    """Minimise `|A x - b|^2` over the `x >= 0` that sum to 1 (Alam 2018, Eq. 3.8).

    At the optimum, `A x - b` has the least norm in the convex hull of the columns of `A - b`. An
    active-set method finds it up to rounding. If columns are affinely dependent, several weights
    give the nearest mixture; any of them may be returned.

    **Arguments:**

    - `A`: float64 array `[rows, columns]`, such as the coverage distributions of policies.
    - `b`: float64 array `[rows]`, the target.
    - `throw`: whether to raise `RuntimeError` if the residual exceeds the tolerance.

    `A` and `b` may be traced by `jit`, `vmap` and `grad`. Derivatives are those for the columns
    that have a weight, which must be affinely independent.

    **Returns:** [`Mixture`][]. The residual of its certificate, the duality gap, bounds the excess
    of `|A x - b|^2` over the optimum, relative to the largest squared distance of a column from the
    target. Its number of iterations is the number of columns with a positive weight.

    The point between two columns that is nearest to (1, 0.5):

        >>> import numpy as np
        >>> from jaxcell import optimize
        >>> A = np.array([[1.0, 0.0], [0.0, 1.0]])
        >>> nearest = optimize.mixture(A, np.array([1.0, 0.5]))
        >>> nearest.weights.round(6).tolist(), round(nearest.distance, 6)
        ([0.75, 0.25], 0.353553)
    """
    require_x64("mixture")
    A, b = _checked("A", A, 2), _checked("b", b, 1)
    if A.shape[0] != b.size:
        raise ValueError(f"b: expected {A.shape[0]} numbers, one per row of A, got {b.size}")
    form = like(float, A.shape[1]), like(int), like(float)
    weights, iterations, gap = on_host(_nearest, form, (), A, b)
    certificate = Certificate(iterations, gap, _TOLERANCE)
    certificate.check("mixture", throw)
    if traced(A, b):
        weights = implicit(_change, weights, (A, b))
    weights, A = put_on_device((weights, A))
    value = A @ weights
    distance = jnp.linalg.norm(value - b)
    return Mixture(weights, value, distance if traced(A, b) else float(distance), certificate)


def _nearest(
    _: Any, A: Float[np.ndarray, "rows columns"], b: Float[np.ndarray, "rows"]
) -> tuple[Float[np.ndarray, "columns"], int, float]:
    """Return the weights, the number of those that are positive, and the duality gap."""
    # A rotation reduces rows to the number of columns, and preserves all scalar products.
    points: np.ndarray = np.linalg.qr(A - b[:, None], mode="r")  # type: ignore[assignment]
    # With one more row of ones and the target (0, ..., 0, 1), the best nonnegative numbers are a
    # multiple of the best weights: both meet the same conditions of Karush, Kuhn and Tucker.
    scale = max(float(np.linalg.norm(points, axis=0).max()), np.finfo(float).tiny)
    rows = np.vstack([points / scale, np.ones(A.shape[1])])
    numbers, _ = scipy.optimize.nnls(rows, np.append(np.zeros(len(points)), 1.0))
    weights = numbers / numbers.sum()
    nearest = rows[:-1] @ weights
    along = nearest @ rows[:-1]
    gap = max(0.0, 2 * float(weights @ along - along.min()))
    return weights, int(np.count_nonzero(weights)), gap


def _change(weights: Any, inputs: Any) -> Float[Array, "columns"]:
    """Solve the conditions of the optimum on the columns with a weight, for its derivatives."""
    A, b = inputs
    used = (weights > 0).astype(A.dtype)
    system = jnp.diag(1 - used) + used[:, None] * (A.T @ A) * used[None]
    bordered = jnp.block([[system, used[:, None]], [used[None], jnp.zeros((1, 1))]])
    slope = jnp.pad(used * (A.T @ (b - A @ weights)), (0, 1))
    change = jnp.linalg.solve(bordered, slope - jax.lax.stop_gradient(slope))
    return weights + change[:-1]


def _checked(name: str, values: Any, dimensions: int) -> Any:
    array = values if traced(values) else np.asarray(values)
    if array.ndim != dimensions or array.size == 0:
        raise ValueError(f"{name}: expected an array of {dimensions} dimensions, got {array.shape}")
    if array.dtype != np.float64:
        raise ValueError(f"{name}: expected float64, got {array.dtype}")
    return array if traced(array) else finite(name, array)
