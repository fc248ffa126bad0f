import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from ... import bounce as bouncing, space, verify as verification
from ..map_study import MapStudy, cell_at
from ..parameters import Angles
from ..study import Say, radians, renamed, silent


@dataclasses.dataclass(frozen=True, kw_only=True)
class Team(MapStudy):
    """Find a joint trajectory of several bouncing robots that covers a map."""

    name: ClassVar[str] = "team"
    command: ClassVar[str] = "team"
    example: ClassVar[str] = "@complex --robots 4 --bounce 135"

    bounce: Angles
    """Bouncing angles in degrees, counter-clockwise: one for all robots, or one per robot."""
    robots: int | None = None
    """Number of robots that start at random cells; by default 2."""
    start: tuple[str, ...] = ()
    """Start of each robot, by default random: "x,y,heading" in m and degrees, or a cell number."""
    seed: int = 0
    """Seed of the random starts."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start and self.robots not in (None, len(self.start)):
            raise ValueError(
                f"robots {self.robots}: `start` names {len(self.start)}; give one of the two"
            )

    def needed(self, extent: "space.Extent") -> float | int:
        return space.estimates.team(extent, self.motion)

    def run(self, say: Say = silent) -> "bouncing.TeamTrajectory":
        cells = self.cells()
        starts = self._starts(cells)
        plural = "robot" if len(starts) == 1 else "robots"
        doing = f"covering {cells.positions:,} positions with {len(starts)} {plural}"
        say(doing)
        with renamed(bounces="bounce", starts="start"):
            return bouncing.team_trajectory(
                cells,
                starts,
                radians(self.bounce),
                motion=self.motion,
                progress=lambda parts, covered: say(f"{doing}: {covered:,} in {parts:,} parts"),
            )

    def spec(self, result: Any) -> dict[str, Any]:
        starts = result.starts.tolist()
        return {**super().spec(result), "robots": len(starts), "start": starts}

    def write(self, result: Any, out: Path) -> None:
        from ...robot.team import member_actions, save_team

        spec = self.spec(result)
        steps = space.free_steps(result.cells, self.motion)
        x, y, theta = (each.tolist() for each in result.cells.centre(result.starts))
        bounces = self.bounce * (1 if len(self.bounce) > 1 else len(x))
        save_team(
            out / "team.json",
            spec,
            list(zip(x, y, theta, strict=True)),
            [math.radians(bounce) for bounce in bounces],
            member_actions(result.cell, result.bumped, steps),
        )

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        import numpy as np

        cells, visited = result.cells, np.unique(result.cell)
        straight = bouncing.bounce_map(cells, 0.0, motion=self.motion)
        compare = verification.compare_images
        return [compare(cells, straight, 0.0, only=visited, motion=self.motion)]

    def _starts(self, cells: "space.CellSpace") -> list[int]:
        if self.start:
            return [cell_at(cells, start, "start") for start in self.start]
        robots = 2 if self.robots is None else self.robots
        if not 1 <= robots <= cells.positions:
            raise ValueError(
                f"robots {robots}: expected from 1 to {cells.positions}, one for each position"
            )
        import numpy as np

        random = np.random.default_rng(self.seed)
        positions = random.choice(cells.positions, robots, replace=False)
        directions = random.integers(cells.directions, size=robots)
        return [int(z) for z in directions * cells.positions + positions]
