"""Studies of robots whose steps and turns have errors that their wheel encoders do not measure."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

from ... import bounce as bouncing, space, verify as verification
from ...base.quantities import Result
from ..errors import ErrorTexts, read_errors
from ..map_study import RobotStudy, cell_at
from ..parameters import Degrees, Limit
from ..study import Say, radians, renamed, silent
from .navigate import WayStudy


@dataclasses.dataclass(frozen=True, kw_only=True)
class LocalizeSlip(RobotStudy):
    """Localize a simulated robot that slips, by a belief.

    A robot with several bouncing angles chooses the one after which the expected entropy of its
    belief at the next bump is least."""

    name: ClassVar[str] = "localization"
    command: ClassVar[str] = "localize slip"
    example: ClassVar[str] = "@lab_a --bounce 45 135 --errors slip=2% --out runs/slip"
    task: ClassVar[str] = "localize slip"

    bounce: tuple[Degrees, ...]
    """Bouncing angles in degrees, counter-clockwise; the robot chooses among several."""
    errors: ErrorTexts
    """Errors, each as NAME=VALUE: slip=2% is the common standard deviation of the relative errors
    of a step and of a turn, and of the drift of the heading in radians per metre. bump_turn=2deg is
    the angle by which a bump at an incidence of 45 degrees turns the robot toward the wall, and
    sin(2 i) times as large at an incidence i. bump_skid=12mm is the distance by which the wheels
    skid at a head-on bump, and cos(i)² times as large. The encoders do not measure the turn, and
    count the skid as travel, so the robot goes too far when it drives back to the start of its
    step."""
    start: str | None = None
    """Start of the simulated robot: "x,y,heading" in m and degrees, or a cell number; by default a
    random cell."""
    max_fine_cells: Annotated[int | None, Limit(ge=1)] = None
    """Largest number of fine cells, into which a belief divides the cells of the map. The default
    is 100,000 for a slip of 2 % or more, and rises to 400,000 for smaller slips. With more fine
    cells, the credible sets on large maps are smaller, and the computation takes longer."""
    seed: int = 0
    """Seed of the random start and of the errors."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._errors()

    def _errors(self) -> dict[str, float]:
        return read_errors(self.errors, ("slip", "bump_turn", "bump_skid"), needed="slip")

    def needed(self, extent: "space.Extent") -> float | int:
        from ...bounce.slip.fine_cells import most_cells, needed

        cells = self.max_fine_cells or most_cells(self._errors()["slip"])
        return needed(cells, angles=len(self.bounce))

    def run(self, say: Say = silent) -> "bouncing.Slipped":
        import numpy as np

        from ...bounce.plans.roadmap import different_shifts
        from ...robot.emulation.body import bumper_give

        cells = self.cells()
        if self.start is None:
            start = int(np.random.default_rng(self.seed).integers(cells.size))
        else:
            start = cell_at(cells, self.start, "start")
        bounces = radians(self.bounce)
        if len(self.bounce) > 1:
            with renamed(bounces="bounce"):
                different_shifts(bounces, cells.directions)
        with renamed(slip="errors"):
            slip = space.Slip.of(**self._errors(), give=bumper_give(cells.cell))
        fine = bouncing.FineCells.within(cells, slip, self.max_fine_cells)
        say(f"mapping {fine.size:,} fine cells")
        hidden = bouncing.slip_map(fine, bounces.tolist(), slip, step=self.step)
        say("driving the robot")
        return bouncing.slipping_run(
            hidden,
            cells,
            bounces,
            slip,
            start,
            seed=self.seed,
            step=self.step,
            fine_side=fine.fine.cell,
            fine_directions=fine.fine.directions,
        )

    def write(self, result: Any, out: Path) -> None:
        dataclasses.replace(result.hidden, metadata=self.spec(result)).save(out / "belief.jxb")

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_slip(result)


@dataclasses.dataclass(frozen=True, kw_only=True)
class NavigateSlip(WayStudy):
    """Find the probability that the plan of a robot that slips succeeds, and a policy that surely
    reaches the goal, if there is one."""

    name: ClassVar[str] = "navigation"
    command: ClassVar[str] = "navigate slip"
    example: ClassVar[str] = "@lab_a --bounce 45 135 --start 0 --goal 60 --errors slip=2%"
    task: ClassVar[str] = "navigate slip"

    errors: ErrorTexts
    """Error slip=2%: the common standard deviation of the relative errors of a step and of a turn,
    and of the drift of the heading in radians per metre."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._slip()

    def _slip(self) -> float:
        return read_errors(self.errors, ("slip",), needed="slip")["slip"]

    def needed(self, extent: "space.Extent") -> float | int:
        from ...bounce.slip.fine_cells import most_cells, needed

        fine = needed(most_cells(self._slip()), angles=len(self.bounce))
        return super().needed(extent) + fine

    def run(self, say: Say = silent) -> Result:
        from .slipped_plan import slipped_plan

        return slipped_plan(self.plan(say), self._slip(), self.bounce, self.step, say)
