import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from ... import bounce as bouncing, space, verify as verification
from ..batches import Numbers, Program, compiled, numbers_of
from ..errors import ErrorTexts, read_errors
from ..map_study import MapStudy, disc_at
from ..parameters import Angles, AtLeastOne, Limit, Pose
from ..study import Say, Wanted, every, radians, renamed, silent


if TYPE_CHECKING:
    import numpy as np

# The numbers that a goal adds.
_OF_GOAL = tuple(
    f"{before}{name}{after}"
    for name in ("goal_share", "goal_time")
    for before, after in (("", ""), ("d_", "_d_reliability"))
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cover(MapStudy):
    """Find how much time an imprecise robot should give to each bouncing angle to cover a map."""

    name: ClassVar[str] = "coverage"
    command: ClassVar[str] = "cover"
    example: ClassVar[str] = "@complex --bounce 30 75 315 --errors turn=5deg --reliability 0.8"
    task: ClassVar[str] = "cover"
    varied: ClassVar[tuple[str, ...]] = ("reliability",)

    bounce: Angles
    """Bouncing angles in degrees, counter-clockwise."""
    errors: ErrorTexts
    """Largest error of a turn, turn=5deg. It must be a multiple of the angle between directions."""
    reliability: Annotated[float, Limit(gt=0, le=1)]
    """Probability of a turn without error."""
    target: str = "uniform"
    """Desired share of time per position: uniform, an image (brightness), or FILE.nc:VARIABLE."""
    weights: Literal["basin", "size"] = "basin"
    """Weight of each persistent group of an angle: the probability of ending in it (basin), or its
    number of cells (size)."""
    goal: Pose | None = None
    """Goal, "x,y" or "x,y,radius" in metres; adds the share of time there, and the mean steps from
    a random start. By default the radius is the side of a cell, or half a metre if cells are
    smaller."""
    directions: AtLeastOne | None = 360
    """Number of directions in which the robot can drive."""

    def __post_init__(self) -> None:
        super().__post_init__()
        Limit(ge=0).check("errors: turn", self.error, " degrees")

    @property
    def error(self) -> float:
        """The largest error of a turn, in degrees."""
        turn = read_errors(self.errors, ("turn",), needed="turn")["turn"]
        return round(math.degrees(turn), 9)

    def check_files(self) -> None:
        super().check_files()
        check_target(self.target)

    def needed(self, extent: "space.Extent") -> float | int:
        # There are at most as many different turns as directions.
        spread = min(self.error * extent.directions / 360, extent.directions)
        branches = 1 + 2 * round(spread)
        angles = len(self.bounce)
        return space.estimates.coverage(extent, self.motion, angles=angles, branches=branches)

    def run(self, say: Say = silent) -> "bouncing.CoveragePolicy":
        cells = self.cells()
        count = len(self.bounce)
        doing = (
            f"covering {cells.positions:,} positions by {count} angles, {cells.size:,} cells each"
        )
        say(doing)
        with renamed(bounces="bounce", error="errors"):
            return bouncing.coverage_policy(
                cells,
                radians(self.bounce),
                reliability=self.reliability,
                progress=lambda done: say(doing, done, count),
                **self._options(cells),
            )

    def _options(self, cells: "space.CellSpace") -> dict[str, Any]:
        """Return the arguments of `coverage_policy` that the members of a batch share."""
        from .target import read_target

        check_target(self.target)
        return {
            "error": math.radians(self.error),
            "target": read_target(cells, self.target),
            "weights": self.weights,
            "motion": self.motion,
            "goal": self._goal(cells),
        }

    def _goal(self, cells: "space.CellSpace") -> "np.ndarray | None":
        """Return a mask of the positions whose centres are in the goal, which has at least one."""
        if self.goal is None:
            return None
        import numpy as np

        centre, radius = disc_at(cells, self.goal, "goal")
        x, y, _ = cells.centre(np.arange(cells.positions))
        there = np.hypot(x - centre[0], y - centre[1]) <= radius
        there[int(cells.index(*centre, 0.0)) % cells.positions] = True
        return there

    def numbers(self, columns: "Mapping[str, np.ndarray]", wanted: Wanted = every) -> Numbers:
        from ...bounce.coverage import check_different

        if not columns:
            return super().numbers(columns, wanted)
        cells = self.cells()
        options = self._options(cells)
        moves = bouncing.moves(cells, motion=options.pop("motion"))
        shared = radians(self.bounce), moves, options.pop("target"), options.pop("goal")

        def program(names: tuple[str, ...]) -> Program:
            made = _program(cells.positions, cells.directions, names, **options)
            return functools.partial(made, *shared)

        def alone(**own: Any) -> "bouncing.CoveragePolicy":
            return dataclasses.replace(self, **own).run()

        asked = (*filter(wanted, _OF_GOAL),) if wanted is not every else ()
        if asked and self.goal is None:
            raise ValueError(f"results: {asked[0]} needs a goal")
        with renamed(bounces="bounce", error="errors"):
            # The angles of a program have no values, which could be wrong.
            check_different(shared[0], cells.directions)
            # A sure turn has fewer possible steps, so that its numbers may jump.
            inner = columns["reliability"] < 1
            return numbers_of(bouncing.CoveragePolicy, program, alone, columns, wanted, inner)

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        error = math.radians(self.error)
        return verification.compare_coverage(
            result, error, self.reliability, weights=self.weights, motion=self.motion
        )


@functools.lru_cache(maxsize=64)
def _program(positions: int, directions: int, names: tuple[str, ...], **options: Any) -> Program:
    """Compile a program for all maps with as many positions."""
    import numpy as np

    from ...bounce.coverage import policy_of_moves

    # The program reads the moves of the map, and of the cells their number.
    cells = space.CellSpace.of_grid(np.ones((1, positions), bool), directions)

    def policy(bounces: Any, moves: Any, target: Any, goal: Any, reliability: Any) -> Any:
        return policy_of_moves(
            cells, moves, bounces, target=target, goal=goal, reliability=reliability, **options
        )

    return compiled(policy, names)


def check_target(text: str) -> None:
    """Raise `ValueError` if the file of a target does not exist."""
    file, _, _ = text.rpartition(":")
    if file.endswith(".nc") and not Path(file).is_file():
        raise ValueError(f"target {text}: there is no file {file}")
    if text != "uniform" and not file.endswith(".nc") and not Path(text).is_file():
        raise ValueError(
            f"target {text}: there is no such file; expected 'uniform', an image, or "
            "FILE.nc:VARIABLE"
        )
