import dataclasses
import math
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..base.limits import Collision
from ..base.shown import Shown
from ..base.wide import traced
from .cells import TOLERANCE, CellSpace, free_space_in_cells
from .segments import crossed_squares, meets_wall


_Square: TypeAlias = tuple[int, int]
# Squares of which all, and pairs of squares of which one has to be free.
_Squares: TypeAlias = tuple[tuple[_Square, ...], tuple[tuple[_Square, _Square], ...]]
# Centres near walls, and a mask of their blocked steps.
_Blocked: TypeAlias = tuple[Int[np.ndarray, "near"], Bool[np.ndarray, "near directions"]]


@dataclasses.dataclass(frozen=True)
class Rule:
    """A collision rule: the part of a step that has to stay in the closed free space.

    To add a rule, add its `part` to `RULES`, and its name to `Collision`. Squares and blocked steps
    follow from the part; a rule may have functions that find them faster. A part may touch walls,
    and pass points where two obstacles meet, which the functions of the rule `"swept"` forbid.
    """

    part: Callable[[Float[np.ndarray, "paths points 2"]], Any]
    "A function that returns the part of each path that has to be free, as shapely geometries."
    quick_squares: Callable[[float, float, _Square], _Squares] | None = None
    "A faster function in place of `squares`, such as [`crossed_squares`][], or `None`."
    quick_blocked: Callable[..., _Blocked] | None = None
    "A faster function in place of `blocked`, or `None`."

    def squares(self, dx: float, dy: float, offset: _Square) -> _Squares:
        """List the squares that have to be free for a step from the centre of a square.

        The arguments and the results are those of [`crossed_squares`][]. Of the two squares beside
        an edge along which the part runs, one has to be free.
        """
        if self.quick_squares is not None:
            return self.quick_squares(dx, dy, offset)
        part = self.part(np.array([[(0.5, 0.5), (0.5 + dx, 0.5 + dy)]]))[0]
        left, bottom, right, top = shapely.bounds(part)
        rows = np.arange(math.floor(bottom) - 1, math.ceil(top) + 1)
        columns = np.arange(math.floor(left) - 1, math.ceil(right) + 1)
        row, column = map(np.ravel, np.meshgrid(rows, columns, indexing="ij"))
        in_square = shapely.box(
            column + TOLERANCE, row + TOLERANCE, column + 1 - TOLERANCE, row + 1 - TOLERANCE
        )
        met = shapely.intersects(in_square, part)
        crossed = {offset, *zip(row[met].tolist(), column[met].tolist(), strict=True)}
        beside = []
        for up, across in ((0, 1), (1, 0)):
            edges = np.stack([column + across, row + up, column + 1, row + 1], axis=1)
            edges = shapely.buffer(shapely.linestrings(edges.reshape(-1, 2, 2)), TOLERANCE)
            along = shapely.length(shapely.intersection(edges, part)) > 4 * TOLERANCE
            for first in zip(row[along].tolist(), column[along].tolist(), strict=True):
                beside.append((first, (first[0] + up, first[1] + across)))
        return tuple(crossed), tuple(pair for pair in beside if crossed.isdisjoint(pair))

    def blocked(
        self,
        cells: CellSpace,
        centres: Float[np.ndarray, "positions 2"],
        steps: Float[np.ndarray, "directions 2"],
        near: Int[np.ndarray, "pairs"],
        wall: Int[np.ndarray, "pairs"],
    ) -> _Blocked:
        """Find the steps that walls block; `near` and the results are as in [`meets_wall`][]."""
        if self.quick_blocked is not None:
            return self.quick_blocked(cells.walls, centres, steps, near, wall)
        near = np.unique(near)
        closed = free_space_in_cells(cells).buffer(TOLERANCE, join_style="mitre")
        shapely.prepare(closed)
        paths = centres[near][:, None, None] + np.stack([0 * steps, steps], axis=1)
        parts = self.part(paths.reshape(-1, 2, 2)).reshape(paths.shape[:2])
        return near, ~shapely.covers(closed, parts)


RULES: dict[Collision, Rule] = {
    "swept": Rule(shapely.linestrings, crossed_squares, meets_wall),
    "endpoint": Rule(
        lambda paths: shapely.points(paths[:, -1]), lambda dx, dy, offset: ((offset,), ())
    ),
}
"The part of a step that has to be free, by the name of the rule."


@dataclasses.dataclass(frozen=True)
class Motion(Shown):
    """The motion of a robot: the length of a step, and the rule by which walls block a step.

    Steps of half a metre that have to be free only at their ends, as in the dissertation:

        >>> from jaxcell import space
        >>> space.Motion(step=0.5, collision="endpoint").in_cells(0.25)
        2.0
    """

    step: float | None = None
    "Length of a step in metres, at least one cell; `None` stands for one cell."
    collision: Collision = "swept"
    """The part of a step that must lie in the closed free space: the whole step (`"swept"`), or
    only its end (`"endpoint"`, as in Alam 2018). The end must also lie in a free cell. A swept step
    may graze a corner, but not pass between two obstacles that meet in a point."""

    def __post_init__(self) -> None:
        if self.collision not in RULES:
            names = " or ".join(map(repr, RULES))
            raise ValueError(f"collision: expected {names}, got {self.collision!r}")
        if traced(self.step):
            raise TypeError(
                "step: expected a number, got an array that JAX traces; walls are found on the "
                "host: make the motion outside jit, vmap and grad"
            )
        if self.step is not None and np.asarray(self.step).dtype.kind not in "iuf":
            raise ValueError(f"step: expected a length in metres, got {self.step!r}")

    @property
    def rule(self) -> Rule:
        return RULES[self.collision]

    def in_cells(self, cell: float) -> float:
        """Convert the length of a step to cells; `cell` is the side of a cell in metres."""
        length = 1.0 if self.step is None else self.step / cell
        if not (math.isfinite(length) and length >= 1 - 1e-9):
            raise ValueError(f"step: expected at least one cell, {cell:g} m, got {self.step} m")
        return length


CELL_BY_CELL = Motion()
"Steps of one cell that have to be free along their whole length."
ENDPOINT = Motion(collision="endpoint")
"Steps of one cell that have to be free at their ends only, as in Alam 2018."
