import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Float

from ..base.formatting import counted
from ..base.intervals import clopper_pearson
from ..base.quantities import Checks, Result, derived, quantity
from ..space import CellSpace
from ..walls import Alike, alike_poses, is_localized
from .anywhere import Anywhere, HomeFromAnywhere


# The number of starts whose poses are compared with all other poses, and of their headings.
_COMPARED, _HEADINGS = 50, 24


@dataclasses.dataclass(frozen=True, eq=False)
class ProposedAngles(Result):
    """The proposed 1, 2, ... bouncing angles of a robot that starts anywhere, with simulations."""

    title: ClassVar[str] = "Bouncing angles for robots that start anywhere"
    tables: ClassVar[Mapping[str, str]] = {"count": "angles"}

    cells: CellSpace
    trials: Mapping[int, Anywhere]
    "Simulated robots with the proposed angles, keyed by the number of angles."
    tried: Annotated[int, quantity("", "sets of angles that were tried", kind="count")]
    finished: Annotated[bool, quantity("", "whether the search reached its end", kind="flag")]

    @property
    def best(self) -> Anywhere:
        """The trial with the fewest bumps in the mean; robots that fail count all bumps twice."""
        return min(
            self.trials.values(),
            key=lambda one: np.minimum(self._bumps(one), 2 * one.bump.size).mean(),
        )

    @property
    def answered(self) -> bool:
        return all(one.lost_share == 0 for one in self.trials.values()) and self.best.answered

    @property
    def answer(self) -> tuple[str, ...]:
        number = list(self.trials.values()).index(self.best)
        does = "are home and know it" if self._home else "know where they are"
        share, median = float(self.share[number]), float(self.median[number])
        when = f", in the median after {counted(median, 'bump')}" if np.isfinite(median) else ""
        return (
            f"Take {self.angles_deg[number]} degrees: {100 * share:.3g} % of "
            f"{self.best.crowd(share)} {does}, to {self.best.radius:.3g} m{when}.",
            *self._unfinished,
            *self._alike_poses,
        )

    @property
    def _unfinished(self) -> tuple[str, ...]:
        if self.finished:
            return ()
        tried = counted(self.tried, "set")
        return (f"The time was over after {tried} of angles, so more time may find better angles.",)

    @property
    def _alike_poses(self) -> tuple[str, ...]:
        """A sentence with the poses that the best angles cannot tell apart."""
        alike, best = self._alike, self.best
        if alike is None:
            return ()
        unresolved = ~is_localized(alike.extent, best.radius)
        begin = f"Of {unresolved.size} starts without errors,"
        if not unresolved.any():
            return (f"{begin} none keeps poses elsewhere that look alike to these angles.",)
        pieces = np.bincount(alike.poses.robot, minlength=unresolved.size)[unresolved]
        count = int(np.quantile(pieces, 0.5, method="inverted_cdf"))
        return (
            f"{begin} {unresolved.sum()} are not localized by any {alike.turns} turns by these "
            f"angles: poses on {counted(count, 'piece')} of walls look alike, in the median.",
        )

    @functools.cached_property
    def _alike(self) -> Alike | None:
        filter, best = self.best.filter, self.best
        if filter.start is not None:
            return None
        exact = best.headings is not None and filter.errors.keep_headings
        headings = best.headings if exact and best.headings is not None else _HEADINGS
        width = math.tau / headings
        heading = np.round(best.trial.heading[:_COMPARED, 0] / width) * width
        start = best.trial.start[:_COMPARED]
        return alike_poses(filter.boundary, headings, best.bounces.tolist(), start, heading)

    @property
    def _home(self) -> bool:
        return isinstance(self.best, HomeFromAnywhere)

    def _bumps(self, trial: Anywhere) -> Float[np.ndarray, "robots"]:
        """Return the bumps until each robot is home, or localized if there is no goal."""
        if isinstance(trial, HomeFromAnywhere):
            return trial.bumps_until_home
        return trial.bumps_until_localized

    @derived("count", "number of angles", kind="coordinate")
    def count(self) -> np.ndarray:
        return np.array([*self.trials], np.int32)

    @derived("count", "bouncing angles in degrees", kind="text")
    def angles_deg(self) -> np.ndarray:
        return np.array([_listed(one.bounce_deg.tolist()) for one in self.trials.values()])

    @derived("count", "robots that succeed", kind="share")
    def share(self) -> Float[np.ndarray, "count"]:
        return np.array([np.isfinite(self._bumps(one)).mean() for one in self.trials.values()])

    @derived("count", "least share of all robots, at 95 %", kind="share")
    def least_share(self) -> Float[np.ndarray, "count"]:
        return self._limits[0]

    @derived("count", "largest share of all robots, at 95 %", kind="share")
    def largest_share(self) -> Float[np.ndarray, "count"]:
        return self._limits[1]

    @property
    def _limits(self) -> tuple[Float[np.ndarray, "count"], Float[np.ndarray, "count"]]:
        robots = self.best.robots
        return clopper_pearson(np.round(self.share * robots).astype(int), robots)

    @derived("count", "bumps until a robot succeeds, in the median", kind="time")
    def median(self) -> Float[np.ndarray, "count"]:
        return np.array([np.median(self._bumps(one)) for one in self.trials.values()])

    def checks(self) -> Checks:
        lost = sum(int((~one.trial.held).any(axis=1).sum()) for one in self.trials.values())
        return {"robots_that_are_lost": (lost, 0)}


def _listed(angles: list[float]) -> str:
    """Format numbers as `45, 90 and 135`."""
    *others, last = [f"{angle:g}" for angle in angles]
    return f"{', '.join(others)} and {last}" if others else last
