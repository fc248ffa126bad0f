import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from ...base.wide import traced
from ...space.box import Box
from ..imaging import mapped_points
from ..maps import with_params


# A correlation that is so near 1 is 1, up to rounding.
_ROUNDING = 1e-12


def deviations_of(noise: Any, box: Box) -> Callable[[Any, Any], Any]:
    """Return the function of points `[points, axes]` and parameters that computes deviations.

    `noise` is one number, one per axis, or a function of a point and parameters.
    """
    if callable(noise):
        given = _Deviations(with_params(noise, 2, "noise"), box.dimensions)
        return lambda points, params: mapped_points(given, params, points[:, None])[:, 0]
    each = listed(noise, box.dimensions)
    if any(np.ndim(one) for one in each):
        raise ValueError(
            "noise: a covariance matrix is only for maps with known parameters and without "
            "derivatives; expected standard deviations"
        )
    if len(each) != box.dimensions:
        raise ValueError(
            f"noise: expected one number, or one for each axis of the box, of which there are "
            f"{box.dimensions}; got {len(each)}"
        )
    if not traced(noise) and not all(0 <= float(one) < np.inf for one in each):
        raise ValueError(f"noise: expected numbers from 0, got {noise}")
    numbers = jnp.stack([jnp.asarray(one, float) for one in each])
    return lambda points, params: jnp.broadcast_to(numbers, points.shape)


def is_covariance(noise: Any) -> bool:
    """Check whether noise is an array of two dimensions, a covariance matrix."""
    return not callable(noise) and not traced(noise) and np.ndim(noise) == 2


def with_correlation(noise: Any, box: Box) -> tuple[Any, float]:
    """Return noise without its correlation, and this, which is 0 if it is no covariance matrix."""
    if not is_covariance(noise):
        return noise, 0.0
    if box.dimensions != 2:
        raise ValueError(
            f"noise: a covariance matrix is for a box with two axes, got {box.dimensions}; write "
            "the map along the principal axes of the noise, and give standard deviations"
        )
    matrix = np.asarray(noise, float)
    if matrix.shape != (2, 2):
        raise ValueError(
            f"noise: expected a covariance matrix of two rows and columns, got {list(matrix.shape)}"
        )
    if not np.array_equal(matrix, matrix.T):
        raise ValueError(
            f"noise: expected a symmetric covariance matrix, got {matrix[0, 1]:g} above the "
            f"diagonal and {matrix[1, 0]:g} below it"
        )
    variances = matrix.diagonal()
    correlation = float(matrix[0, 1] / variances.prod() ** 0.5) if (variances > 0).all() else 2.0
    if not abs(correlation) < 1 - _ROUNDING:
        least = np.linalg.eigvalsh(matrix)[0] if np.isfinite(matrix).all() else np.nan
        raise ValueError(
            f"noise: expected a covariance matrix with eigenvalues above 0, got {least:.4g}; noise "
            "along a single direction needs axes along it and across it"
        )
    return tuple(np.sqrt(variances).tolist()), correlation


def listed(noise: Any, axes: int) -> tuple[Any, ...]:
    """Return one standard deviation per axis, for one number or one per axis."""
    return tuple(noise) if isinstance(noise, tuple) or np.ndim(noise) else (noise,) * axes


@dataclasses.dataclass(frozen=True)
class _Deviations:
    """A function of a point and parameters that returns one standard deviation per axis."""

    function: Callable[..., Any]
    axes: int

    def __call__(self, x: Any, params: Any) -> Any:
        return jnp.broadcast_to(jnp.asarray(self.function(x, params), float), (self.axes,))
