import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...base.shown import Shown
from ...space import CELL_BY_CELL, CellSpace, Motion, estimates
from ...space.copies import copies
from ...space.steps import Steps
from ..dynamics import bounce_shift
from ..straight_runs import Runs


Method: TypeAlias = Literal["exact", "layered"]


@dataclasses.dataclass(frozen=True, eq=False)
class Roadmap(Shown):
    """The roadmap of a robot that chooses an angle at each bump (Alam 2018, section 3.4.1).

    The cells where a robot bumps are the *walls*, numbered by direction, then position. Every cell
    is on the *line* of one wall: a robot in the cell runs to that wall, and no two cells of a line
    are equally far from it. So a wall and a length identify a cell, and a run follows the line.

    The cells that a robot can turn into at a bump are the *entries*. After a bump, a robot reaches
    a cell that is not an entry only through the last entry before it on its line. So a plan to the
    cell is a plan to that entry and a run along the line, and the routes from each wall to each
    entry determine the routes between all pairs of cells.

    A corridor of three squares; the robot bumps in cell 2 looking East and in cell 3 looking West:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> roadmap = bounce.Roadmap.of(cells, [math.pi])
        >>> roadmap.wall_cell.tolist(), roadmap.entry.tolist()
        ([2, 3], [0, 5])
    """

    wall: Int[np.ndarray, "cells"]
    "The wall to which a robot runs from each cell."
    length: Int[np.ndarray, "cells"]
    "Number of steps from each cell to its wall."
    turned: Int[np.ndarray, "angles walls"]
    "The cell of the robot after a bump at each wall with each bouncing angle."
    bounces: Float[np.ndarray, "angles"]
    "The angles to choose from at a bump, in radians."
    keep: int | float
    "Cost of a step, and of a bump with the same angle as the previous bump."
    change: int | float
    "Cost of a bump with an angle other than that of the previous bump."
    method: Method
    space: Mapping[str, Any]
    "A description of the cells and of the motion, which is stored in files."

    @classmethod
    def of(
        cls,
        cells: CellSpace,
        bounces: Float[np.ndarray, "angles"] | Array | Sequence[float],
        keep: int | float = 1,
        change: int | float = 100,
        *,
        motion: Motion = CELL_BY_CELL,
        method: Method = "exact",
    ) -> "Roadmap":
        """Build the roadmap of a cell space, with the arguments of [`jaxcell.bounce.plan`][]."""
        angles = np.asarray(bounces, float)
        shift = different_shifts(angles, cells.directions)
        keep, change = _weights(keep, change)
        if method not in ("exact", "layered"):
            raise ValueError(f"method: expected 'exact' or 'layered', got {method!r}")
        estimates.check_cells(cells, motion, estimates.plans, "a roadmap")
        steps = Steps.of(cells, motion)
        runs = Runs.of(steps)
        first, direction, at = runs.of_directions(np.ones(cells.directions, bool))
        position = cells.position_of_square.ravel()[runs.square[at]]
        turned = (direction + shift[:, None]) % cells.directions * cells.positions + position
        wall, length = runs.of_cells(cells)
        roadmap = cls(
            wall=(first[:, None] + wall[steps.way]).ravel(),
            length=length[steps.way].ravel(),
            turned=turned.astype(np.int32),
            bounces=angles,
            keep=keep,
            change=change,
            method=method,
            space={
                **describe_space(cells),
                "step_m": cells.cell if motion.step is None else motion.step,
                "collision": motion.collision,
            },
        )
        _check_precision(roadmap)
        return roadmap

    @property
    def size(self) -> int:
        """Number of cells."""
        return self.wall.size

    @property
    def walls(self) -> int:
        """Number of walls."""
        return self.turned.shape[1]

    @functools.cached_property
    def order(self) -> Int[np.ndarray, "cells"]:
        """All cells, line by line. The cells of a line are listed from its far end to its wall."""
        return np.lexsort((-self.length, self.wall)).astype(np.int32)

    @functools.cached_property
    def place(self) -> Int[np.ndarray, "cells"]:
        """The index of each cell in `order`."""
        place = np.empty_like(self.order)
        place[self.order] = np.arange(self.size, dtype=np.int32)
        return place

    @functools.cached_property
    def entry(self) -> Int[np.ndarray, "entries"]:
        """The cells that a robot can turn into at a bump."""
        return np.unique(self.turned)

    @functools.cached_property
    def entry_of(self) -> Int[np.ndarray, "cells"]:
        """For each cell, the index of the last entry at or before it on its line; -1 for none."""
        number = np.full(self.size, -1, np.int32)
        number[self.entry] = np.arange(self.entry.size, dtype=np.int32)
        listed = number[self.order]
        last = np.maximum.accumulate(np.where(listed >= 0, np.arange(self.size), 0))
        nearest = listed[last]
        same_line = self.wall[self.entry[nearest]] == self.wall[self.order]
        return np.where(same_line, nearest, -1)[self.place].astype(np.int32)

    @functools.cached_property
    def wall_cell(self) -> Int[np.ndarray, "walls"]:
        """The cell where a robot bumps, for each wall."""
        return np.flatnonzero(self.length == 0).astype(np.int32)

    @property
    def number(self) -> np.dtype:
        """The NumPy type of costs, an integer type if `keep` and `change` are whole."""
        if isinstance(self.keep, float) or isinstance(self.change, float):
            return np.dtype(np.float64)
        return np.dtype(np.int32 if _largest_cost(self) < 2**30 else np.int64)

    @property
    def small(self) -> np.dtype:
        """The smallest NumPy type for indices of angles, to save memory."""
        return np.dtype(np.int8 if len(self.bounces) <= 127 else np.int16)

    def after(self, cell: Int[np.ndarray, "..."] | int, turn: int) -> Int[np.ndarray, "..."]:
        """Move robots by a step; at walls, turn them by the angle of index `turn` (-1: no turn)."""
        turned = cell if turn < 0 else self.turned[turn, self.wall[cell]]
        ahead = self.order[np.minimum(self.place[cell] + 1, self.size - 1)]
        return np.where(self.length[cell] > 0, ahead, turned)

    def runs_through(
        self, cell: Int[np.ndarray, "..."] | int, goal: Int[np.ndarray, "..."] | int
    ) -> Bool[np.ndarray, "..."]:
        """Test whether the run from a cell to its wall meets the goal."""
        same = self.wall[cell] == self.wall[goal]
        return np.asarray(same & (self.length[cell] >= self.length[goal]))

    def straight(
        self, goals: Int[np.ndarray, "goals"]
    ) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
        """List all pairs of a cell and a goal that its run meets: cells, and indices in `goals`."""
        first = np.searchsorted(self.wall[self.order], self.wall[goals])
        column, number = copies(self.place[goals] - first + 1)
        return self.order[first[column] + number], column

    def line(self, cell: int, goal: int) -> Int[np.ndarray, "steps"]:
        """List the cells on the run from `cell` to `goal`, which includes `goal` but not `cell`."""
        return self.order[self.place[cell] + 1 : self.place[goal] + 1]


def describe_space(cells: CellSpace) -> dict[str, Any]:
    """List the properties of a cell space that are stored in files of plans."""
    return {
        "directions": cells.directions,
        "positions": cells.positions,
        "cell_m": cells.cell,
        "origin_m": list(cells.origin),
    }


def different_shifts(
    bounces: Float[np.ndarray, "..."], directions: int
) -> Int[np.ndarray, "angles"]:
    """Convert angles to numbers of directions. Raises `ValueError` for equal angles, and for 0."""
    if bounces.ndim != 1 or not bounces.size:
        raise ValueError(f"bounces: expected a list of at least one angle, got {bounces.tolist()}")
    shifts = bounce_shift(bounces, directions, "bounces")
    seen: dict[int, float] = {}
    for bounce, shift in zip(np.rad2deg(bounces).tolist(), shifts.tolist(), strict=True):
        if shift == 0:
            raise ValueError(f"bounces: {bounce:g} deg leaves the robot at its wall for good")
        if shift in seen:
            raise ValueError(
                f"bounces: {seen[shift]:g} and {bounce:g} deg are the same turn; give it once"
            )
        seen[shift] = bounce
    return shifts


def _weights(keep: int | float, change: int | float) -> tuple[int | float, int | float]:
    for name, weight in (("keep", keep), ("change", change)):
        if not (math.isfinite(weight) and weight > 0):
            raise ValueError(f"{name}: expected a finite cost above 0, got {weight}")
    if change < keep:
        raise ValueError(
            f"change: expected at least what keeping the angle costs, {keep}, got {change}"
        )
    whole = isinstance(keep, int | np.integer) and isinstance(change, int | np.integer)
    return (int(keep), int(change)) if whole else (float(keep), float(change))


def _largest_cost(roadmap: Roadmap) -> int | float:
    """Bound the cost of a cheapest plan, which turns by each angle at most once at each wall."""
    longest = int(roadmap.length.max()) + 1
    bumps = roadmap.turned.size + 1
    return bumps * (roadmap.change + roadmap.keep * longest) + roadmap.keep * longest


def _check_precision(roadmap: Roadmap) -> None:
    """Raise `ValueError` if rounding the cost of a plan could lose the cost of a step."""
    largest = _largest_cost(roadmap)
    exact = largest < 2**62 if roadmap.number.kind == "i" else largest * 2.0**-52 < roadmap.keep
    if not exact:
        raise ValueError(
            f"change: {roadmap.change:g} is too much beside keep {roadmap.keep:g}: plans may cost "
            f"{float(largest):g}, which 64 bits cannot distinguish from one step more"
        )
