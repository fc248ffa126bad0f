import dataclasses
import functools
from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..base.formatting import counted, percent
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
            f"{100 * share:.3g} % of {self.crowd(share)} know where they are, to "
            f"{self.radius:.3g} m{when}; {100 * self.lost_share:.3g} % are lost.",
            *self._exact,
            *self._outside,
        )

    @property
    def _worst(self) -> tuple[str, ...]:
        """A sentence with the largest radius of a set after some bumps from a start region."""
        start, worst = self.filter.start, self.largest_extent
        if start is None or worst is None:
            return ()
        bumps = sorted({*self.bump[:5].tolist(), int(self.bump[-1])})
        within = [f"{half:.2g} m" if half >= 1e-3 else "less than 1 mm" for half in worst / 2]
        known = ", ".join(f"{within[bump - 1]} after {bump}" for bump in bumps)
        x, y = start.place
        return (
            f"From ({x:g} m, {y:g} m), each of {self.crowd()} knows its place to within {known} "
            "bumps.",
        )

    def crowd(self, share: float | None = None) -> str:
        """Describe the number of robots, and the 95 % interval of a share of them."""
        if (self.trial.run == self.trial.run[0]).all():
            return f"{self.robots:,} simulated robots (all the same)"
        if share is None:
            return f"{self.robots:,} simulated robots"
        seen = np.array(round(share * self.robots))
        low, high = (100 * limit for limit in clopper_pearson(seen, self.robots))
        return f"{self.robots:,} simulated robots (likely {low:.3g} to {high:.3g} %)"

    @property
    def _exact(self) -> tuple[str, ...]:
        """A sentence if headings are known and no error changes them."""
        if self.filter.chords.width:
            return ()
        return ("Headings and turns are taken as exact, because no error of them is given.",)

    @property
    def _outside(self) -> tuple[str, ...]:
        """A sentence with the robots that start outside the largest piece of the free space."""
        if len(self._pieces) < 2 or self.filter.start is not None:
            return ()
        _, inside = max(self._pieces, key=lambda piece: piece[0].area)
        return (
            f"{percent(1 - inside.mean())} of the robots start outside the largest piece of the "
            "free space, such as in a closed closet; piece=largest leaves them out.",
        )

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
            f"{unmapped} per robot not on the map: sets had to disbelieve {', '.join(counts)}; "
            "the other sets explain such a bump by another place, or by the errors.",
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

    @derived("bump", "extent of the places that are possible, in the median", "m", kind="extent")
    def median_extent(self) -> Float[np.ndarray, "bumps"]:
        return np.median(self.extent, axis=0)

    @derived("bump", "largest extent of the robots, from a start region", "m", kind="extent")
    def largest_extent(self) -> Float[np.ndarray, "bumps"] | None:
        return None if self.filter.start is None else self.extent.max(axis=0)

    @derived("bump", "extent that nine of ten robots do not exceed", "m", kind="extent")
    def extent_of_nine_tenths(self) -> Float[np.ndarray, "bumps"]:
        return np.quantile(self.extent, 0.9, axis=0, method="inverted_cdf")

    @derived("robot bump", "extent of the places that are possible", "m", kind="extent")
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

    @property
    def answered(self) -> bool:
        return super().answered and bool(np.isfinite(self.bumps_until_home).any())

    @property
    def answer(self) -> tuple[str, ...]:
        bumps, share, (x, y) = self.median_bumps_until_home, self.arrived_share, self.homing.goal
        when = f", in the median after {counted(bumps, 'bump')}" if np.isfinite(bumps) else ""
        if self.filter.start is not None and share == 1:
            when += f", and at the latest after {self.bumps_until_home.max():g} bumps"
        return (
            f"{100 * share:.3g} % of {self.crowd(share)} are within {self.homing.radius:.3g} m "
            f"of ({x:g} m, {y:g} m) and know it{when}.",
            *self._unarrived,
            *super().answer,
        )

    @property
    def _unarrived(self) -> tuple[str, ...]:
        """A sentence with the reason why robots are not home, if there are such robots."""
        others = ~np.isfinite(self.bumps_until_home)
        if not others.any():
            return ()
        goal, across = np.array(self.homing.goal), 2 * self.homing.radius
        at_goal = np.hypot(*(self.trial.place - goal).transpose(2, 0, 1)) <= self.homing.radius
        at_goal = at_goal & others[:, np.newaxis]
        were, rest = np.count_nonzero(at_goal.any(axis=1)), np.count_nonzero(others)
        why = f"{were:,} of the {rest:,} others were there at a bump and did not know it"
        if were:
            extent = np.median(self.trial.extent[at_goal])
            why += f": their sets were {extent:.2g} m long, the goal is {across:.2g} m wide"
        return (f"{why}.",)

    @derived("", "robots that come to the goal and know it", kind="share")
    def arrived_share(self) -> float:
        return float(np.isfinite(self.bumps_until_home).mean())

    @derived("", "bumps until a robot is home, in the median", kind="time")
    def median_bumps_until_home(self) -> float:
        return float(np.median(self.bumps_until_home))

    @derived("", "expected bumps of a robot that knows its pose at each bump", kind="time")
    def known_bumps(self) -> float:
        # Places are rounded to 20 cm, so the number may be a little larger than that of a robot.
        start, heading = self.trial.start, self.trial.heading[:, 0]
        return float(np.median(self.homing.expected(start, heading)))

    @derived("", "length of the way home of robots that arrive, in the median", "m")
    def median_metres(self) -> float:
        ways = np.cumsum(self.trial.run, axis=1)[self.trial.arrived.cumsum(axis=1) == 1]
        return float(np.median(ways)) if ways.size else np.inf

    @derived("robot", "bumps until the robot is home", kind="time")
    def bumps_until_home(self) -> Float[np.ndarray, "robots"]:
        arrived = self.trial.arrived
        return np.where(arrived.any(axis=1), arrived.argmax(axis=1) + 1.0, np.inf)
