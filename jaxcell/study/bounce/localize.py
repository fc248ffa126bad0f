import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from ... import automata, bounce as bouncing, record, space, verify as verification
from ...base.quantities import Result
from ..map_study import cell_at
from ..parameters import Degrees, Limit, Metres, Only, Share
from ..study import Say, radians, silent
from .anywhere import AnywhereStudy


_CHOICE = Only(bounces=True, anywhere=False, slip=False)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Localize(AnywhereStudy):
    """Build the localization filter of a map, or the policy of a robot that chooses among bouncing
    angles, and localize a simulated robot."""

    name: ClassVar[str] = "localization"
    command: ClassVar[str] = "localize"
    example: ClassVar[str] = "@lab_a --bounce 135 --out runs/lab"
    task: ClassVar[str] = "localize"
    one_of: ClassVar[tuple[str, ...]] = ("bounce", "bounces")

    bounce: Annotated[Degrees | None, Only(bounces=False)] = None
    """Bouncing angle in degrees, counter-clockwise."""
    bounces: Annotated[tuple[Degrees, ...], Only(bounce=False)] = ()
    """Bouncing angles among which the robot chooses at each bump. A robot that slips chooses the
    angle after which the expected entropy of its belief at the next bump is least."""
    goal: Annotated[Literal["cell", "position", "class"], _CHOICE] = "cell"
    """Knowledge that the robot seeks: its cell, its position without its heading, or its class (all
    cells that it cannot tell apart with these angles)."""
    aim: Annotated[Literal["worst", "mean"], Only(bounces=True, slip=False)] = "worst"
    """Statistic to minimize: the largest (worst) or the mean number of bumps over all starts. With
    --anywhere it is the largest or the mean size of the set of possible positions."""
    ahead: Annotated[int, Limit(ge=1, le=3), Only(bounces=True, anywhere=True)] = 1
    """Number of bumps to look ahead in the choice among angles."""
    start: Annotated[str | None, Only(offsets=False)] = None
    """Start of the simulated robot: "x,y,heading" in m and degrees, or a cell number; by default a
    random cell."""
    offsets: Annotated[bool, Only(collision="swept", anywhere=False, bounces=False, slip=False)] = (
        False
    )
    """Start the robot anywhere in a cell. The walls of the map must run along the edges of cells.
    If it knows its heading, its true cell is always among the possible cells of the filter."""
    open_world: Annotated[bool, Only(anywhere=False, bounces=False, slip=False)] = False
    """Add a trap state to the filter, for observations that cannot occur on the map."""
    smallest: Annotated[bool, Only(anywhere=False, open_world=False, slip=False)] = False
    """Find the smallest automaton with the same outputs as the filter or the policy, and prove a
    lower bound on its number of states. The search has a limit of one minute."""
    slip: Annotated[Share | None, Only(collision="swept", anywhere=False)] = None
    """Common standard deviation of three errors: the relative errors of a step and of a turn, and
    the drift of the heading in radians per metre. A belief then replaces the filter."""
    bump_turn: Annotated[Degrees, Only(slip=True)] = 0.0
    """Angle in degrees by which a bump at an incidence of 45 degrees turns the robot toward the
    wall. The wheel encoders do not measure it. At an incidence i the angle is sin(2 i) times as
    large."""
    bump_skid: Annotated[Metres, Limit(ge=0), Only(slip=True)] = 0.0
    """Distance in metres by which the wheels skid at a head-on bump. The encoders count it as
    travel, so the robot goes too far when it drives back to the start of its step. At an incidence
    i the distance is cos(i)² times as large."""
    max_fine_cells: Annotated[int | None, Limit(ge=1), Only(slip=True)] = None
    """Largest number of fine cells, into which a belief divides the cells of the map. The default
    is 100,000 for a slip of 2 % or more, and rises to 400,000 for smaller slips. With more fine
    cells, the credible sets on large maps are smaller, and the computation takes longer."""

    @property
    def choice(self) -> dict[str, Any]:
        return {"aim": self.aim, "ahead": self.ahead}

    def needed(self, extent: "space.Extent") -> float | int:
        if self.anywhere:
            return 0
        if self.slip is not None:
            from ...bounce.slip.fine_cells import most_cells, needed

            cells = self.max_fine_cells or most_cells(self.slip)
            return needed(cells, angles=max(1, len(self.bounces)))
        if self.bounces:
            return space.estimates.choice(extent, self.motion)
        return space.estimates.localization(extent, self.motion)

    @property
    def smaller(self) -> str:
        if self.bounces or self.slip is not None:
            return ""
        return "`jaxcell groups` writes the groups one direction at a time, or "

    def run(self, say: Say = silent) -> Result:
        import numpy as np

        if self.anywhere:
            bounces = self.bounces if self.bounce is None else (self.bounce,)
            return self.run_anywhere(bounces, self.start, say)
        cells = self.cells()
        if self.offsets:
            return self._at_any_offset(cells, say)
        if self.start is None:
            start = int(np.random.default_rng(self.seed).integers(cells.size))
        else:
            start = cell_at(cells, self.start, "start")
        if self.slip is not None:
            return self._slipped(cells, start, say)
        if self.bounces:
            return self._choose(cells, start, say)
        assert self.bounce is not None
        return self._filter(cells, math.radians(self.bounce), start, say)

    def _filter(
        self, cells: "space.CellSpace", bounce: float, start: int, say: Say
    ) -> "bouncing.Localized":
        say(f"mapping {cells.size:,} cells")
        mapped = bouncing.bounce_map(cells, bounce, motion=self.motion)
        say(f"building the filter of {cells.size:,} cells")
        filter = bouncing.localization_filter(mapped, open_world=self.open_world)
        run = bouncing.localize(mapped, filter, start)
        small = self._smallest(filter, say)
        return bouncing.Localized(filter, cells, self.motion, bounce, run, smallest=small)

    def _at_any_offset(self, cells: "space.CellSpace", say: Say) -> "bouncing.OffsetLocalized":
        assert self.bounce is not None
        bounce = math.radians(self.bounce)
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
        policy = bouncing.localization_policy(
            cells, radians(self.bounces), self.goal, aim=self.aim, motion=self.motion
        )
        found = bouncing.AdaptivelyLocalized.of(policy, start)
        return dataclasses.replace(found, smallest=self._smallest(policy.policy, say))

    def _smallest(
        self, source: "automata.Filter | automata.Policy", say: Say
    ) -> "automata.Smallest | None":
        return automata.smallest(source, say=say) if self.smallest else None

    def _slipped(self, cells: "space.CellSpace", start: int, say: Say) -> "bouncing.Slipped":
        from ...bounce.plans.roadmap import different_shifts
        from ...robot.emulation.body import bumper_give

        assert self.slip is not None
        bounces = radians(self.bounces if self.bounce is None else [self.bounce])
        if self.bounces:
            different_shifts(bounces, cells.directions)
        slip = space.Slip.of(
            self.slip,
            give=bumper_give(cells.cell),
            bump_turn=math.radians(self.bump_turn),
            bump_skid=self.bump_skid,
        )
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
        spec = self.spec(result)
        if self.anywhere:
            self.save_task(result, out)
        elif self.slip is not None:
            dataclasses.replace(result.hidden, metadata=spec).save(out / "belief.jxb")
        elif self.bounces:
            about = spec | result.evidence
            dataclasses.replace(result.policy, metadata=about).save(out / "policy.jxf")
        elif self.offsets:
            result.of_cells(spec | result.evidence).save(out / "filter.jxf")
        else:
            about = spec | result.evidence
            dataclasses.replace(result.filter, metadata=about).save(out / "filter.jxf")
            record.save_dataset(record.dataset(result.groups, spec=spec), out / "groups.nc")

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        if self.anywhere:
            return []
        if self.slip is not None:
            return verification.compare_slip(result)
        if self.bounces:
            return verification.compare_policy(result)
        if self.offsets:
            return verification.compare_filter(result, result.offsets.bounce_map(result.bounce))
        mapped = bouncing.bounce_map(result.cells, result.bounce, motion=self.motion)
        return [
            *verification.compare_groups(result.groups),
            *verification.compare_filter(result, mapped),
        ]
