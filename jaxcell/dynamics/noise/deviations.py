import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from ...base.wide import traced
from ...space.box import Box
from ..imaging import mapped_points
from ..maps import with_params


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
        raise ValueError(f"noise: expected {box.dimensions} numbers, got {len(each)}")
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
    deviation, symmetric = np.sqrt(np.abs(matrix.diagonal())), np.array_equal(matrix, matrix.T)
    definite = matrix.shape == (2, 2) and symmetric and (matrix.diagonal() > 0).all()
    correlation = float(matrix[0, 1] / deviation.prod()) if definite else 1.0
    if not abs(correlation) < 1:
        raise ValueError(f"noise: expected a positive definite matrix, got {matrix.tolist()}")
    return tuple(deviation.tolist()), correlation


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
