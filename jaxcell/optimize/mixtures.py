import dataclasses
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..base.certificate import Certificate
from ..base.precision import require_x64
from .checked import finite


# Tolerance relative to the largest squared distance of a column from the target.
_TOLERANCE = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class Mixture:
    """The mixture of the columns of a matrix that is nearest to a target."""

    weights: Float[Array, "columns"]
    "The weight of each column; they are not negative and sum to 1."
    value: Float[Array, "rows"]
    "The mixture, `A weights`."
    distance: float
    "The Euclidean distance of the mixture from the target."
    certificate: Certificate


def mixture(A: Any, b: Any, *, throw: bool = True) -> Mixture:
    """Minimise `|A x - b|^2` over the `x >= 0` that sum to 1 (Alam 2018, Eq. 3.8).

    `A x - b` is the point of least norm in the convex hull of the columns of `A - b`. Wolfe's
    active-set method finds this point exactly, in one step per added or dropped column. If columns
    are affinely dependent, several weights give the nearest mixture; any of them may be returned.

    **Arguments:**

    - `A`: float64 array `[rows, columns]`, such as the coverage distributions of policies.
    - `b`: float64 array `[rows]`, the target.
    - `throw`: whether to raise `RuntimeError` if the residual exceeds the tolerance.

    **Returns:** [`Mixture`][]. The residual of its certificate, the duality gap, bounds the excess
    of `|A x - b|^2` over the optimum, relative to the largest squared distance of a column from the
    target.

    **Raises:** `ValueError` for arrays that do not match; `RuntimeError` if the residual exceeds
    the tolerance, or if JAX is set to 32 bits.

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
    # A rotation reduces rows to the number of columns, and preserves all scalar products.
    points: np.ndarray = np.linalg.qr(A - b[:, None], mode="r")  # type: ignore[assignment]
    weights, gap, steps = _nearest_to_origin(points)
    certificate = Certificate(steps, gap, _TOLERANCE)
    certificate.check("mixture", throw)
    value = A @ weights
    distance = float(np.linalg.norm(value - b))
    weights, value = jax.device_put((weights, value))
    return Mixture(weights, value, distance, certificate)


def _checked(name: str, values: Any, dimensions: int) -> Float[np.ndarray, "..."]:
    array = np.asarray(values)
    if array.ndim != dimensions or array.size == 0:
        raise ValueError(f"{name}: expected an array of {dimensions} dimensions, got {array.shape}")
    if array.dtype != np.float64:
        raise ValueError(f"{name}: expected float64, got {array.dtype}")
    return finite(name, array)


def _nearest_to_origin(
    points: Float[np.ndarray, "coordinates columns"],
) -> tuple[Float[np.ndarray, "columns"], float, int]:
    """Compute the weights of the point nearest to the origin in the convex hull of the columns.

    **Returns:** the weights, the relative duality gap, and the number of active sets.
    """
    squares = np.einsum("ij,ij->j", points, points)
    scale = max(float(squares.max()), np.finfo(float).tiny)
    weights = np.zeros(points.shape[1])
    weights[np.argmin(squares)] = 1.0
    steps = 0
    while True:
        steps += 1
        nearest = points @ weights
        along = nearest @ points
        best = int(np.argmin(along))
        gap = max(0.0, 2 * float(weights @ along - along[best]) / scale)
        if gap <= _TOLERANCE / 10 or weights[best] > 0:
            break
        trial = _minimise_on(points, weights, np.append(np.flatnonzero(weights), best))
        # Every active set leads nearer to the origin than the sets before, so none occurs twice;
        # if it does not lead nearer, rounding prevents further progress.
        if np.linalg.norm(points @ trial) >= np.linalg.norm(nearest):
            break
        weights = trial
    return weights, gap, steps


def _minimise_on(
    points: Float[np.ndarray, "coordinates columns"],
    weights: Float[np.ndarray, "columns"],
    active: Int[np.ndarray, "active"],
) -> Float[np.ndarray, "columns"]:
    """Move to the nearest point of the affine hull of the active columns.

    If that point is outside the convex hull of these columns, drop the column whose weight first
    becomes 0 and continue with the other columns.
    """
    here = weights[active]
    while True:
        # Affine combinations are the last column plus multiples of differences from this column.
        last = points[:, active[-1]]
        differences = points[:, active[:-1]] - last[:, None]
        others = np.linalg.lstsq(differences, -last, rcond=None)[0]
        aim = np.append(others, 1 - others.sum())
        if (aim > 0).all():
            moved = np.zeros_like(weights)
            moved[active] = aim
            return moved
        shares = np.full(aim.size, np.inf)
        outside = aim <= 0
        shares[outside] = here[outside] / np.maximum(here - aim, np.finfo(float).tiny)[outside]
        share = shares.min()
        kept = shares > share
        here = (here + share * (aim - here))[kept]
        active = active[kept]
