"""Sets of possible places on walls and headings of robots, which never lose a robot."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .boundary import Boundary
from .chords import Chords


# Bounds are moved outward by this, in metres, which is far more than rounding can be.
OUTWARD = 1e-9
# Stretches whose distance is at most this are joined, in metres.
_JOINED = 1e-6


class WallSet(NamedTuple):
    """The possible places of robots: stretches of walls, with slices of headings.

    The sets of several robots are kept in one array, sorted by robot, slice, wall and begin.
    """

    robot: Int[np.ndarray, "stretches"]
    slice: Int[np.ndarray, "stretches"]
    wall: Int[np.ndarray, "stretches"]
    begin: Float[np.ndarray, "stretches"]
    "Arc length on the wall, in metres."
    end: Float[np.ndarray, "stretches"]

    def take(self, which: np.ndarray) -> "WallSet":
        """Choose stretches by their numbers or by a mask."""
        return WallSet(*(part[which] for part in self))

    def joined(self, apart: float = _JOINED) -> "WallSet":
        """Sort the stretches, and join those that overlap or are at most `apart` metres apart."""
        order = np.lexsort((self.begin, self.wall, self.slice, self.robot))
        robot, slice_, wall, begin, end = self.take(order)
        if not begin.size:
            return self
        new = np.r_[True, np.diff(robot) != 0]
        for part in (slice_, wall):
            new[1:] |= part[1:] != part[:-1]
        # One place after the other, so that the running maximum never carries into the next group.
        shift = np.cumsum(new) * (2 * end.max() + 1)
        farthest = np.maximum.accumulate(shift + end)
        new[1:] |= (shift + begin)[1:] > farthest[:-1] + apart
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
    """Follow robots that run straight for `least` to `most` metres until they meet a wall.

    The headings of the sets are those of the runs. The set of a robot whose run no place explains
    is empty.
    """
    stretch, row = _overlapping(chords, state)
    robot, begin, end = state.robot[stretch], state.begin[stretch], state.end[stretch]
    begin = np.maximum(begin, chords.begin[row] - OUTWARD)
    end = np.minimum(end, chords.end[row] + OUTWARD)
    least, most = least[robot] - OUTWARD, most[robot] + OUTWARD
    # The part of the stretch from which the run can be as long as it was.
    near, far = chords.stretch[:, row]
    constant, slope = chords.clearance[:, row]
    with np.errstate(divide="ignore", invalid="ignore"):
        above = np.where(least > 0, least / far, -np.inf) - chords.displacement - constant
        below = most / near + chords.displacement - constant
        level = np.abs(slope) < 1e-12
        first = np.where(slope > 0, above / slope, below / slope)
        last = np.where(slope > 0, below / slope, above / slope)
    possible = ~level | ((above <= OUTWARD) & (below >= -OUTWARD))
    begin = np.where(level, begin, np.maximum(begin, first - OUTWARD))
    end = np.where(level, end, np.minimum(end, last + OUTWARD))
    kept = np.flatnonzero(possible & (begin <= end))
    row, robot, begin, end, most = row[kept], robot[kept], begin[kept], end[kept], most[kept]
    hit = chords.hit[row]
    arcs = chords.arc[:, :, row]
    ends = np.stack([arcs[:, 0] + arcs[:, 1] * begin, arcs[:, 0] + arcs[:, 1] * end])
    # No run is longer than the largest, so it does not go farther along the wall either.
    boundary = chords.boundary
    wall = chords.wall[row]
    beside = [
        ((boundary.point(wall, arc) - boundary.begin[hit]) * boundary.tangent[hit]).sum(axis=1)
        for arc in (begin, end)
    ]
    most, spread = most + chords.displacement, chords.spread[:, row]
    low = np.maximum((ends - spread).min(axis=(0, 1)), np.min(beside, axis=0) - most) - OUTWARD
    high = np.minimum((ends + spread).max(axis=(0, 1)), np.max(beside, axis=0) + most) + OUTWARD
    low, high = np.maximum(low, 0.0), np.minimum(high, boundary.length[hit])
    there = low <= high
    reached = WallSet(robot, chords.slice[row], hit, low, high).take(there)
    return _with_corners(boundary, reached).joined()


def _with_corners(boundary: Boundary, state: WallSet) -> WallSet:
    """Add the corners that a set reaches to the other wall of each, since they belong to both."""
    length = boundary.length[state.wall]
    begins = state.take(state.begin <= 2 * OUTWARD)
    ends = state.take(state.end >= length - 2 * OUTWARD)
    before, after = boundary.preceding[begins.wall], boundary.following[ends.wall]
    corner = boundary.length[before]
    none = np.zeros(after.size)
    parts = (
        state,
        begins._replace(wall=before, begin=corner, end=corner),
        ends._replace(wall=after, begin=none, end=none),
    )
    return WallSet(*map(np.concatenate, zip(*parts, strict=True)))


def _overlapping(
    chords: Chords, state: WallSet
) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
    """List the pairs of a stretch of a set and a row of the chords that it overlaps."""
    size = chords.boundary.diameter + 1.0
    group = state.slice.astype(np.int64) * len(chords.boundary.length) + state.wall
    low = np.searchsorted(chords.group * size + chords.end, group * size + state.begin - _JOINED)
    high = np.searchsorted(
        chords.group * size + chords.begin, group * size + state.end + _JOINED, side="right"
    )
    count = np.maximum(high - low, 0)
    stretch = np.repeat(np.arange(count.size), count)
    return stretch, low[stretch] + np.arange(stretch.size) - np.repeat(
        np.cumsum(count) - count, count
    )


def turned(
    state: WallSet, shift: Int[np.ndarray, "stretches"], slices: int, error: int = 0
) -> WallSet:
    """Turn robots counter-clockwise by `shift` slices, with errors of up to `error` slices."""
    off = np.arange(-error, error + 1)
    copy = np.repeat(np.arange(shift.size), off.size)
    after = (state.slice + shift)[:, None] + off
    return state.take(copy)._replace(slice=after.ravel() % slices).joined()


def arrivals(chords: Chords, least: Float[np.ndarray, "robots"]) -> WallSet:
    """Compute the sets of robots after first runs from anywhere of at least a length, in metres.

    They are the places with a free line of that length behind them; the number of slices is even.
    """
    boundary = chords.boundary
    size = boundary.length.size
    half = chords.slices // 2
    slice_, wall = (part.ravel() for part in np.indices((chords.slices, size)))
    count = least.size
    everywhere = WallSet(
        np.repeat(np.arange(count), wall.size), np.tile(slice_, count), np.tile(wall, count),
        np.zeros(count * wall.size), np.tile(boundary.length[wall], count),
    )  # fmt: skip
    stretch, row = _overlapping(chords, everywhere)
    robot = everywhere.robot[stretch]
    begin, end = chords.begin[row], chords.end[row]
    far = chords.stretch[1, row]
    constant, slope = chords.clearance[:, row]
    # A robot that meets the wall came from its free side.
    leaves = chords.hit[row] != chords.wall[row]
    wanted = np.maximum(least[robot] - OUTWARD, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        above = np.where(wanted > 0, wanted / far, -np.inf) - chords.displacement - constant
        place = above / slope
    level = np.abs(slope) < 1e-12
    leaves &= ~level | (above <= OUTWARD)
    begin = np.where(~level & (slope > 0), np.maximum(begin, place - OUTWARD), begin)
    end = np.where(~level & (slope < 0), np.minimum(end, place + OUTWARD), end)
    kept = np.flatnonzero(leaves & (begin <= end))
    row = row[kept]
    wall = chords.wall[row]
    begin = np.maximum(begin[kept] - OUTWARD, 0.0)
    end = np.minimum(end[kept] + OUTWARD, boundary.length[wall])
    headed = (chords.slice[row] + half) % chords.slices
    return _with_corners(boundary, WallSet(robot[kept], headed, wall, begin, end)).joined()


def contains(
    boundary: Boundary,
    state: WallSet,
    slices: Int[np.ndarray, "robots"],
    place: Float[np.ndarray, "robots 2"],
) -> Bool[np.ndarray, "robots"]:
    """Check for each robot whether a place on a wall and a slice of headings are in its set.

    A corner belongs to both of its walls.
    """
    robot, wall = state.robot, state.wall
    offset = place[robot] - boundary.begin[wall]
    arc = (offset * boundary.tangent[wall]).sum(axis=1)
    nearest = boundary.point(wall, np.clip(arc, state.begin, state.end))
    apart = np.linalg.norm(place[robot] - nearest, axis=1)
    inside = (state.slice == slices[robot]) & (apart <= 10 * OUTWARD)
    return np.bincount(robot[inside], minlength=len(place)) > 0


def extent(boundary: Boundary, state: WallSet, robots: int) -> Float[np.ndarray, "robots"]:
    """Measure the diagonal of the box around all places of each robot, in metres; 0 for none."""
    ends = [boundary.point(state.wall, arc) for arc in (state.begin, state.end)]
    low, high = np.full((robots, 2), np.inf), np.full((robots, 2), -np.inf)
    for end in ends:
        np.minimum.at(low, state.robot, end)
        np.maximum.at(high, state.robot, end)
    return np.linalg.norm(np.where(high >= low, high - low, 0.0), axis=1)
