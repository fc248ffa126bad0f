"""Ends of a process on the cells of a box: regions that it enters, and open sides of the box."""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from jaxtyping import Bool, Float, Int
from scipy.sparse import block_array, csr_array, eye_array

from ...mapping.generalized import leaving_rows
from ...markov.hitting import cell_mask
from ...space.box import Box


Region: TypeAlias = Callable[[Any], Any] | npt.ArrayLike
"""A set of points: a function of points `[points, axes]` that returns a mask `[points]`; or cells
of the box, as a mask or as a list."""

_Within: TypeAlias = Callable[[Float[np.ndarray, "points axes"]], Bool[np.ndarray, "points"]]

# Number of halvings that find a boundary between two points.
_HALVINGS = 24
# Shortest way to a boundary, in cells: a shorter one would need very many steps of a chain.
_SHORTEST = 0.01
# Numbers of cells along an axis of the coarser boxes, as parts of those of the box.
_PARTS = 2 / 3, 1 / 2
# Number of points of a cell that tell which share of it is in a region.
_POINTS = 64


def within(region: Region, box: Box, name: str) -> _Within:
    """Return the function of points that checks whether they are in a region of a box."""
    if callable(region):

        def check(points: Float[np.ndarray, "points axes"]) -> Bool[np.ndarray, "points"]:
            mask = np.asarray(region(points))
            if mask.dtype != bool or mask.shape != points.shape[:1]:
                raise ValueError(
                    f"{name}: expected a function of points [points, axes] that returns a mask "
                    f"[points], got {mask.dtype} {list(mask.shape)} for {list(points.shape)}"
                )
            return mask

        return check
    # The two sinks are in no region of cells.
    mask = np.append(cell_mask(box.size, region, name), [False, False])
    return lambda points: mask[box.index(points)]


@dataclasses.dataclass(frozen=True, eq=False)
class Ends:
    """The ends of a process in a box. A chain that stops there has a cell for each, after the box.

    A step along an axis, down or up, leads to the centre of the neighbouring cell or, if this is in
    an end, to the boundary of the end on the way there.
    """

    box: Box
    names: tuple[str, ...]
    regions: tuple[_Within, ...]

    @classmethod
    def of(cls, box: Box, regions: Mapping[str, Region], *, sides: bool = True) -> "Ends":
        """Find the ends of a box: its regions, and the sides of its axes that are sinks.

        Without `sides`, the outside of the box is one end.
        """
        each = {name: within(region, box, name) for name, region in regions.items()}
        sinks = [axis for axis, kind in enumerate(box.axes) if kind == "sink"]
        out = [f"{side} x{axis}" for axis in sinks for side in ("below", "above")]
        if sinks and not sides:
            out = ["outside of the box"]
        return cls(box, (*each, *out), tuple(each.values()))

    @property
    def levels(self) -> "tuple[Ends, ...]":
        """The ends in this box, and in boxes with cells of 1.5 and 2 times the width."""
        box = self.box
        cells = ([max(1, round(part * n)) for n in box.cells] for part in _PARTS)
        boxes = (Box(box.lower, box.upper, each, box.axes) for each in cells)
        return self, *(dataclasses.replace(self, box=coarse) for coarse in boxes)

    @functools.cached_property
    def end(self) -> Int[np.ndarray, "cells"]:
        """The number of the first region with the centre of each cell, or -1."""
        return self.inside(self.box.centre(np.arange(self.box.size, dtype=np.int32)))

    @property
    def alive(self) -> Bool[np.ndarray, "cells"]:
        """A mask of the cells whose centres are in no region."""
        return self.end < 0

    @property
    def cells(self) -> int:
        """Number of cells of a chain that stops: those of the box, and one for each end."""
        return self.box.size + len(self.names)

    def inside(self, points: Float[np.ndarray, "points axes"]) -> Int[np.ndarray, "points"]:
        """Return the number of the first region with each point, or -1."""
        number = np.full(len(points), -1)
        for k, region in reversed(list(enumerate(self.regions))):
            number[region(points)] = k
        return number

    def step(
        self, axis: int, sign: int
    ) -> tuple[Int[np.ndarray, "cells"], Float[np.ndarray, "cells"]]:
        """Return the cell to which a step along an axis leads from each cell, and its length.

        A step beyond a clamped side leads to the cell itself.
        """
        box, size = self.box, self.box.size
        number = np.arange(size, dtype=np.int32)
        at, count, kind = box.coordinates(number), box.cells[axis], box.axes[axis]
        at[:, axis] += sign
        beyond = (at[:, axis] < 0) | (at[:, axis] >= count)
        at[:, axis] %= count
        image = np.ravel_multi_index(tuple(at.T), box.cells)
        width = float(box.width[axis])
        length = np.full(size, width)
        crossed = self.alive & (self.end[image] >= 0) & ~(beyond & (kind != "periodic"))
        start = box.centre(number[crossed])
        length[crossed] = width * self._way(start, axis, sign * width, self.end[image[crossed]])
        image[crossed] = size + self.end[image[crossed]]
        if kind == "clamp":
            image[beyond] = number[beyond]
        elif kind == "sink":
            side = f"{'below' if sign < 0 else 'above'} x{axis}"
            image[beyond], length[beyond] = size + self.names.index(side), width / 2
        return image, length

    def _way(
        self,
        start: Float[np.ndarray, "ways axes"],
        axis: int,
        length: float,
        end: Int[np.ndarray, "ways"],
    ) -> Float[np.ndarray, "ways"]:
        """Return the share of each way along an axis after which it enters its region."""
        low, high = np.zeros(len(start)), np.ones(len(start))
        for _ in range(_HALVINGS if len(start) else 0):
            middle = (low + high) / 2
            point = start.copy()
            point[:, axis] += length * middle
            there = self.inside(self.box.wrapped(point)) == end
            low, high = np.where(there, low, middle), np.where(there, middle, high)
        return np.maximum(high, _SHORTEST)

    @functools.cached_property
    def around(self) -> Box:
        """The box with one more cell beyond each clamped side, for the points beyond the side."""
        box = self.box
        more = np.array(box.axes) == "clamp"
        low, high = box.lower - more * box.width, box.upper + more * box.width
        return Box(low, high, np.array(box.cells) + 2 * more, box.axes)

    @functools.cached_property
    def nearest(self) -> Int[np.ndarray, "around"]:
        """The cell of the box for each cell of `around`."""
        return self.box.index(self.around.centre(np.arange(self.around.size, dtype=np.int32)))

    @functools.cached_property
    def share(self) -> Float[np.ndarray, "regions around"]:
        """The share of each cell of `around` that is in each region, from a grid of points."""
        box = self.around
        each = max(2, round(_POINTS ** (1 / box.dimensions)))
        grid = np.stack(
            np.meshgrid(*[(np.arange(each) + 0.5) / each - 0.5] * box.dimensions, indexing="ij")
        ).reshape(box.dimensions, -1)
        centre = box.centre(np.arange(box.size, dtype=np.int32))
        count = np.zeros((len(self.regions) + 1, box.size))
        for place in grid.T:
            count[self.inside(centre + place * box.width), np.arange(box.size)] += 1
        return count[:-1] / grid.shape[1]

    @property
    def open(self) -> Bool[np.ndarray, "cells"]:
        """A mask of the cells of the box that are not completely in a region."""
        inner = self.box.centre(np.arange(self.box.size, dtype=np.int32))
        return self.share[:, self.around.index(inner)].sum(axis=0) < 1

    def stopped(self, matrix: csr_array) -> csr_array:
        """Return the matrix of a chain on the box that stops in each region and outside the box.

        The columns of the matrix are the cells of `around`. The part of a cell that is in a region
        belongs to it, and all that is beyond a clamped side and not in a region to the last cell.
        """
        share, size = self.share, self.box.size
        ends = np.zeros((size, len(self.names)))
        ends[:, : len(share)] = matrix @ share.T
        ends[:, len(share) :] = leaving_rows(matrix)[:, None]
        entry = 1 - share.sum(axis=0), (np.arange(self.nearest.size), self.nearest)
        rest = matrix @ csr_array(entry, shape=(self.nearest.size, size))
        blocks = [[rest, csr_array(ends)], [None, eye_array(len(self.names))]]
        whole = block_array(blocks, format="csr")
        whole.eliminate_zeros()
        return whole

    def weights(self, point: Sequence[float], odd: bool) -> Float[np.ndarray, "cells"]:
        """Return the weights of cells and ends with which their values are interpolated at a point.

        With `odd`, values at the faces of sinks are those of the ends.
        """
        box = self.box
        place = np.asarray(point, float)
        if place.shape != (box.dimensions,) or not np.isfinite(place).all():
            raise ValueError(f"start: expected {box.dimensions} coordinates, got {point!r}")
        place = box.wrapped(place)
        if box.index(place) >= box.size or ((place < box.lower) | (place > box.upper)).any():
            raise ValueError(
                f"start: the point {point!r} is outside of the box, from {box.lower} to {box.upper}"
            )
        if (number := int(self.inside(place[None])[0])) >= 0:
            raise ValueError(f"start: the point {point!r} is in the region {self.names[number]}")
        # The cell, or the side, with a weight along each axis.
        weight = np.zeros(self.cells)
        each = [self._along(axis, float(place[axis]), odd) for axis in range(box.dimensions)]
        for corner in itertools.product(*each):
            sides = [at for at, _ in corner if isinstance(at, str)]
            if sides:
                cell = box.size + self.names.index(sides[0])
            else:
                cell = int(np.ravel_multi_index([at for at, _ in corner], box.cells))
                cell = cell if self.alive[cell] else box.size + int(self.end[cell])
            weight[cell] += math.prod(share for _, share in corner)
        return weight

    def _along(self, axis: int, place: float, odd: bool) -> list[tuple[Any, float]]:
        """List the two indices, or an index and a side, around a place, and their weights."""
        count, kind = self.box.cells[axis], self.box.axes[axis]
        offset = (place - self.box.lower[axis]) / float(self.box.width[axis]) - 0.5
        first = math.floor(offset)
        pair: list[tuple[Any, float]] = [(first, first + 1 - offset), (first + 1, offset - first)]
        if kind == "periodic":
            return [(index % count, share) for index, share in pair]
        if not (kind == "sink" and odd) or 0 <= offset <= count - 1:
            return [(min(max(index, 0), count - 1), share) for index, share in pair]
        nearest, side = (0, "below") if offset < 0 else (count - 1, "above")
        beyond = 2 * abs(offset - nearest)
        return [(nearest, 1 - beyond), (f"{side} x{axis}", beyond)]
