import dataclasses
from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.quantities import Checks, Result, derived, from_part, quantity
from ..space import CellSpace
from ..walls import Homing, Trial, WallFilter, alike_places
from .dynamics import Bounces


@dataclasses.dataclass(frozen=True, eq=False)
class Anywhere(Result):
    """The localization of simulated robots that start at any point of a map."""

    title: ClassVar[str] = "Localization of robots that start anywhere"
    picture: ClassVar[str] = "median_extent"
    tables: ClassVar[Mapping[str, str]] = {"bump": "bumps"}

    cells: CellSpace
    filter: WallFilter
    headings: int | None
    "Number of headings at which a robot may start, or `None` for any heading."
    bounces: Bounces
    radius: Annotated[float, quantity("", "distance within which a robot counts as localized", "m")]
    trial: Trial

    @property
    def remarks(self) -> tuple[str, ...]:
        if self.alike == 1:
            return ()
        return (
            f"The room is symmetric: {self.alike} places in it look alike to a robot, so that each "
            "set keeps as many pieces whatever the angles are.",
        )

    @derived("bounce", "bouncing angle", "degree", listed=True)
    def bounces_deg(self) -> Float[np.ndarray, "angles"]:
        return np.rad2deg(self.bounces).round(9)

    @derived("", "robots", "1", kind="count")
    def robots(self) -> int:
        return len(self.trial.run)

    @derived("", "robots that the filter loses", kind="share")
    def lost_share(self) -> float:
        return float((~self.trial.held).any(axis=1).mean())

    @derived("", "robots that are localized at the end", kind="share")
    def known_share(self) -> float:
        return float((self.trial.extent[:, -1] <= 2 * self.radius).mean())

    @derived("", "bumps until a robot is localized, in the median", kind="time")
    def median_bumps(self) -> float:
        return float(np.median(self.bumps_until_known))

    @derived("", "places that look alike to a robot", "1", kind="count")
    def alike(self) -> int:
        return alike_places(self.cells.workspace, self.headings) if self.cells.workspace else 1

    @derived("bump", "bumps", kind="coordinate")
    def bump(self) -> Int[np.ndarray, "bumps"]:
        return np.arange(1, self.trial.run.shape[1] + 1, dtype=np.int32)

    @derived("bump", "extent of the places that are possible, in the median", "m")
    def median_extent(self) -> Float[np.ndarray, "bumps"]:
        return np.median(self.extent, axis=0)

    @derived("bump", "extent that nine of ten robots do not exceed", "m")
    def extent_of_nine_tenths(self) -> Float[np.ndarray, "bumps"]:
        return np.quantile(self.extent, 0.9, axis=0)

    @derived("robot bump", "extent of the places that are possible", "m")
    def extent(self) -> Float[np.ndarray, "robots bumps"]:
        # Bounds are moved outward by nanometres.
        return self.trial.extent.round(6)

    held = from_part(
        "trial.held", "robot bump", "whether the robot is where its filter says", kind="flag"
    )

    @derived("robot", "bumps until the robot stays localized", kind="time")
    def bumps_until_known(self) -> Float[np.ndarray, "robots"]:
        return _holds_since(self.trial.extent <= 2 * self.radius)

    @derived("robot bump", "x of the bump", "m")
    def x(self) -> Float[np.ndarray, "robots bumps"]:
        return self.trial.place[:, :, 0]

    @derived("robot bump", "y of the bump", "m")
    def y(self) -> Float[np.ndarray, "robots bumps"]:
        return self.trial.place[:, :, 1]

    @derived("robot bump", "heading before the bump", "rad", sense="counter-clockwise")
    def theta(self) -> Float[np.ndarray, "robots bumps"]:
        return self.trial.heading % (2 * np.pi)

    run = from_part("trial.run", "robot bump", "length of the run before the bump", "m")

    @derived("stretch", "bump after which the first robot may be on the stretch", kind="index")
    def stretch_bump(self) -> Int[np.ndarray, "stretches"]:
        return np.repeat(self.bump, [state.wall.size for state in self.trial.sets])

    @derived("stretch end", "x of the ends of the stretch of a wall", "m")
    def stretch_x(self) -> Float[np.ndarray, "stretches 2"]:
        return self._ends[:, :, 0]

    @derived("stretch end", "y of the ends of the stretch of a wall", "m")
    def stretch_y(self) -> Float[np.ndarray, "stretches 2"]:
        return self._ends[:, :, 1]

    @property
    def _ends(self) -> Float[np.ndarray, "stretches 2 2"]:
        boundary = self.filter.boundary
        ends = [
            np.stack([boundary.point(state.wall, arc) for arc in (state.begin, state.end)], axis=1)
            for state in self.trial.sets
        ]
        return np.concatenate(ends)

    def checks(self) -> Checks:
        return {"robots_that_are_lost": (int((~self.trial.held).any(axis=1).sum()), 0)}


@dataclasses.dataclass(frozen=True, eq=False)
class HomeFromAnywhere(Anywhere):
    """Simulated robots that start at any point of a map, are localized, and then go to a goal."""

    title: ClassVar[str] = "Navigation of robots that start anywhere"

    homing: Homing
    planned_bumps: Annotated[
        float | None,
        quantity("", "bumps of a plan that knows its start, in the median", kind="time"),
    ]
    planned_metres: Annotated[
        float | None, quantity("", "length of a plan that knows its start, in the median", "m")
    ]

    @property
    def answered(self) -> bool:
        return bool(np.isfinite(self.bumps_until_home).any())

    @derived("", "robots that come to the goal and know it", kind="share")
    def arrived_share(self) -> float:
        return float(np.isfinite(self.bumps_until_home).mean())

    @derived("", "bumps until a robot is home, in the median", kind="time")
    def median_bumps_until_home(self) -> float:
        return float(np.median(self.bumps_until_home))

    @derived("", "length of the way home of robots that arrive, in the median", "m")
    def median_metres(self) -> float:
        ways = np.cumsum(self.trial.run, axis=1)[self.trial.arrived.cumsum(axis=1) == 1]
        return float(np.median(ways)) if ways.size else np.inf

    @derived("robot", "bumps until the robot is home", kind="time")
    def bumps_until_home(self) -> Float[np.ndarray, "robots"]:
        arrived = self.trial.arrived
        return np.where(arrived.any(axis=1), arrived.argmax(axis=1) + 1.0, np.inf)


def _holds_since(holds: Bool[np.ndarray, "robots bumps"]) -> Float[np.ndarray, "robots"]:
    """Find the first bump, counted from 1, from which `holds` is always true; `inf` if none."""
    fails = ~holds[:, ::-1]
    since = holds.shape[1] - fails.argmax(axis=1) + 1.0
    return np.where(fails.any(axis=1), np.where(fails[:, 0], np.inf, since), 1.0)
