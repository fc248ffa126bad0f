import dataclasses
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..base.certificate import Certificate
from ..base.precision import require_x64
from .checked import finite


# Of the largest squared distance of a column from the target.
_TOLERANCE = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class Mixture:
    """The mixture of the columns of a matrix that is nearest to a target."""

    weights: Float[Array, "columns"]
    "The weight of each column; they are not negative and sum to 1."
    value: Float[Array, "rows"]
    "The mixture, `A weights`."
    distance: float
    "Its Euclidean distance from the target."
    certificate: Certificate


def mixture(A: Any, b: Any, *, throw: bool = True) -> Mixture:
    """Minimise `|A x - b|^2` over the `x >= 0` that sum to 1 (Alam 2018, Eq. 3.8).

    That is the point of least norm in the convex hull of the columns of `A - b`, and Wolfe's active
    set finds it exactly, in as many steps as columns come and go. Where columns are affinely
    dependent, several weights give the one nearest mixture, and this is one of them.

    **Arguments:**

    - `A`: float64 array `[rows, columns]`, such as the coverage distributions of some policies.
    - `b`: float64 array `[rows]`, the target.
    - `throw`: whether to raise when the answer is not good enough.

    **Returns:** [`Mixture`][]. The residual of its certificate is the duality gap, relative to the
    largest squared distance of a column from the target: `|A x - b|^2` is at most so much above the
    optimum.

    **Raises:** `ValueError` for arrays whose shapes do not match, that are empty, or that hold
    something other than finite float64 numbers; `RuntimeError` if the gap does not close, or where
    JAX is set to 32 bits.

    The point nearest to (1, 0.5) between two columns:

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
        raise ValueError(f"b: expected {A.shape[0]} numbers, one a row of A, got {b.size}")
    # Rotated into as few coordinates as there are columns, which keeps all products.
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
    """The weights of the point of the convex hull of the columns that is nearest to the origin.

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
        # Every active set is nearer than those before it, so none comes twice; where one is not,
        # rounding allows no better.
        if np.linalg.norm(points @ trial) >= np.linalg.norm(nearest):
            break
        weights = trial
    return weights, gap, steps


def _minimise_on(
    points: Float[np.ndarray, "coordinates columns"],
    weights: Float[np.ndarray, "columns"],
    active: Int[np.ndarray, "active"],
) -> Float[np.ndarray, "columns"]:
    """Go to the nearest point of the affine hull of the active columns.

    Where that point is outside their convex hull, drops the column that is left behind first and
    goes on with the others.
    """
    here = weights[active]
    while True:
        # Affine combinations are the last column and multiples of the differences from it.
        last = points[:, active[-1]]
        differences = points[:, active[:-1]] - last[:, None]
        others = np.linalg.lstsq(differences, -last, rcond=None)[0]
        aim = np.append(others, 1 - others.sum())
        if (aim > 0).all():
            found = np.zeros_like(weights)
            found[active] = aim
            return found
        way = np.full(aim.size, np.inf)
        outside = aim <= 0
        way[outside] = here[outside] / np.maximum(here - aim, np.finfo(float).tiny)[outside]
        share = way.min()
        kept = way > share
        here = (here + share * (aim - here))[kept]
        active = active[kept]
