import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from ... import automata, bounce as bouncing, record, space, verify as verification
from ..errors import ErrorTexts, read_errors
from ..map_study import MapStudy, RobotStudy, cell_at
from ..parameters import Angles, Count, Limit, Only, Pose
from ..study import Say, radians, renamed, silent


_SEVERAL = Only(bounce=Count.SEVERAL)


@dataclasses.dataclass(frozen=True, kw_only=True)
class LocalizeStudy(RobotStudy):
    """Base class of studies that localize a simulated robot."""

    bounce: Angles
    """Bouncing angles in degrees, counter-clockwise. A robot with several chooses one per bump."""
    start: Pose | None = None
    """Start of the simulated robot: "x,y,heading" in m and degrees, or a cell number; by default a
    random cell."""
    seed: int = 0
    """Seed of the random start, and of errors."""

    def start_cell(self, cells: "space.CellSpace") -> int:
        """Return the cell where the robot starts."""
        import numpy as np

        if self.start is None:
            return int(np.random.default_rng(self.seed).integers(cells.size))
        return cell_at(cells, self.start, "start")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Localize(LocalizeStudy, MapStudy):
    """Build the localization filter of a map, or the policy of a robot that chooses among bouncing
    angles, and localize a simulated robot.

    `jaxcell localize slip` is for robots that slip, and `localize anywhere` for robots that start
    anywhere, not only at the centres of cells."""

    name: ClassVar[str] = "localization"
    command: ClassVar[str] = "localize"
    example: ClassVar[str] = "@lab_a --bounce 135 --out runs/lab"
    task: ClassVar[str] = "localize"

    know: Annotated[Literal["cell", "position", "class"], _SEVERAL] = "cell"
    """Knowledge that the robot seeks: its cell, its position without its heading, or its class (all
    cells that it cannot tell apart with these angles)."""
    aim: Annotated[Literal["worst", "mean"], _SEVERAL] = "worst"
    """Statistic to minimize: the largest (worst) or the mean number of bumps over all starts."""
    start: Annotated[Pose | None, Only(offsets=False)] = None
    offsets: Annotated[bool, Only(bounce=Count.ONE, collision="swept")] = False
    """Start the robot anywhere in a cell. The walls of the map must run along the edges of cells.
    If it knows its heading, its true cell is always among the possible cells of the filter."""
    open_world: Annotated[bool, Only(bounce=Count.ONE)] = False
    """Add a trap state to the filter, for observations that cannot occur on the map."""
    smallest: Annotated[bool, Only(open_world=False)] = False
    """Find the smallest automaton with the same outputs as the filter or the policy, and prove a
    lower bound on its number of states. The search has a limit of one minute."""

    def needed(self, extent: "space.Extent") -> float | int:
        if self._chooses:
            return space.estimates.choice(extent, self.motion)
        return space.estimates.localization(extent, self.motion)

    @property
    def smaller(self) -> str:
        if self._chooses:
            return ""
        return "`jaxcell groups` writes the groups one direction at a time, or "

    @property
    def _chooses(self) -> bool:
        return len(self.bounce) > 1

    def run(
        self, say: Say = silent
    ) -> "bouncing.Localized | bouncing.OffsetLocalized | bouncing.AdaptivelyLocalized":
        cells = self.cells()
        if self.offsets:
            return self._at_any_offset(cells, say)
        localize = self._choose if self._chooses else self._filter
        return localize(cells, self.start_cell(cells), say)

    def _filter(self, cells: "space.CellSpace", start: int, say: Say) -> "bouncing.Localized":
        bounce = math.radians(self.bounce[0])
        say(f"mapping {cells.size:,} cells")
        mapped = bouncing.bounce_map(cells, bounce, motion=self.motion)
        say(f"building the filter of {cells.size:,} cells")
        filter = bouncing.localization_filter(mapped, open_world=self.open_world)
        run = bouncing.localize(mapped, filter, start)
        small = self._smallest(filter, say)
        return bouncing.Localized(filter, cells, self.motion, bounce, run, smallest=small)

    def _at_any_offset(self, cells: "space.CellSpace", say: Say) -> "bouncing.OffsetLocalized":
        bounce = math.radians(self.bounce[0])
        say("finding the classes of offsets")
        offsets = bouncing.Offsets.of(cells, motion=self.motion)
        mapped = offsets.bounce_map(bounce)
        say(f"building the filter of {mapped.image.size:,} configurations")
        filter = bouncing.localization_filter(mapped, open_world=self.open_world)
        return bouncing.OffsetLocalized(
            filter, cells, offsets, bounce, smallest=self._smallest(filter, say)
        )

    def _choose(
        self, cells: "space.CellSpace", start: int, say: Say
    ) -> "bouncing.AdaptivelyLocalized":
        say(f"choosing angles for {cells.size:,} cells")
        with renamed(bounces="bounce", goal="know"):
            policy = bouncing.localization_policy(
                cells, radians(self.bounce), self.know, aim=self.aim, motion=self.motion
            )
        found = bouncing.AdaptivelyLocalized.of(policy, start)
        return dataclasses.replace(found, smallest=self._smallest(policy.policy, say))

    def _smallest(
        self, source: "automata.Filter | automata.Policy", say: Say
    ) -> "automata.Smallest | None":
        return automata.smallest(source, say=say) if self.smallest else None

    def write(self, result: Any, out: Path) -> None:
        spec = self.spec(result)
        if self._chooses:
            about = spec | result.evidence
            dataclasses.replace(result.policy, metadata=about).save(out / "policy.jxf")
        elif self.offsets:
            result.of_cells(spec | result.evidence).save(out / "filter.jxf")
        else:
            about = spec | result.evidence
            dataclasses.replace(result.filter, metadata=about).save(out / "filter.jxf")
            record.save_dataset(record.dataset(result.groups, spec=spec), out / "groups.nc")

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        if self._chooses:
            return verification.compare_policy(result)
        if self.offsets:
            return verification.compare_filter(result, result.offsets.bounce_map(result.bounce))
        mapped = bouncing.bounce_map(result.cells, result.bounce, motion=self.motion)
        return [
            *verification.compare_groups(result.groups),
            *verification.compare_filter(result, mapped),
        ]


@dataclasses.dataclass(frozen=True, kw_only=True)
class LocalizeSlip(LocalizeStudy):
    """Localize a simulated robot that slips, by a belief.

    A robot with several bouncing angles chooses the one after which the expected entropy of its
    belief at the next bump is least."""

    name: ClassVar[str] = "localization"
    command: ClassVar[str] = "localize slip"
    example: ClassVar[str] = "@lab_a --bounce 45 135 --errors slip=2% --out runs/slip"
    task: ClassVar[str] = "localize slip"

    errors: ErrorTexts
    """Errors, each as NAME=VALUE: slip=2% is the common standard deviation of the relative errors
    of a step and of a turn, and of the drift of the heading in radians per metre. bump_turn=2deg is
    the angle by which a bump at an incidence of 45 degrees turns the robot toward the wall, and
    sin(2 i) times as large at an incidence i. bump_skid=12mm is the distance by which the wheels
    skid at a head-on bump, and cos(i)² times as large. The encoders do not measure the turn, and
    count the skid as travel, so the robot goes too far when it drives back to the start of its
    step."""
    max_fine_cells: Annotated[int | None, Limit(ge=1)] = None
    """Largest number of fine cells, into which a belief divides the cells of the map. The default
    is 100,000 for a slip of 2 % or more, and rises to 400,000 for smaller slips. With more fine
    cells, the credible sets on large maps are smaller, and the computation takes longer."""

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
        from ...bounce.plans.roadmap import different_shifts
        from ...robot.emulation.body import bumper_give

        cells = self.cells()
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
            self.start_cell(cells),
            seed=self.seed,
            step=self.step,
            fine_side=fine.fine.cell,
            fine_directions=fine.fine.directions,
        )

    def write(self, result: Any, out: Path) -> None:
        dataclasses.replace(result.hidden, metadata=self.spec(result)).save(out / "belief.jxb")

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_slip(result)
