"""Find the poses on a map that a robot without a compass cannot distinguish."""

import dataclasses
import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float
from shapely import affinity

from ..base.shown import Shown
from ..space import Workspace
from .boundary import Boundary, run_to_wall
from .chords import Chords
from .sets import WallSet, arrivals, everywhere, overlapping


# The largest order of the rotations that are tried if the heading is not known.
_LARGEST_ORDER = 24
# The largest share of the area by which two equal shapes may differ.
_DIFFERENT = 1e-6
# Equal places differ by at most this many tolerances of the boundary, across a run. The ends of a
# stretch of equal poses are farther than this many tolerances from poses that differ.
_EQUAL, _INSIDE = 10, 100
# The largest number of sequences of turns that are compared, and of turns in a sequence.
_SEQUENCES, _TURNS = 128, 20
# The largest denominator of an angle as a part of a full turn.
_LARGEST_DENOMINATOR = 100_000


def alike_places(workspace: Workspace, headings: int | None = None) -> tuple[int, ...]:
    """Count, for each connected piece of a room, the poses that look the same to a robot in it.

    Poses look the same, whatever turns the robot makes, if a rotation of the piece onto itself or
    onto another piece maps one pose to the other: it maps each run to a run of the same length. If
    `headings` is the number of headings that robots may start with, only rotations between these
    headings count. The count of a piece without a symmetry is 1. Pieces are in the order of
    `workspace.free_space`.

    A square room looks the same in four poses, or in two if the heading is East or West:

        >>> from jaxcell import space, walls
        >>> square = space.Workspace([(0, 0), (3, 0), (3, 3), (0, 3)])
        >>> walls.alike_places(square), walls.alike_places(square, headings=2)
        ((4,), (2,))
    """
    pieces = shapely.get_parts(workspace.free_space).tolist()
    if headings is None:
        turns = {k / order for order in range(1, _LARGEST_ORDER + 1) for k in range(order)}
    else:
        turns = {k / headings for k in range(headings)}
    return tuple(
        sum(_same(piece, other, 360 * turn) for other in pieces for turn in sorted(turns))
        for piece in pieces
    )


def _same(piece: shapely.Polygon, other: shapely.Polygon, degrees: float) -> bool:
    """Check whether a polygon, rotated about its centroid and moved, equals another one."""
    if not np.isclose([piece.area, piece.length], [other.area, other.length]).all():
        return False
    to = np.subtract(other.centroid.coords[0], piece.centroid.coords[0])
    moved = affinity.translate(affinity.rotate(piece, degrees, "centroid"), *to)
    return bool(shapely.symmetric_difference(moved, other).area <= _DIFFERENT * piece.area)


@dataclasses.dataclass(frozen=True, eq=False)
class Alike(Shown):
    """The poses that some angles cannot distinguish from the poses of robots."""

    turns: int
    "The length of the sequences of turns that were compared."
    poses: WallSet
    "The poses after the first bump and before the first turn, those of the robots included."
    extent: Float[np.ndarray, "robots"]
    """The least diagonal, in metres, of the box around the places to which a sequence of turns
    leads from the poses of each robot. No such sequence localizes a robot better."""


def alike_poses(
    boundary: Boundary,
    headings: int,
    angles: Sequence[float],
    place: Float[np.ndarray, "robots 2"],
    heading: Float[np.ndarray, "robots"],
    made: Float[np.ndarray, "robots turns"] | None = None,
) -> Alike:
    """Find poses that the given angles cannot distinguish from the poses of robots.

    Robots move as in [`run_to_wall`][jaxcell.walls.run_to_wall]: they drive on along walls and past
    corners that they touch. After its first bump, a robot makes a sequence of turns by `angles`. A
    pose is *alike* if every sequence, up to a number of turns, leads from it to runs of the same
    lengths as from the pose of the robot. The first run excludes the poses from which an equally
    long run back would hit a wall. A pose is always alike itself.

    The paths from alike poses differ by a rotation and a translation. So each run of a robot is
    rotated and translated to the other pose, and is compared with the run from there. In this way,
    rounding errors do not grow from run to run. Each pose that is found is alike to within rounding
    errors, unless a run touches a corner exactly. Some may be missing: poses at corners, and those
    from which a disc robot touches the arc round a corner, because the boundary has chords in its
    place.

    **Arguments:**

    - `headings`: robots start with a heading `2 pi k / headings`; an even number.
    - `angles`: the bouncing angles in radians, of which each is a rational part of a full turn.
    - `place`, `heading`: the start of each robot, in metres and radians, in the free space.
    - `made`: one more sequence of turns for each robot, in radians, which is compared too.

    A robot in a room of 5 m by 1 m starts East or West, and turns by 90 degrees at each bump. The
    room looks the same from the opposite pose:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import space, walls
        >>> boundary = walls.Boundary.of(space.Workspace([(0, 0), (5, 0), (5, 1), (0, 1)]))
        >>> start = np.array([[2.0, 0.3]]), np.array([0.0])
        >>> alike = walls.alike_poses(boundary, 2, [math.radians(90)], *start)
        >>> boundary.point(alike.poses.wall, alike.poses.begin).round(3).tolist()
        [[5.0, 0.3], [0.0, 0.7]]
        >>> alike.extent.round(3).tolist()
        [5.016]
    """
    count, robots = len(angles), np.arange(len(place))
    length = max(n for n in range(1, _TURNS + 1) if n == 1 or count**n <= _SEQUENCES)
    parts = [Fraction(angle / math.tau).limit_denominator(_LARGEST_DENOMINATOR) for angle in angles]
    slices = math.lcm(headings, *(part.denominator for part in parts))
    first = _Runs.of(boundary, place[None], heading[None])
    levels = [first]
    for _ in range(length):
        levels.append(levels[-1].turned(boundary, np.array(angles)[:, None]))
    own = [first]
    for turn in [] if made is None else made.T:
        own.append(own[-1].turned(boundary, turn[None]))
    runs = _Runs(*map(np.concatenate, zip(*levels, *own[1:], strict=True)))

    chords = Chords.of(boundary, slices, known=True)
    equal = _EQUAL * boundary.tolerance
    least = first.length[0][:, None] - equal
    starts = [arrivals(chords, everywhere(chords), run) for run in least]
    starts = [start.take(start.slice % (slices // headings) == 0) for start in starts]
    robot = np.repeat(robots, [start.wall.size for start in starts])
    poses = WallSet(robot, *map(np.concatenate, zip(*(start[1:] for start in starts), strict=True)))
    for sequence in range(count**length):
        nodes = [sequence // count**k for k in reversed(range(length))]
        shifts = [int(parts[node % count] * slices) for node in nodes]
        expected = [level.length[node] for level, node in zip(levels[1:], nodes, strict=True)]
        poses = _with_equal_runs(chords, poses, shifts, expected)

    inside = _INSIDE * boundary.tolerance
    wide = poses.end - poses.begin > 2 * inside
    middle = (poses.begin + poses.end) / 2
    tried = [np.where(wide, poses.begin + inside, middle), middle]
    tried += [np.where(wide, poses.end - inside, middle)]
    same = np.stack([runs.equal(boundary, slices, poses, arc) for arc in tried])
    whole = same.all(axis=0)
    found = [poses._replace(begin=tried[0], end=tried[2]).take(np.flatnonzero(whole))]
    found += [
        poses._replace(begin=arc, end=arc).take(one & ~whole)
        for arc, one in zip(tried, same, strict=True)
    ]
    wall, arc, _ = run_to_wall(boundary, place, heading)
    slice_ = np.round(heading * slices / math.tau).astype(int) % slices
    found += [WallSet(robots, slice_, wall, arc, arc)]
    poses = WallSet(*map(np.concatenate, zip(*found, strict=True))).joined()

    shape = robots.size, len(runs.end), 2
    low, high = np.full(shape, np.inf), np.full(shape, -np.inf)
    for arc in (poses.begin, poses.end):
        ends = runs.moved(boundary, runs.end, slices, poses, arc).swapaxes(0, 1)
        np.minimum.at(low, poses.robot, ends)
        np.maximum.at(high, poses.robot, ends)
    return Alike(length, poses, np.linalg.norm(high - low, axis=2).min(axis=1))


class _Runs(NamedTuple):
    """Runs of robots after sequences of turns. The first sequence has no turn."""

    start: Float[np.ndarray, "sequences robots 2"]
    heading: Float[np.ndarray, "sequences robots"]
    length: Float[np.ndarray, "sequences robots"]
    end: Float[np.ndarray, "sequences robots 2"]
    incidence: Float[np.ndarray, "sequences robots"]
    "The sine of the angle between the run and the wall at its end."
    clear: Bool[np.ndarray, "sequences robots"]
    "True if the run meets no arc round a corner and passes none so near that chords may hide it."

    @classmethod
    def of(
        cls,
        boundary: Boundary,
        start: Float[np.ndarray, "sequences robots 2"],
        heading: Float[np.ndarray, "sequences robots"],
    ) -> "_Runs":
        wall, arc, length = run_to_wall(boundary, start.reshape(-1, 2), heading.ravel())
        into = -boundary.normal[wall].reshape(start.shape)
        incidence = np.cos(heading) * into[..., 0] + np.sin(heading) * into[..., 1]
        end = boundary.point(wall, arc).reshape(start.shape)
        round_ = np.flatnonzero(boundary.bulge)
        ends = boundary.begin[round_], boundary.begin[boundary.following[round_]]
        arcs = shapely.multilinestrings(shapely.linestrings(np.stack(ends, axis=1)))
        shapely.prepare(arcs)
        ways = shapely.linestrings(np.stack([start, end], axis=-2))
        clear = ~shapely.dwithin(arcs, ways, boundary.bulge.max())
        return cls(start, heading, length.reshape(heading.shape), end, incidence, clear)

    def turned(self, boundary: Boundary, turns: Float[np.ndarray, "turns robots"]) -> "_Runs":
        """Continue each sequence by each turn, in radians."""
        heading = (self.heading[:, None] + turns).reshape(-1, self.heading.shape[1])
        return _Runs.of(boundary, np.repeat(self.end, len(turns), axis=0), heading)

    def moved(
        self,
        boundary: Boundary,
        point: Float[np.ndarray, "sequences robots 2"],
        slices: int,
        poses: WallSet,
        arc: Float[np.ndarray, "poses"],
    ) -> Float[np.ndarray, "sequences poses 2"]:
        """Rotate and translate points so that the first run of the robot ends in another pose."""
        by = poses.slice * math.tau / slices - self.heading[0, poses.robot]
        x, y = np.moveaxis((point - self.end[0])[:, poses.robot], 2, 0)
        turned = np.stack(
            [np.cos(by) * x - np.sin(by) * y, np.sin(by) * x + np.cos(by) * y], axis=2
        )
        return boundary.point(poses.wall, arc) + turned

    def equal(
        self, boundary: Boundary, slices: int, poses: WallSet, arc: Float[np.ndarray, "poses"]
    ) -> Bool[np.ndarray, "poses"]:
        """Check for each pose whether all runs from it are as long as those of the robot."""
        if not arc.size:
            return np.zeros(0, bool)
        by = poses.slice * math.tau / slices - self.heading[0, poses.robot]
        start = self.moved(boundary, self.start, slices, poses, arc)
        heading, expected = self.heading[:, poses.robot] + by, self.length[:, poses.robot]
        found = _Runs.of(boundary, start, heading)
        back = _Runs.of(boundary, found.end[:1], heading[:1] + math.pi)
        # A difference across a run appears at a wall that the run grazes as a longer one along it.
        longest = _EQUAL * boundary.tolerance / found.incidence
        equal = found.clear & self.clear[:, poses.robot]
        equal &= np.abs(found.length - expected) <= longest
        return equal.all(axis=0) & (back.length[0] >= expected[0] - longest[0])


def _with_equal_runs(
    chords: Chords,
    poses: WallSet,
    shifts: Sequence[int],
    runs: Sequence[Float[np.ndarray, "robots"]],
) -> WallSet:
    """Reduce sets of poses to those from which turns by `shifts` slices lead to the given runs."""
    begin, end = poses.begin, poses.end
    source = np.arange(begin.size)
    # The current place of a robot is an affine function of its first place.
    equal = _EQUAL * chords.boundary.tolerance
    slice_, wall, base, slope = poses.slice, poses.wall, np.zeros(begin.size), np.ones(begin.size)
    for shift, run in zip(shifts, runs, strict=True):
        slice_ = (slice_ + shift) % chords.slices
        ends = np.sort([base + slope * begin, base + slope * end], axis=0)
        now = WallSet(source, slice_, wall, ends[0], ends[1])
        one, row = overlapping(chords, now)
        source, slice_, base, slope = source[one], slice_[one], base[one], slope[one]
        begin, end = _between(
            begin[one], end[one], base, slope, chords.begin[row], chords.end[row], equal
        )
        constant, factor = chords.clearance[:, row] / chords.sine[1, row]
        length = run[poses.robot[source]]
        begin, end = _between(
            begin, end, constant + factor * base, factor * slope, length, length, equal
        )
        arc, ahead = chords.arc[0, :, row].T
        wall, base, slope = chords.hit[row], arc + ahead * base, ahead * slope
        parts = (source, slice_, wall, base, slope, begin, end)
        # At a corner, several rows describe the same run.
        _, kept = np.unique(np.round(parts, 6)[:, begin <= end], axis=1, return_index=True)
        kept = np.flatnonzero(begin <= end)[kept]
        source, slice_, wall, base, slope, begin, end = (part[kept] for part in parts)
    return poses.take(source)._replace(begin=begin, end=end).joined()


def _between(
    begin: Float[np.ndarray, "parts"],
    end: Float[np.ndarray, "parts"],
    base: Float[np.ndarray, "parts"],
    slope: Float[np.ndarray, "parts"],
    low: Float[np.ndarray, "parts"],
    high: Float[np.ndarray, "parts"],
    equal: float,
) -> tuple[Float[np.ndarray, "parts"], Float[np.ndarray, "parts"]]:
    """Reduce intervals to the places `p` where `base + slope * p` is between `low` and `high`.

    Both the places and the bounds are equal to within `equal`, in metres. An interval without such
    a place ends before it begins.
    """
    level = np.abs(slope) < 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.sort([(low - equal - base) / slope, (high + equal - base) / slope], axis=0)
    bounds += [[-equal], [equal]]
    possible = (base >= low - equal) & (base <= high + equal)
    bounds[:, level] = np.where(possible[level], [[-np.inf], [np.inf]], [[np.inf], [-np.inf]])
    return np.maximum(begin, bounds[0]), np.minimum(end, bounds[1])
