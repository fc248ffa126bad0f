"""Cells of a repeatedly bisected box, and the graph of their outer images."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from ...base import memory
from ...space.box import Box
from ...space.copies import copies


# Bytes of an edge (its end and weight, and copies by the search for components), and of a row of
# cells in an image.
_BYTES_PER_EDGE, _BYTES_PER_ROW = 40, 100
# Ranks of cells are read from a table, if it has few entries in all or per cell.
_TABLE, _TABLE_PER_CELL = 1 << 22, 64


@dataclasses.dataclass(frozen=True)
class Grid:
    """The cells of a box after `bisections` bisections of each, along one axis after the other.

    The faces of the cells have 64-bit coordinates, and the two halves of a cell cover it exactly.
    So comparisons of coordinates find all cells that touch an image, in spite of rounding.
    """

    box: Box
    bisections: int

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of cells along each axis."""
        axes = self.box.dimensions
        times = [(self.bisections + axes - 1 - axis) // axes for axis in range(axes)]
        return tuple(n << k for n, k in zip(self.box.cells, times, strict=True))

    @property
    def faces(self) -> list[Float[np.ndarray, "faces"]]:
        """The coordinates of the faces of cells along each axis."""
        each = []
        for axis, count in enumerate(self.counts):
            low, high = self.box.lower[axis], self.box.upper[axis]
            faces = low + (high - low) * (np.arange(count + 1) / count)
            faces[-1] = high
            if not (np.diff(faces) > 0).all():
                raise ValueError(f"depth: {self.bisections} bisections leave cells without width")
            each.append(faces)
        return each

    def corners(
        self, cells: Int[np.ndarray, "cells"]
    ) -> tuple[Float[np.ndarray, "cells axes"], Float[np.ndarray, "cells axes"]]:
        """Return the lower and upper corners of cells."""
        places = list(zip(self.faces, np.unravel_index(cells, self.counts), strict=True))
        lower, upper = (np.stack([faces[k + e] for faces, k in places], axis=1) for e in (0, 1))
        return lower, upper

    def halves(self, cells: Int[np.ndarray, "cells"]) -> Int[np.ndarray, "halves"]:
        """Return the two halves of each cell, which are cells of the next bisection."""
        axis = self.bisections % self.box.dimensions
        places = [np.repeat(k, 2) for k in np.unravel_index(cells, self.counts)]
        places[axis] = 2 * places[axis] + np.tile([0, 1], cells.size)
        return np.ravel_multi_index(tuple(places), Grid(self.box, self.bisections + 1).counts)

    def blocks(
        self, lower: Float[np.ndarray, "images axes"], upper: Float[np.ndarray, "images axes"]
    ) -> tuple[Int[np.ndarray, "images axes"], Int[np.ndarray, "images axes"]]:
        """Find the first and the last cell along each axis that touch each image.

        If no cell touches an image, its last cell comes before its first. Along a periodic axis,
        the numbers of cells continue beyond both ends of the box.
        """
        firsts, lasts = [], []
        for axis, (kind, faces) in enumerate(zip(self.box.axes, self.faces, strict=True)):
            low, high, count = lower[:, axis], upper[:, axis], faces.size - 1
            around = np.zeros(low.size, bool)
            if kind == "periodic":
                period = faces[-1] - faces[0]
                around = ~(high - low < period)
                low, high = np.where(around, faces[0], low), np.where(around, faces[0], high)
                turns = np.floor((low - faces[0]) / period)
                # The error exceeds the rounding of a shift; images that are inside do not move.
                error = 2.0**-50 * (np.abs(low) + np.abs(high) + np.abs(turns) * period)
                error[turns == 0] = 0
                low, high = low - turns * period - error, high - turns * period + error
            first = np.searchsorted(faces, low, "left") - 1
            last = np.searchsorted(faces, high, "right") - 1
            if kind == "periodic":
                rest = high - period + 2.0**-50 * (np.abs(high) + period)
                beyond = count + np.searchsorted(faces, rest, "right") - 1
                last = np.where(high < faces[-1], last, np.maximum(beyond, count))
                last = np.where(around, first + count - 1, np.minimum(last, first + count - 1))
            else:
                first, last = np.maximum(first, 0), np.minimum(last, count - 1)
            if kind == "clamp":
                first, last = np.minimum(first, count - 1), np.maximum(last, 0)
            firsts.append(first)
            lasts.append(last)
        first, last = np.stack(firsts, axis=1), np.stack(lasts, axis=1)
        nowhere = np.isnan(lower).any(axis=1) | np.isnan(upper).any(axis=1)
        return first, np.where(nowhere[:, None], first - 1, last)

    def graph(
        self,
        cells: Int[np.ndarray, "cells"],
        first: Int[np.ndarray, "cells axes"],
        last: Int[np.ndarray, "cells axes"],
    ) -> csr_array:
        """Build the matrix whose entry `i, j` is 1 if the block of cell `i` contains cell `j`.

        `cells` are in ascending order, and `first` and `last` are results of `blocks`.
        """
        # A block is a set of rows along the last axis, each of which is a range of cells.
        *leading, count = self.counts
        sizes = np.maximum(last - first + 1, 0)
        sizes[(sizes == 0).any(axis=1)] = 0
        rows = sizes[:, :-1].prod(axis=1) * (sizes[:, -1] > 0)
        _check(int(rows.sum()) * _BYTES_PER_ROW)
        source, place = copies(rows)
        row = np.zeros(source.size, np.int64)
        stride = 1
        for axis in reversed(range(len(leading))):
            place, along = np.divmod(place, sizes[source, axis])
            row += (along + first[source, axis]) % leading[axis] * stride
            stride *= leading[axis]
        begin = first[source, -1] % count
        end = begin + sizes[source, -1]
        ranges = [(row * count + begin, row * count + np.minimum(end, count))]
        if self.box.axes[-1] == "periodic":
            # Beyond the end of the axis, a row continues at its beginning.
            ranges.append((row * count, row * count + np.maximum(end - count, 0)))
        before = _ranks(cells, int(np.prod(self.counts, dtype=np.int64)))
        starts, ends = before(np.array(ranges)).transpose(1, 2, 0).reshape(2, -1)
        source, number = np.repeat(source, len(ranges)), ends - starts
        edges = int(number.sum())
        _check(edges * _BYTES_PER_EDGE)
        indptr = np.zeros(cells.size + 1, np.int64)
        np.cumsum(np.bincount(source, number, cells.size).astype(np.int64), out=indptr[1:])
        target = np.arange(edges) - np.repeat(np.cumsum(number) - number - starts, number)
        kind = np.int32 if edges < np.iinfo(np.int32).max else np.int64
        parts = np.ones(edges), target.astype(kind), indptr.astype(kind)
        return csr_array(parts, shape=(cells.size,) * 2)


def _check(needed: int) -> None:
    memory.check(needed, "the graph of images", "give a smaller depth, or fewer cells")


def _ranks(cells: Int[np.ndarray, "cells"], size: int) -> Callable[[Any], Any]:
    """Return a function that counts the cells whose number is below its argument."""
    if size > max(_TABLE, _TABLE_PER_CELL * cells.size):
        return lambda numbers: np.searchsorted(cells, numbers)
    present = np.zeros(size + 1, np.int32)
    present[cells + 1] = 1
    return np.cumsum(present, dtype=np.int32).__getitem__
