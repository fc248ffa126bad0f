import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..base.limits import Collision
from ..base.shown import Shown
from ..base.wide import traced
from .cells import TOLERANCE, CellSpace
from .occupancy import in_squares
from .segments import crossed_squares, meets_wall


@dataclasses.dataclass(frozen=True)
class Rule:
    """A collision rule: the part of a step that has to stay in the closed free space.

    To add a rule, add an entry to `RULES`, and its name to `Collision`.
    """

    squares: Callable[[float, float, tuple[int, int]], tuple[tuple, tuple]]
    "A function that returns the squares that have to be free, such as [`crossed_squares`][]."
    blocked: Callable[..., tuple[Int[np.ndarray, "near"], Bool[np.ndarray, "near directions"]]]
    "A function that returns the centres near walls and their blocked steps, such as `_endpoint`."
    part: Callable[[Float[np.ndarray, "paths points 2"]], Any]
    "A function that returns the part of each path that has to be free, as shapely geometries."


def _endpoint(
    cells: CellSpace,
    centres: Float[np.ndarray, "positions 2"],
    steps: Float[np.ndarray, "directions 2"],
    near: Int[np.ndarray, "pairs"],
    wall: Int[np.ndarray, "pairs"],
) -> tuple[Int[np.ndarray, "near"], Bool[np.ndarray, "near directions"]]:
    """Find the steps that end in an obstacle; `near` and the results are as in [`meets_wall`][]."""
    near = np.unique(near)
    closed = shapely.transform(
        cells.room.free_space, lambda points: in_squares(points, cells.origin, cells.cell)
    ).buffer(TOLERANCE, join_style="mitre")
    shapely.prepare(closed)
    ends = centres[near][:, None] + steps
    return near, ~shapely.contains_xy(closed, ends[..., 0], ends[..., 1])


RULES: dict[Collision, Rule] = {
    "swept": Rule(
        crossed_squares,
        lambda cells, *near_walls: meets_wall(cells.walls, *near_walls),
        shapely.linestrings,
    ),
    "endpoint": Rule(
        lambda dx, dy, offset: ((offset,), ()),
        _endpoint,
        lambda paths: shapely.points(paths[:, -1]),
    ),
}


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
