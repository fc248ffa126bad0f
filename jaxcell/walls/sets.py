"""Sets of possible places on walls and possible headings of robots."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..space.copies import copies
from .boundary import Boundary
from .chords import Chords


# The largest distance of stretches that are joined, in metres.
_JOINED = 1e-6


class WallSet(NamedTuple):
    """The possible places and headings of robots: stretches of walls, with slices of headings.

    The arrays contain the sets of all robots, sorted by robot, slice, wall and begin.
    """

    robot: Int[np.ndarray, "stretches"]
    slice: Int[np.ndarray, "stretches"]
    wall: Int[np.ndarray, "stretches"]
    begin: Float[np.ndarray, "stretches"]
    "The arc length on the wall where the stretch begins, in metres."
    end: Float[np.ndarray, "stretches"]

    def take(self, which: np.ndarray) -> "WallSet":
        """Choose stretches by their numbers or by a mask."""
        return WallSet(*(part[which] for part in self))

    def joined(self) -> "WallSet":
        """Sort the stretches, and join stretches that overlap or touch."""
        if not self.begin.size:
            return self
        # One number of robot, slice and wall is sorted faster than three.
        slices, walls = self.slice.max() + 1, self.wall.max() + 1
        group = (self.robot.astype(np.int64) * slices + self.slice) * walls + self.wall
        order = np.lexsort((self.begin, group))
        robot, slice_, wall, begin, end = self.take(order)
        new = np.r_[True, np.diff(group[order]) != 0]
        # Each group is shifted beyond the group before it, so that one running maximum serves all.
        shift = np.cumsum(new) * (2 * end.max() + 1)
        farthest = np.maximum.accumulate(shift + end)
        new[1:] |= (shift + begin)[1:] > farthest[:-1] + _JOINED
        first = np.flatnonzero(new)
        return WallSet(
            robot[first], slice_[first], wall[first], begin[first], np.maximum.reduceat(end, first)
        )


def observe(
    chords: Chords,
    state: WallSet,
    least: Float[np.ndarray, "robots"],
    most: Float[np.ndarray, "robots"],
) -> WallSet:
    """Update the sets of robots that run straight for `least` to `most` metres to a wall.

    The headings of the sets are the headings of the runs. The set of a robot is empty if its run is
    impossible from every place.
    """
    robot, row, begin, end = leaving(chords, state, least, most)
    hit = chords.hit[row]
    arcs = chords.arc[:, :, row]
    ends = np.stack([arcs[:, 0] + arcs[:, 1] * begin, arcs[:, 0] + arcs[:, 1] * end])
    # The wall is also met as far along it as the run leads there.
    boundary, reach, spread = chords.boundary, chords.reach[row], chords.spread[:, row]
    wall, (back, forth) = chords.wall[row], chords.cosine[:, row]
    least, most = least[robot] - reach, most[robot] + reach
    beside = [
        ((boundary.point(wall, arc) - boundary.begin[hit]) * boundary.tangent[hit]).sum(axis=1)
        for arc in (begin, end)
    ]
    backmost = np.min(beside, axis=0) + back * np.where(back < 0, most, least) - reach
    foremost = np.max(beside, axis=0) + forth * np.where(forth < 0, least, most) + reach
    low = np.maximum((ends - spread).min(axis=(0, 1)), backmost)
    high = np.minimum((ends + spread).max(axis=(0, 1)), foremost)
    low = np.maximum(low - boundary.tolerance, 0.0)
    high = np.minimum(high + boundary.tolerance, boundary.length[hit])
    reached = WallSet(robot, chords.slice[row], hit, low, high).take(low <= high)
    return _with_corners(boundary, reached).joined()


def leaving(
    chords: Chords,
    state: WallSet,
    least: Float[np.ndarray, "robots"],
    most: Float[np.ndarray, "robots"],
) -> tuple[
    Int[np.ndarray, "parts"],
    Int[np.ndarray, "parts"],
    Float[np.ndarray, "parts"],
    Float[np.ndarray, "parts"],
]:
    """Reduce a set to the parts of walls from which runs of `least` to `most` metres are possible.

    Returns, for each part, its robot, the row of its chord, and the arc lengths of its two ends.
    """
    stretch, row = overlapping(chords, state)
    shortest, longest = chords.run
    robot = state.robot[stretch]
    near = np.flatnonzero((shortest[row] <= most[robot]) & (longest[row] >= least[robot]))
    stretch, row, robot = stretch[near], row[near], robot[near]
    begin, end = state.begin[stretch], state.end[stretch]
    tolerance, reach = chords.boundary.tolerance, chords.reach[row]
    begin = np.maximum(begin, chords.begin[row] - tolerance)
    end = np.minimum(end, chords.end[row] + tolerance)
    least, most = np.maximum(least[robot] - tolerance, 0.0), most[robot] + tolerance
    (gentle, steep), (constant, slope) = chords.sine[:, row], chords.clearance[:, row]
    with np.errstate(divide="ignore", invalid="ignore"):
        # An arc may lean away from the robot, so that a longer run begins farther behind its chord.
        above = np.where(gentle < 0, most, least) * gentle - reach - constant
        below = np.where(steep < 0, least, most) * steep + reach - constant
        level = slope == 0
        first = np.where(slope > 0, above / slope, below / slope)
        last = np.where(slope > 0, below / slope, above / slope)
    possible = ~level | ((above <= 0) & (below >= 0))
    begin = np.where(level, begin, np.maximum(begin, first))
    end = np.where(level, end, np.minimum(end, last))
    kept = np.flatnonzero(possible & (begin <= end))
    return robot[kept], row[kept], begin[kept], end[kept]


def _with_corners(boundary: Boundary, state: WallSet) -> WallSet:
    """Add each corner that a set contains on one wall as a place on the adjacent wall."""
    length = boundary.length[state.wall]
    begins = state.take(state.begin <= 2 * boundary.tolerance)
    ends = state.take(state.end >= length - 2 * boundary.tolerance)
    before, after = boundary.preceding[begins.wall], boundary.following[ends.wall]
    corner = boundary.length[before]
    none = np.zeros(after.size)
    parts = (
        state,
        begins._replace(wall=before, begin=corner, end=corner),
        ends._replace(wall=after, begin=none, end=none),
    )
    return WallSet(*map(np.concatenate, zip(*parts, strict=True)))


def overlapping(
    chords: Chords, state: WallSet
) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
    """List the pairs of a stretch of a set and a row of `chords` that overlap on a wall."""
    size, begins, ends = chords.keys
    group = state.slice.astype(np.int64) * len(chords.boundary.length) + state.wall
    low = np.searchsorted(ends, group * size + state.begin - _JOINED)
    high = np.searchsorted(begins, group * size + state.end + _JOINED, side="right")
    stretch, number = copies(np.maximum(high - low, 0))
    return stretch, low[stretch] + number


def turned(
    state: WallSet,
    first: Int[np.ndarray, "stretches"],
    count: Int[np.ndarray, "stretches"],
    slices: int,
) -> WallSet:
    """Copy each stretch `count` times, turned left by `first`, `first + 1`, ... of all `slices`."""
    copy, number = copies(count)
    after = (state.slice + first)[copy] + number
    return state.take(copy)._replace(slice=after % slices).joined()


def everywhere(chords: Chords) -> WallSet:
    """Return the set of one robot with all places on walls and all headings."""
    boundary = chords.boundary
    slice_, wall = np.indices((chords.slices, boundary.length.size)).reshape(2, -1)
    robot, begin = np.zeros(wall.size, int), np.zeros(wall.size)
    return WallSet(robot, slice_, wall, begin, boundary.length[wall])


def arrivals(chords: Chords, state: WallSet, least: Float[np.ndarray, "robots"]) -> WallSet:
    """Reduce sets to the places to which a run of at least `least` metres can lead.

    From such a place a run the opposite way can be as long. `chords.slices` must be even.
    """
    boundary = chords.boundary
    back = state._replace(slice=(state.slice + chords.slices // 2) % chords.slices)
    longest = np.full(least.size, boundary.diameter + chords.reach.max())
    robot, row, begin, end = leaving(chords, back, least, longest)
    wall, hit = chords.wall[row], chords.hit[row]
    starts = [boundary.point(wall, arc) for arc in (begin, end)]
    corners = boundary.begin[hit], boundary.begin[boundary.following[hit]]
    run = np.max([np.hypot(*(a - b).T) for a in starts for b in corners], axis=0)
    begin = np.maximum(begin - boundary.tolerance, 0.0)
    end = np.minimum(end + boundary.tolerance, boundary.length[wall])
    heading = (chords.slice[row] + chords.slices // 2) % chords.slices
    # A robot that meets a wall comes from its free side.
    reached = WallSet(robot, heading, wall, begin, end)
    reached = reached.take((hit != wall) & (run + chords.reach[row] >= least[robot]))
    return _with_corners(boundary, reached).joined()


def contains(
    boundary: Boundary,
    state: WallSet,
    slices: Int[np.ndarray, "robots"],
    place: Float[np.ndarray, "robots 2"],
) -> Bool[np.ndarray, "robots"]:
    """Check for each robot whether its set contains its place on a wall with its slice of headings.

    Places are in metres. A corner belongs to both of its walls.
    """
    robot, wall = state.robot, state.wall
    offset = place[robot] - boundary.begin[wall]
    arc = (offset * boundary.tangent[wall]).sum(axis=1)
    nearest = boundary.point(wall, np.clip(arc, state.begin, state.end))
    apart = np.linalg.norm(place[robot] - nearest, axis=1)
    inside = (state.slice == slices[robot]) & (
        apart <= 10 * boundary.tolerance + boundary.bulge[wall]
    )
    return np.bincount(robot[inside], minlength=len(place)) > 0
