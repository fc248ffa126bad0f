import dataclasses
import functools
from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..base.formatting import counted
from ..base.intervals import clopper_pearson
from ..base.quantities import Checks, Result, derived, from_part, quantity
from ..space import CellSpace
from ..walls import (
    Alike,
    Homing,
    Trial,
    WallFilter,
    alike_places,
    alike_poses,
    bumps_until_localized,
    is_localized,
)
from .dynamics import Bounces


# The number of robots whose poses are compared with all other poses.
_COMPARED = 100


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
    def answered(self) -> bool:
        return self.lost_share == 0

    @property
    def answer(self) -> tuple[str, ...]:
        share, bumps = self.localized_share, self.median_bumps
        when = f", in the median after {counted(bumps, 'bump')}" if np.isfinite(bumps) else ""
        return (
            *self._worst,
            *self._disbelieved,
            f"{100 * share:.3g} % of {self.robots:,} robots know where they are, to "
            f"{self.radius:.3g} m{when}; {100 * self.lost_share:.3g} % are lost. "
            f"{share_of_all(share, self.robots)}",
        )

    @property
    def _worst(self) -> tuple[str, ...]:
        """A sentence with the largest radius of a set after some bumps from a start region."""
        start, worst = self.filter.start, self.largest_extent
        if start is None or worst is None:
            return ()
        bumps = sorted({*self.bump[:5].tolist(), int(self.bump[-1])})
        known = ", ".join(f"{worst[bump - 1] / 2:.2g} m after {bump}" for bump in bumps)
        x, y = start.place
        return (f"From ({x:g} m, {y:g} m), each robot knows its place to within {known} bumps.",)

    @property
    def _disbelieved(self) -> tuple[str, ...]:
        """A sentence with the number of bumps that the sets had to disbelieve."""
        if not self.trial.outliers:
            return ()
        robots, counts = np.bincount(self.disbelieved, minlength=2), []
        for count in range(1, robots.size):
            share = 100 * robots[count] / self.robots
            counts.append(f"{counted(count, 'bump')} for {share:.3g} % of the robots")
        unmapped = counted(self.trial.outliers, "random bump")
        return (
            f"{unmapped} per robot not on the map: sets had to disbelieve {', '.join(counts)}.",
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        lost = int((~self.trial.held).any(axis=1).sum())
        remarks = [f"{lost:,} of {self.robots:,} robots are lost: they left their sets."] * bool(
            lost
        )
        if self.filter.start is not None:
            return tuple(remarks)
        for (area, inside), symmetric in zip(self._pieces, self._symmetric, strict=True):
            among = inside[: self._unresolved.size]
            unresolved = among & self._unresolved
            if not unresolved.any():
                continue
            x, y = shapely.get_coordinates(area.representative_point())[0]
            where = f" that start in the piece of {area.area:.3g} m² at ({x:.3g} m, {y:.3g} m)"
            robots = f"robots{where if len(self._pieces) > 1 else ''}"
            if symmetric > 1:
                remarks.append(
                    f"For {robots}, {symmetric} poses look alike whatever the angles are, because "
                    "of a symmetry."
                )
            elif self._alike is not None:
                pieces = np.bincount(self._alike.poses.robot, minlength=among.size)[unresolved]
                count = int(np.quantile(pieces, 0.5, method="inverted_cdf"))
                percent = 100 * unresolved.sum() / among.sum()
                remarks.append(
                    f"At least {percent:.0f} % of the {robots} are not localized by any "
                    f"{self._alike.turns} turns by these angles, even without errors: poses on "
                    f"{count} piece{'s' * (count > 1)} of walls look alike to them, in the median."
                )
        if self._alike is None:
            remarks.append(
                "Because headings are not exact, only symmetries of the map are looked for: "
                "further poses may look alike by these angles."
            )
        return tuple(remarks)

    @functools.cached_property
    def _pieces(self) -> list[tuple[shapely.Polygon, Bool[np.ndarray, "robots"]]]:
        """The connected pieces of the free space, and which robots start in them."""
        workspace = self.cells.workspace
        pieces = [] if workspace is None else shapely.get_parts(workspace.free_space).tolist()
        return [(piece, shapely.intersects_xy(piece, self.trial.start)) for piece in pieces]

    @functools.cached_property
    def _symmetric(self) -> tuple[int, ...]:
        workspace = self.cells.workspace
        return () if workspace is None else alike_places(workspace, self.headings)

    @functools.cached_property
    def _alike(self) -> Alike | None:
        """The poses that the angles cannot distinguish; `None` if headings are not exact."""
        if self.headings is None or not self.filter.errors.keep_headings:
            return None
        start, heading = self.trial.start[:_COMPARED], self.trial.heading[:_COMPARED]
        boundary, angles, made = self.filter.boundary, self.bounces.tolist(), np.diff(heading)
        return alike_poses(boundary, self.headings, angles, start, heading[:, 0], made)

    @functools.cached_property
    def _unresolved(self) -> Bool[np.ndarray, "compared"]:
        """True for robots that the angles surely cannot localize, even without errors."""
        # Places about the centre of a piece are at least this far from it.
        symmetric = [
            among & (count > 1) & (piece.boundary.distance(piece.centroid) > self.radius)
            for (piece, among), count in zip(self._pieces, self._symmetric, strict=True)
        ]
        if self._alike is None:
            return np.any(symmetric, axis=0)
        alike = ~is_localized(self._alike.extent, self.radius)
        return alike | np.any(symmetric, axis=0)[: alike.size]

    @derived("bounce", "bouncing angle", "degree", listed=True)
    def bounce_deg(self) -> Float[np.ndarray, "angles"]:
        return np.rad2deg(self.bounces).round(9)

    @derived("", "robots", "1", kind="count")
    def robots(self) -> int:
        return len(self.trial.run)

    @derived("", "robots that the filter loses", kind="share")
    def lost_share(self) -> float:
        return float((~self.trial.held).any(axis=1).mean())

    @derived("", "robots that are localized", kind="share")
    def localized_share(self) -> float:
        return float(np.isfinite(self.bumps_until_localized).mean())

    @derived("", "localized robots that are where their set says", kind="share")
    def right_share(self) -> float | None:
        robot = np.flatnonzero(np.isfinite(self.bumps_until_localized))
        bump = self.bumps_until_localized[robot].astype(int) - 1
        return float(self.trial.held[robot, bump].mean()) if robot.size else None

    @derived("", "bumps until a robot is localized, in the median", kind="time")
    def median_bumps(self) -> float:
        return float(np.median(self.bumps_until_localized))

    @derived(
        "", "robots that no sequence of a few turns localizes, even without errors", kind="share"
    )
    def alike_share(self) -> float | None:
        return None if self.filter.start is not None else float(self._unresolved.mean())

    @property
    def disbelieved(self) -> Int[np.ndarray, "robots"]:
        """The fewest bumps of each robot that were not on the map, by its sets."""
        return self.trial.disbelieved[:, -1]

    @derived("", "bumps that sets had to disbelieve, in the mean", "1")
    def mean_disbelieved(self) -> float | None:
        return float(self.disbelieved.mean()) if self.trial.outliers else None

    @derived("bump", "bumps", kind="coordinate")
    def bump(self) -> Int[np.ndarray, "bumps"]:
        return np.arange(1, self.trial.run.shape[1] + 1, dtype=np.int32)

    @derived("bump", "extent of the places that are possible, in the median", "m")
    def median_extent(self) -> Float[np.ndarray, "bumps"]:
        return np.median(self.extent, axis=0)

    @derived("bump", "largest extent of the robots, from a start region", "m")
    def largest_extent(self) -> Float[np.ndarray, "bumps"] | None:
        return None if self.filter.start is None else self.extent.max(axis=0)

    @derived("bump", "extent that nine of ten robots do not exceed", "m")
    def extent_of_nine_tenths(self) -> Float[np.ndarray, "bumps"]:
        return np.quantile(self.extent, 0.9, axis=0, method="inverted_cdf")

    @derived("robot bump", "extent of the places that are possible", "m")
    def extent(self) -> Float[np.ndarray, "robots bumps"]:
        # Bounds are moved outward by nanometres.
        return self.trial.extent.round(6)

    held = from_part(
        "trial.held", "robot bump", "whether the robot is where its filter says", kind="flag"
    )

    @derived("robot", "bumps until the robot is localized", kind="time")
    def bumps_until_localized(self) -> Float[np.ndarray, "robots"]:
        return bumps_until_localized(self.trial.extent, self.radius)

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
        return super().answered and bool(np.isfinite(self.bumps_until_home).any())

    @property
    def answer(self) -> tuple[str, ...]:
        bumps = self.median_bumps_until_home
        when = f", in the median after {counted(bumps, 'bump')}" if np.isfinite(bumps) else ""
        home = f"{100 * self.arrived_share:.3g} % of the robots are at the goal and know it{when}."
        if self.filter.start is not None and self.arrived_share == 1:
            home = f"{home[:-1]}, and at the latest after {self.bumps_until_home.max():g} bumps."
        return home, *super().answer

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


def share_of_all(share: float, robots: int) -> str:
    """Write a sentence with the 95 % interval of the share of all robots, from that of some."""
    low, high = clopper_pearson(np.array(round(share * robots)), robots)
    return (
        f"Of all robots it is {100 * float(low):.3g} to {100 * float(high):.3g} % (95 % interval)."
    )
