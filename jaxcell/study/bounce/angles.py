import dataclasses
import math
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro

from ... import bounce as bouncing, walls
from ..parameters import AtLeastOne, Degrees, Duration, Limit, Needed, Pose
from ..study import Say, radians, silent
from .anywhere import LOCALIZED, AnywhereStudy, goal_at


# Sets of slices of headings are about as many times larger as the slices are wider. The search uses
# wide slices, and counts robots as localized within a distance that is as many times longer.
_WIDER = (3, 2, 1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChooseAngles(AnywhereStudy):
    """Propose bouncing angles for a robot that starts anywhere, by a search, and simulate robots
    that use them.

    The search grows sets of angles by one angle at a time, so better sets may exist."""

    name: ClassVar[str] = "angles"
    command: ClassVar[str] = "angles"
    example: ClassVar[str] = "@lab_b --for localize --count 2 --resolution 45 --robots 20"
    task: ClassVar[str] = "angles"

    for_: Annotated[Literal["localize", "navigate"], tyro.conf.arg(name="for")]
    """Task of the robot: to find out where it is (localize), or to come to a goal (navigate)."""
    goal: Annotated[Pose | None, Needed(for_="navigate")] = None
    """Goal, "x,y" or "x,y,radius" in metres. By default the radius is the side of a cell, or half a
    metre if cells are smaller; where no wall is so near, at which a robot can stop, it is the
    distance to the nearest wall and a quarter of a metre."""
    count: Annotated[int, Limit(ge=1, le=4)] = 3
    """Largest number of angles."""
    resolution: Annotated[Degrees, Limit(gt=0, le=180)] = 15.0
    """Angles to choose from: the multiples of this angle in degrees."""
    robots: AtLeastOne = 100
    """Number of simulated robots with each proposed set of angles."""
    seconds: Duration | None = None
    """Time limit in seconds of the search, without the simulations that follow it; by default there
    is no limit. The answer says whether the search reached its end."""

    def run(self, say: Say = silent) -> "bouncing.ProposedAngles":
        cells = self.cells()
        assert cells.workspace is not None
        goal = None if self.goal is None else goal_at(cells, self.goal)
        radius = self.radius or (LOCALIZED if goal is None else goal[1])
        number = math.ceil(360 / self.resolution - 1e-9)
        angles = radians([self.resolution * (k + 1) for k in range(number - 1)]).tolist()
        say("finding the chords of the room")
        filter = self.filter(cells, angles)
        wider = self._wider if filter.chords.width else 1
        coarse = dataclasses.replace(self, slices=self.slices // wider).filter(cells, angles)
        best, tried, finished = walls.propose_angles(
            cells.workspace,
            coarse,
            angles,
            most=self.count,
            radius=wider * radius,
            goal=goal,
            headings=self._known_headings(cells),
            seed=self.seed,
            seconds=math.inf if self.seconds is None else self.seconds,
            say=say,
        )
        trials = {}
        for one in best:
            degrees = [round(math.degrees(angle), 9) for angle in one]
            trials[len(one)] = self.simulate(say, degrees, goal, filter)
        return bouncing.ProposedAngles(cells, trials, tried, finished)

    @property
    def _wider(self) -> int:
        """The number of slices of the filter in one slice of the search."""

        def fits(wider: int) -> bool:
            slices = self.slices / wider
            turns = self.resolution * slices / 360
            directions = self.directions or 8
            return (
                slices % 2 == 0
                and slices >= 4
                and abs(turns - round(turns)) < 1e-9
                and (self.heading == "unknown" or slices % directions == 0)
            )

        return next(filter(fits, _WIDER), 1)

    def write(self, result: Any, out: Path) -> None:
        super().write(result.best, out)
