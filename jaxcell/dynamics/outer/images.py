"""Outer images: boxes that contain the images of all points of a box, with or without a proof."""

import dataclasses
import functools
import itertools
from collections.abc import Callable
from typing import Any, Protocol, TypeAlias, runtime_checkable

import jax
import numpy as np
import scipy.spatial
from jaxtyping import Float

from ...base.indices import check_whole
from ...base.precision import require_x64
from ..batches import in_threads, padded
from ..imaging import mapped_points
from ..maps import Map
from .transform import boxes, enclose


# Number of boxes whose images are computed at once; the last ones are padded to it.
_PART = 1 << 12
# Number of samples, nearest to a box, whose bounds of its image are intersected.
_NEAREST = 8
Boxes: TypeAlias = tuple[Float[np.ndarray, "boxes axes"], Float[np.ndarray, "boxes axes"]]


@runtime_checkable
class OuterMap(Protocol):
    """A method that computes outer images: for each box, a box around the images of its points."""

    proof: str
    "The reason why outer images contain the images of all points; empty without a proof."

    def images(self, lower: Any, upper: Any, params: Any, /) -> Boxes:
        """Compute the corners of the outer images of boxes."""


@dataclasses.dataclass(frozen=True)
class Intervals:
    """Proved outer images from interval arithmetic, for maps without a `while` loop.

    The images under a [`flow`][jaxcell.dynamics.flow] enclose its Runge-Kutta steps, but not the
    difference of these steps from the exact flow.
    """

    map: Map
    mean_value: bool = True
    "If true, images are intersected with the images from the mean value theorem."
    proof = "interval arithmetic, rounded outward"

    def images(self, lower: Any, upper: Any, params: Any = None) -> Boxes:
        require_x64("interval arithmetic")
        for leaf in jax.tree.leaves(params):
            if not np.isfinite(leaf).all():
                raise ValueError(f"params: expected finite numbers, got {leaf}")
        lower, upper = boxes(lower, upper)
        enclosed = functools.partial(_enclosed, self.map, self.mean_value, params)
        return _in_batches(enclosed, lower, upper)


@functools.partial(jax.jit, static_argnames=("map", "mean_value"))
def _enclosed(map: Map, mean_value: bool, params: Any, lower: Any, upper: Any) -> Any:
    own = functools.partial(enclose, map, params, mean_value=mean_value)
    return jax.vmap(own)(lower, upper)


@dataclasses.dataclass(frozen=True)
class Corners:
    """Boxes around the images of some points of each box: the usual, fast method, without proof."""

    map: Map
    points: int = 2
    "Number of points along each axis of a box, including both faces; with 1, only its centre."
    padding: float = 0.0
    "Width that is added on all sides of an image, as a multiple of the width of its box."
    proof = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", check_whole("points", self.points, 1))
        if not (np.ndim(self.padding) == 0 and 0 <= self.padding < np.inf):
            raise ValueError(f"padding: expected a finite number from 0, got {self.padding!r}")

    def images(self, lower: Any, upper: Any, params: Any = None) -> Boxes:
        lower, upper = boxes(lower, upper)
        place = np.linspace(0, 1, self.points) if self.points > 1 else np.full(1, 0.5)
        place = np.array(list(itertools.product(place, repeat=lower.shape[1])))

        def around(lower: Any, upper: Any) -> Boxes:
            low, high = lower[:, None], upper[:, None]
            points = np.where(place == 1, high, low + place * (high - low))
            images = np.asarray(mapped_points(self.map, params, points))
            # `fmin` and `fmax` leave out images that are no numbers.
            return np.fmin.reduce(images, axis=1), np.fmax.reduce(images, axis=1)

        low, high = _in_batches(around, lower, upper)
        pad = self.padding * (upper - lower)
        return low - pad, high + pad


def _in_batches(images: Callable[[Any, Any], Any], lower: Any, upper: Any) -> Boxes:
    def part(k: int) -> Any:
        return padded(images, [lower[k : k + _PART], upper[k : k + _PART]], _PART)

    parts = [(lower[:0], lower[:0]), *in_threads(part, range(0, len(lower), _PART))]
    low, high = (np.concatenate(ends) for ends in zip(*parts, strict=True))
    return low, high


@dataclasses.dataclass(frozen=True, eq=False)
class Samples:
    """Outer images from samples and Lipschitz constants of a map, proved if these are correct.

    Coordinate `i` of the images of two points differs by at most the sum of
    `lipschitz[i, j] * abs(difference along axis j)`. So the images of the samples nearest to a box,
    each enlarged by this bound, contain the image of the box.
    """

    points: Float[np.ndarray, "samples axes"]
    values: Float[np.ndarray, "samples axes"]
    "The images of `points`."
    lipschitz: Float[np.ndarray, "axes axes"] | float
    "The Lipschitz constants, or one number for all of them."
    proof = "samples, and the bound of slopes (lipschitz)"

    def __post_init__(self) -> None:
        points, values = (np.asarray(x, float) for x in (self.points, self.values))
        if points.ndim != 2 or points.shape != values.shape or not len(points):
            raise ValueError(
                f"samples: expected points and values in arrays of one shape [samples, axes], got "
                f"{list(points.shape)} and {list(values.shape)}"
            )
        if not (np.isfinite(points).all() and np.isfinite(values).all()):
            raise ValueError("samples: expected finite points and values")
        bound = np.broadcast_to(np.asarray(self.lipschitz, float), (points.shape[1],) * 2)
        for name, value in (("points", points), ("values", values), ("lipschitz", bound)):
            object.__setattr__(self, name, value)
        _, near = self._tree.query(points, k=min(_NEAREST + 1, len(points)))
        first, second = np.repeat(np.arange(len(points)), near[0].size), near.ravel()
        excess = np.abs(values[first] - values[second])
        excess -= np.abs(points[first] - points[second]) @ bound.T * (1 + 1e-9) + 1e-300
        if (excess > 0).any():
            row, axis = np.argwhere(excess > 0)[0]
            raise ValueError(
                f"lipschitz: samples {first[row]} and {second[row]} contradict the bound: along "
                f"axis {axis} images differ by {excess[row, axis]:.3g} more; give a larger bound"
            )

    @functools.cached_property
    def _tree(self) -> scipy.spatial.cKDTree:
        return scipy.spatial.cKDTree(self.points)

    def images(self, lower: Any, upper: Any, params: Any = None) -> Boxes:
        lower, upper = boxes(lower, upper)
        count = min(_NEAREST, len(self.points))
        _, near = self._tree.query(lower / 2 + upper / 2, k=[*range(1, count + 1)])
        at = self.points[near]
        away = np.maximum(np.abs(upper[:, None] - at), np.abs(lower[:, None] - at))
        # The factor exceeds the rounding of the sum.
        reach = away @ np.transpose(self.lipschitz) * (1 + 1e-14)
        low, high = self.values[near] - reach, self.values[near] + reach
        low, high = np.nextafter(low, -np.inf).max(axis=1), np.nextafter(high, np.inf).min(axis=1)
        if (low > high).any():
            row = int(np.argmax((low > high).any(axis=1)))
            raise ValueError(
                f"lipschitz: the samples near {at[row, 0].tolist()} contradict the bound; give a "
                "larger bound"
            )
        return low, high
