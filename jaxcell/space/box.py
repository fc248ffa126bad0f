import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float, Int, Num

from ..base.shown import Shown
from .cells import TOLERANCE


Axis: TypeAlias = Literal["sink", "periodic", "clamp"]
"""The treatment of points beyond the ends of an axis: they go to a `"sink"`, come back in at the
other end (`"periodic"`), or belong to the cell at the end (`"clamp"`)."""


@dataclasses.dataclass(frozen=True)
class Box(Shown):
    """A box of equal cells, of any number of dimensions.

    Cells are numbered from 0, and the index along the last axis changes fastest:
    `array.reshape(box.cells)` turns an array over cells into an array over the axes. A point on the
    face between two cells, with a tolerance of 1e-9 of a cell, belongs to the upper cell. Two sinks
    are numbered after the cells: `outside` for points that left the box, and `nowhere` for
    points with a coordinate that is not finite.

    A box is hashable. Its methods take arrays of NumPy or JAX, and work under `jit` and `vmap`.

    An angle and a speed, in two by four cells:

        >>> import numpy as np
        >>> from jaxcell import space
        >>> box = space.Box([-np.pi, -2], [np.pi, 2], cells=[2, 4], axes=["periodic", "sink"])
        >>> box.size, box.index(np.array([[0.1, -1.5], [0.1 + 2 * np.pi, -1.5], [0, 2]])).tolist()
        (8, [4, 4, 8])
        >>> box.centre(np.array([4])).round(3).tolist()
        [[1.571, -1.5]]
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    cells: tuple[int, ...]
    "Number of cells along each axis."
    axes: tuple[Axis, ...]
    "The treatment of points beyond the ends of each axis."

    def __init__(
        self,
        lower: Sequence[float | int] | np.ndarray,
        upper: Sequence[float | int] | np.ndarray,
        cells: Sequence[int] | np.ndarray | None = None,
        axes: Sequence[Axis] | Axis = "sink",
    ) -> None:
        """Create a box from its lower and upper corner, and its number of cells along each axis.

        A single value of `axes` applies to all axes.
        """
        if cells is None:
            raise ValueError(
                "box: expected a lower and an upper corner, and a number of cells along each axis, "
                "as in Box([-2, -1], [2, 1], cells=[400, 200])"
            )
        for name, ends in (("lower", lower), ("upper", upper), ("cells", cells)):
            if np.ndim(ends) != 1 or np.asarray(ends).dtype.kind not in "iuf":
                raise ValueError(f"{name}: expected a number for each axis, got {ends!r}")
        kinds = (axes,) * len(lower) if isinstance(axes, str) else tuple(axes)
        object.__setattr__(self, "lower", tuple(map(float, lower)))
        object.__setattr__(self, "upper", tuple(map(float, upper)))
        object.__setattr__(self, "cells", tuple(map(int, cells)))
        if any(count != given for count, given in zip(self.cells, cells, strict=True)):
            raise ValueError(f"cells: expected whole numbers, got {list(cells)}")
        object.__setattr__(self, "axes", kinds)
        lengths = {len(self.lower), len(self.upper), len(self.cells), len(kinds)}
        if len(lengths) > 1 or not self.lower:
            raise ValueError(
                f"box: expected equal numbers of lower ends, upper ends, cells and axes, got "
                f"{len(self.lower)}, {len(self.upper)}, {len(self.cells)} and {len(kinds)}"
            )
        for axis, (low, high, count, kind) in enumerate(
            zip(self.lower, self.upper, self.cells, kinds, strict=True)
        ):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise ValueError(f"box: axis {axis} goes from {low:g} to {high:g}: no volume")
            if count < 1:
                raise ValueError(f"cells: axis {axis} has {count}, expected at least 1")
            if kind not in get_args(Axis):
                raise ValueError(
                    f"axes: expected sink, periodic or clamp, got {kind!r} for axis {axis}"
                )
        if self.size > np.iinfo(np.int32).max - 1:
            raise ValueError(
                f"cells: {' x '.join(map(str, self.cells))} = {self.size:,} are more than the "
                f"{np.iinfo(np.int32).max - 1:,} that 32 bits number"
            )

    @property
    def dimensions(self) -> int:
        """Number of axes."""
        return len(self.cells)

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.cells)

    @property
    def outside(self) -> int:
        """The sink of points that left the box."""
        return self.size

    @property
    def nowhere(self) -> int:
        """The sink of points with a coordinate that is not finite."""
        return self.size + 1

    @property
    def width(self) -> Float[np.ndarray, "axes"]:
        """Length of a cell along each axis."""
        return (np.array(self.upper) - np.array(self.lower)) / np.array(self.cells)

    def ticks(self, axis: int) -> Float[np.ndarray, "cells"]:
        """Return the coordinates of the centres of cells along an axis."""
        return self.lower[axis] + (np.arange(self.cells[axis]) + 0.5) * self.width[axis]

    def coordinates(self, index: Int[Any, "..."]) -> Int[Any, "... axes"]:
        """Convert the numbers of cells to their indices along each axis."""
        xp = index.__array_namespace__()
        return xp.stack(self._unravel(index), axis=-1)

    def apart(self, cells: Num[Any, "... axes"]) -> Num[Any, "... axes"]:
        """Convert index differences to distances in cells, the shorter way around periodic axes."""
        xp = cells.__array_namespace__()
        along = []
        for axis, (count, kind) in enumerate(zip(self.cells, self.axes, strict=True)):
            here = xp.abs(cells[..., axis])
            if kind == "periodic":
                # Vector units do not compute the remainder of floating-point numbers.
                here = here - count * xp.floor(here / count)
                here = xp.minimum(here, count - here)
            along.append(here)
        return xp.stack(along, axis=-1)

    def centre(self, index: Int[Any, "..."], dtype: Any = None) -> Float[Any, "... axes"]:
        """Compute the centres of cells, by default in the widest floating-point type in use."""
        xp = index.__array_namespace__()
        kind = dtype or xp.asarray(0.0).dtype
        along = zip(self._unravel(index), self.lower, self.width.tolist(), strict=True)
        return xp.stack(
            [xp.asarray(k, dtype=kind) * width + (low + 0.5 * width) for k, low, width in along],
            axis=-1,
        )

    def index(self, points: Float[Any, "... axes"]) -> Int[Any, "..."]:
        """Find the number of the cell, or of the sink, of each point."""
        xp = points.__array_namespace__()
        index = xp.zeros(points.shape[:-1], dtype=xp.int32)
        places, inside = self.places(points)
        for axis, count in enumerate(self.cells):
            index = index * count + xp.asarray(places[..., axis], dtype=xp.int32)
        finite = xp.all(xp.isfinite(points), axis=-1)
        cell = xp.where(inside, index, self.outside)
        return xp.asarray(xp.where(finite, cell, self.nowhere), dtype=xp.int32)

    def places(self, points: Float[Any, "... axes"]) -> tuple[Float[Any, "... axes"], Any]:
        """Find the index along each axis of the cell of each point, clipped to the box.

        Returns indices in the data type of the points, and a mask of the points inside the box.
        """
        xp = points.__array_namespace__()
        inside = xp.ones(points.shape[:-1], dtype=bool)
        along = []
        about = zip(self.lower, self.width.tolist(), self.cells, self.axes, strict=True)
        for axis, (low, width, count, kind) in enumerate(about):
            place = xp.floor((points[..., axis] - low) / width + TOLERANCE)
            if kind == "periodic":
                place = place - count * xp.floor(place / count)
            # One cell beyond a face is enough, and no integer overflows.
            place = xp.clip(place, -1, count)
            if kind == "sink":
                inside = inside & (place >= 0) & (place < count)
            along.append(xp.clip(xp.where(xp.isfinite(place), place, 0), 0, count - 1))
        return xp.stack(along, axis=-1), inside

    def wrapped(self, points: Float[Any, "... axes"]) -> Float[Any, "... axes"]:
        """Shift points into the box, by whole periods along periodic axes.

        Without this, coordinates of points that are mapped many times would grow and lose digits.
        """
        xp = points.__array_namespace__()
        along = []
        for axis, (low, high, kind) in enumerate(
            zip(self.lower, self.upper, self.axes, strict=True)
        ):
            here = points[..., axis]
            if kind == "periodic":
                here = here - (high - low) * xp.floor((here - low) / (high - low))
            along.append(here)
        return xp.stack(along, axis=-1)

    def _unravel(self, index: Any) -> list[Any]:
        along = []
        for count in reversed(self.cells):
            along.append(index % count)
            index = index // count
        return along[::-1]
