"""The region in which a robot starts, such as its dock."""

import dataclasses
import math

import numpy as np
import shapely
from jaxtyping import Bool, Float

from ..space import Workspace
from .chords import Chords
from .sets import WallSet, arrivals


@dataclasses.dataclass(frozen=True)
class StartRegion:
    """A region where a robot starts: a disc of places, and an interval of headings.

    The first run of the robot begins in the free part of the disc. The error of its heading is
    `heading` of [`Errors`][jaxcell.walls.Errors].

        >>> import numpy as np
        >>> from jaxcell import space, walls
        >>> room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
        >>> dock = walls.StartRegion((1.0, 1.0), heading=0.0, radius=0.1)
        >>> filter = walls.WallFilter.of(room, headings=8, start=dock)
        >>> state = filter.observe(None, 4.0)
        >>> filter.boundary.point(state.wall, state.end).round(2).tolist()
        [[5.0, 1.1]]
    """

    place: tuple[float, float]
    "The centre of the disc, in metres."
    heading: float | None = None
    "The middle of the interval of headings in radians; `None` for all headings of the filter."
    radius: float = 0.0
    "The radius of the disc, in metres."

    def check(self, workspace: Workspace) -> None:
        """Raise `ValueError` if a robot cannot start in the region."""
        if not 0 <= self.radius < math.inf:
            raise ValueError(f"radius: expected a length in metres from 0, got {self.radius:g}")
        if not workspace.free_space.covers(shapely.Point(self.place)):
            x, y = self.place
            raise ValueError(f"({x:g} m, {y:g} m) is not in the free space")

    def draw(
        self, workspace: Workspace, count: int, rng: np.random.Generator
    ) -> Float[np.ndarray, "count 2"]:
        """Draw places uniformly from the free part of the disc, in metres."""
        if not self.radius:
            return np.tile(self.place, (count, 1))
        low, high = np.add.outer([-self.radius, self.radius], self.place)
        places = np.empty((0, 2))
        while len(places) < count:
            tried = rng.uniform(low, high, (2 * count + 16, 2))
            inside = np.hypot(*(tried - self.place).T) <= self.radius
            inside &= shapely.intersects_xy(workspace.free_space, tried)
            places = np.concatenate([places, tried[inside]])
        return places[:count]

    def faced(self, slices: int, width: float, error: float) -> Bool[np.ndarray, "slices"]:
        """Check for each of `slices` slices of `width` whether a robot may start with its headings.

        `error` is the largest error of the heading at the start; all angles are in radians.
        """
        if self.heading is None:
            return np.ones(slices, bool)
        turn = 2 * math.pi / slices
        off = np.arange(slices) * turn - self.heading
        off = (off + math.pi) % (2 * math.pi) - math.pi
        reach = error + 1e-6 * turn
        return (off + width >= -reach) & (off <= reach)

    def reached(
        self,
        chords: Chords,
        state: WallSet,
        least: Float[np.ndarray, "robots"],
        most: Float[np.ndarray, "robots"],
    ) -> WallSet:
        """Reduce sets to places that runs of `least` to `most` metres from the region lead to.

        The headings of the sets are those of the runs.
        """
        robots = least.size
        places, radii = np.tile(self.place, (robots, 1)), np.full(robots, self.radius)
        return arrivals(chords, at_distance(chords, state, places, radii, least, most), least)


def at_distance(
    chords: Chords,
    state: WallSet,
    place: Float[np.ndarray, "robots 2"],
    radius: Float[np.ndarray, "robots"],
    least: Float[np.ndarray, "robots"],
    most: Float[np.ndarray, "robots"],
) -> WallSet:
    """Reduce sets to places that are `least` to `most` metres ahead of a disc for each robot.

    The discs have centres and radii in metres, and the headings of the sets are those of the runs.
    The ends of the runs from a point with the headings of a slice lie between two rays and two
    lines across the middle of the slice. Each of these half-planes is moved by the radius.
    """
    boundary, robot = chords.boundary, state.robot
    half = chords.width / 2 + boundary.tolerance / boundary.diameter
    middle = state.slice * (2 * np.pi / chords.slices) + chords.width / 2
    slack = radius[robot] + boundary.bulge[state.wall] + 2 * boundary.tolerance
    offset, tangent = boundary.begin[state.wall] - place[robot], boundary.tangent[state.wall]
    begin, end = state.begin, state.end
    for outward, bound in (
        (middle - half - np.pi / 2, 0.0),
        (middle + half + np.pi / 2, 0.0),
        (middle, most[robot]),
        (middle + np.pi, -least[robot] * np.cos(half)),
    ):
        normal = np.stack([np.cos(outward), np.sin(outward)], axis=1)
        room = bound + slack - (offset * normal).sum(axis=1)
        slope = (tangent * normal).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            edge = np.where(slope == 0, np.copysign(np.inf, room), room / slope)
        end = np.where(slope >= 0, np.minimum(end, edge), end)
        begin = np.where(slope < 0, np.maximum(begin, edge), begin)
    return state._replace(begin=begin, end=end).take(begin <= end)
