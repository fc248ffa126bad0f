"""A finite filter for robots that start anywhere in the cells of a map with walls along the grid.

A step moves a robot by whole cells, so its offset within its cell stays the same. Offsets with
which robots bump in the same cells form a class. For the robots of one class, the map is exact.

To find the classes, lines divide the square of all offsets into faces. On the lines are the offsets
from which the path of a step passes through a corner of a square, or bends or ends on an edge. From
all offsets of a face, the paths pass through the same squares, so each class is a union of faces.
Offsets on lines, such as the centre of a cell, belong to no class.
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import jax
import numpy as np
import shapely
from jaxtyping import Bool, Float

from ...automata import Filter
from ...base.quantities import derived
from ...base.shown import Shown
from ...mapping import SimpleMap
from ...space import CELL_BY_CELL, CellSpace, Motion
from ..dynamics import bounce_shift
from ..joint_image import squares_of
from .off_centre import OffCentre, Shares, filter_shares, walker_path
from .other_rooms import MOST_CELLS, filter_agreement
from .result import Evidence, LocalizationFilter


LIMIT = 64
# With more lines than this number, random offsets are drawn to count the classes.
_LINES = 200
_THIN = 1e-9
# The number of offsets at which robots start in other rooms.
_OTHER_OFFSETS = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Offsets(Shown):
    """The classes of offsets within a cell; robots of one class bump in the same cells."""

    cells: CellSpace
    motion: Motion
    offset: Float[np.ndarray, "classes 2"]
    "An example for each class: an offset from the lower left corner of a cell with side 1."
    bumped: Bool[np.ndarray, "classes cells"]
    "A mask of the cells where a robot of each class bumps."

    @classmethod
    def of(
        cls, cells: CellSpace, *, motion: Motion = CELL_BY_CELL, limit: int = LIMIT
    ) -> "Offsets":
        """Find the classes of offsets with which robots bump in the same cells in all directions.

        **Raises:** `ValueError` if walls are not along the grid, or `limit` classes do not suffice.
        """
        if not cells.gridded:
            raise ValueError(
                "map: its walls do not run along the edges of its cells, so offsets within a cell "
                "have too many classes; use `jaxcell localize anywhere`"
            )
        lines = _lines(walker_path(cells, motion))
        few = len(lines) <= _LINES
        drawn = _faces(lines) if few else np.random.default_rng(0).uniform(size=(4 * limit, 2))
        classes: dict[bytes, tuple] = {}
        for offset, bumped in zip(drawn, _bumps(cells, motion, drawn), strict=True):
            classes.setdefault(np.packbits(bumped).tobytes(), (offset, bumped))
            if len(classes) > limit:
                break
        if len(classes) > limit or not few:
            raise ValueError(
                f"map: offsets within a cell have at least {len(classes)} classes; expected at "
                f"most {limit}, which can be found; use `jaxcell localize anywhere`"
            )
        offsets, bumps = zip(*classes.values(), strict=True)
        return cls(cells, motion, np.array(offsets), np.array(bumps))

    def bounce_map(self, bounce: float) -> SimpleMap:
        """Compute the image of each cell of each class; cell `z` of class `c` is `c * size + z`."""
        cells, classes = self.cells, len(self.offset)
        shift = int(bounce_shift(bounce, cells.directions))
        direction, position = np.divmod(np.arange(cells.size), cells.positions)
        path = walker_path(cells, self.motion)
        across, up = np.round(path[direction, -1]).astype(int).T
        ahead = cells.square[position] + up * cells.free.shape[1] + across
        turned = (direction + shift) % cells.directions * cells.positions + position
        # A step off the grid is not possible, so its square does not count.
        last = cells.free.size - 1
        end = cells.position_of_square.ravel()[np.clip(ahead, 0, last)]
        moved = direction * cells.positions + end
        first = cells.size * np.arange(classes)[:, None]
        image = first + np.where(self.bumped, turned, moved)
        return SimpleMap(*jax.device_put((image.ravel().astype(np.int32), self.bumped.ravel())))


@dataclasses.dataclass(frozen=True, eq=False)
class OffsetLocalized(Evidence, LocalizationFilter):
    """A filter for robots that start anywhere in the cells of a map with walls along the grid.

    Cell `z` of class `c` is the configuration `c * cells.size + z`. From the offsets of a class no
    path passes through a corner, so no starts are counted that touch one.
    """

    title: ClassVar[str] = "Localization of a bouncing robot at any offset in its cell"

    cells: CellSpace
    offsets: Offsets
    bounce: float
    "The bouncing angle, in radians."

    @derived("", "classes of offsets within a cell", "1", kind="count")
    def offset_classes(self) -> int:
        return len(self.offsets.offset)

    @derived("", "cells of all classes", "1", kind="count")
    def configurations(self) -> int:
        return self.cells.size * self.offset_classes

    @functools.cached_property
    def off_centre(self) -> Shares:
        """The shares of robots, started anywhere in the cells, that the filter fails to locate."""
        shift = int(bounce_shift(self.bounce, self.cells.directions))
        return filter_shares(self.of_cells(), self.cells, shift, self.offsets.motion, walker=True)

    @functools.cached_property
    def agreement(self) -> Mapping[int, float]:
        if self.cells.size > MOST_CELLS:
            return {}
        motion = self.offsets.motion
        return filter_agreement(self.filter, self.cells, self.bounce, motion, _map_at_some_offsets)

    def of_cells(self, metadata: Mapping[str, Any] | None = None) -> Filter:
        """Build the filter whose states contain cells of the map instead of configurations."""
        filter, size = self.filter, self.cells.size
        state = np.repeat(np.arange(len(filter.transition)), np.diff(filter.offsets))
        owner, member = np.divmod(np.unique(state * size + filter.members % size), size)
        return dataclasses.replace(
            filter,
            members=member.astype(np.int32),
            offsets=np.searchsorted(owner, np.arange(len(filter.transition) + 1)),
            metadata=metadata or {},
        )


def _bumps(
    cells: CellSpace, motion: Motion, offsets: Float[np.ndarray, "offsets 2"]
) -> Iterator[Bool[np.ndarray, "cells"]]:
    """Compute, for each offset, a mask of the cells where a robot bumps."""
    robots = OffCentre.drawn(cells, cells.size, 0, motion=motion, walker=True)
    direction, position = np.divmod(np.arange(cells.size), cells.positions)
    for offset in offsets:
        robots = dataclasses.replace(
            robots,
            offset=np.tile(offset, (cells.size, 1)),
            square=squares_of(cells).T[position],
            direction=direction,
        )
        yield robots.advance()


def _map_at_some_offsets(
    cells: CellSpace, bounce: float, *, motion: Motion = CELL_BY_CELL
) -> SimpleMap:
    """Compute the map of robots at a few random offsets within their cells."""
    offsets = np.random.default_rng(0).uniform(size=(_OTHER_OFFSETS, 2))
    bumped = np.array([*_bumps(cells, motion, offsets)])
    return Offsets(cells, motion, offsets, bumped).bounce_map(bounce)


def _lines(path: Float[np.ndarray, "directions corners 2"]) -> list[tuple[float, float, float]]:
    """List the lines `a x + b y = c` that separate offsets with steps through different squares."""
    lines: dict[tuple[float, float, float], None] = {}
    for corners in path:
        for across, up in (-corners % 1).tolist():
            lines |= {(1.0, 0.0, round(across, 9)): None, (0.0, 1.0, round(up, 9)): None}
        for begin, end in itertools.pairwise(corners):
            along = end - begin
            length = np.hypot(*along)
            if length < _THIN or min(abs(along)) < _THIN:
                continue
            normal = np.array([-along[1], along[0]]) / length
            # A line has two normals: take the one that points to the right.
            normal *= np.copysign(1, normal[0])
            low, high = np.floor(np.minimum(begin, end)), np.ceil(np.maximum(begin, end)) + 1
            square = np.mgrid[low[0] : high[0] + 1, low[1] : high[1] + 1].reshape(2, -1).T
            for level in np.unique(np.round((square - begin) @ normal, 9)).tolist():
                lines[float(round(normal[0], 9)), float(round(normal[1], 9)), level] = None
    corner = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    return [
        (a, b, c)
        for a, b, c in lines
        if (corner @ (a, b)).min() + _THIN < c < (corner @ (a, b)).max() - _THIN
    ]


def _faces(lines: list[tuple[float, float, float]]) -> Float[np.ndarray, "faces 2"]:
    """Find a point in each of the faces into which the lines divide the unit square."""
    cell = shapely.box(0, 0, 1, 1)
    ends = [((a * c - 2 * b, b * c + 2 * a), (a * c + 2 * b, b * c - 2 * a)) for a, b, c in lines]
    cuts = [shapely.intersection(shapely.LineString(one), cell) for one in ends]
    net = shapely.union_all([cell.boundary, *cuts], grid_size=_THIN)
    faces = shapely.get_parts(shapely.polygonize([net]))
    return shapely.get_coordinates(shapely.point_on_surface(faces[shapely.area(faces) > _THIN]))
