"""The walls of a room as segments, and the straight runs of robots between them.

All decisions about places and headings on walls have one tolerance, `Boundary.tolerance`, a length.
It is ten units of the grid to which vertices are rounded, and at least a nanometre. A vertex is
rounded by less than a unit, and walls that lie within two units of a line are joined. So the start
of a run and the wall at its end differ from their true places by less than ten units together. An
angle is compared by the length that it covers: a wall of length `L` may be turned by twice the
tolerance over `L`, and a heading by the tolerance over the diameter of the room. A decision that
drops a place holds for every true place within the tolerance, so that rounding loses no robot.
Chords of arcs add the distance and the angle between chord and arc. Numbers of slices of headings
are compared to 10^-9 of a slice, more than the rounding of sums of angles.
"""

import dataclasses
import functools
import math

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..base.shown import Shown
from ..space import Workspace
from ..space.workspace import coordinate_rounding, edges


# The least tolerance in metres, for robots whose runs are known to a nanometre.
_LEAST = 1e-9
# The largest number of pairs of a ray and a wall that are computed together.
_CHUNK = 1_000_000
# The incidence above which a robot slides along its wall before it feels the bump, in radians.
_GRAZING = np.radians(80)


@dataclasses.dataclass(frozen=True, eq=False)
class Boundary(Shown):
    """The walls of the free space of a room. The free space lies to the left of each wall.

    The centre of a disc robot moves round a corner on an arc, which chords replace.
    """

    begin: Float[np.ndarray, "walls 2"]
    "The corner where each wall begins, in metres."
    tangent: Float[np.ndarray, "walls 2"]
    "The unit vector along each wall, from its start to its end."
    length: Float[np.ndarray, "walls"]
    "The length of each wall, in metres."
    following: Int[np.ndarray, "walls"]
    "The index of the next wall, which begins where this wall ends."
    bulge: Float[np.ndarray, "walls"]
    "The largest distance in metres from each wall to the arc that it replaces; 0 without an arc."
    bend: Float[np.ndarray, "walls"]
    "The largest angle between each wall and the arc that it replaces, in radians."
    tolerance: float
    "The length in metres that covers the rounding of coordinates."

    @classmethod
    def of(cls, workspace: Workspace) -> "Boundary":
        """Build the boundary of the region where the centre of a disc robot can be."""
        unit = coordinate_rounding(workspace.boundary, workspace.obstacles)
        tolerance, radius = max(_LEAST, 10 * unit), workspace.robot_radius
        before, begin, end = edges(workspace.free_space.simplify(2 * unit)).swapaxes(0, 1)
        along = end - begin
        length = np.linalg.norm(along, axis=1)
        # The walls of a ring are consecutive, so a new ring begins at a wall that does not continue
        # the wall before it.
        number = np.arange(len(begin))
        first = np.r_[True, (before[1:] != begin[:-1]).any(axis=1)]
        ring_begin = np.maximum.accumulate(np.where(first, number, 0))
        last = np.r_[first[1:], True]
        following = np.where(last, ring_begin, number + 1).astype(np.int32)
        walls = begin, along / length[:, None], length, following
        nearest = shapely.shortest_line(
            shapely.points((begin + end) / 2), workspace.environment.boundary
        )
        corner = shapely.get_coordinates(nearest)[1::2]
        across = walls[1][:, 0] * (corner - begin)[:, 1] - walls[1][:, 1] * (corner - begin)[:, 0]
        bulge = radius - np.abs(across)
        bend = np.arccos(np.clip(np.abs(across) / radius, 0.0, 1.0)) if radius else 0.0
        round_ = bulge > tolerance
        return cls(*walls, np.where(round_, bulge, 0.0), np.where(round_, bend, 0.0), tolerance)

    @functools.cached_property
    def normal(self) -> Float[np.ndarray, "walls 2"]:
        """The unit vector from each wall into the free space."""
        return np.stack([-self.tangent[:, 1], self.tangent[:, 0]], axis=1)

    @functools.cached_property
    def preceding(self) -> Int[np.ndarray, "walls"]:
        """The index of the previous wall, which ends where this wall begins."""
        return np.argsort(self.following)

    @functools.cached_property
    def lean(self) -> Float[np.ndarray, "walls"]:
        """The largest angle between each wall and the true wall that it replaces, in radians."""
        return self.bend + 2 * self.tolerance / self.length

    @functools.cached_property
    def convex(self) -> Bool[np.ndarray, "walls"]:
        """True if the free space at the begin of each wall surely has an angle below pi."""
        before = self.preceding
        sine = (self.tangent * self.normal[before]).sum(axis=1)
        return sine > self.lean + self.lean[before]

    @functools.cached_property
    def bounding(self) -> Int[np.ndarray, "walls"]:
        """The wall that bounds, with each wall, the free space at the point where the wall begins.

        It is the previous wall, or that of another corner if several corners meet in the point.
        """
        before = self.preceding.copy()
        _, at, count = np.unique(self.begin, axis=0, return_inverse=True, return_counts=True)
        for wall in np.flatnonzero(count[at] > 1):
            others = self.preceding[at == at[wall]]
            cosine, sine = (
                -np.array([self.tangent[wall], self.normal[wall]]) @ self.tangent[others].T
            )
            before[wall] = others[np.argmin(np.arctan2(sine, cosine) % math.tau)]
        return before

    @functools.cached_property
    def diameter(self) -> float:
        """The diagonal of the bounding box of all walls, in metres."""
        return float(np.linalg.norm(np.ptp(self.begin, axis=0)))

    def point(
        self, wall: Int[np.ndarray, "points"], arc: Float[np.ndarray, "points"]
    ) -> Float[np.ndarray, "points 2"]:
        """Compute the points at arc lengths on walls, in metres."""
        return self.begin[wall] + arc[:, None] * self.tangent[wall]


def run_to_wall(
    boundary: Boundary, place: Float[np.ndarray, "robots 2"], heading: Float[np.ndarray, "robots"]
) -> tuple[Int[np.ndarray, "robots"], Float[np.ndarray, "robots"], Float[np.ndarray, "robots"]]:
    """Drive robots straight until each robot meets a wall.

    The run of a robot that stands at a wall and faces it has length 0. A robot that drives along a
    wall, or grazes a corner, drives on: it ends at a corner only if both of its walls face the
    robot, or if the free space has an angle below pi there. Places are in metres, in the free space
    or on a wall, and headings in radians.

    Returns the number of the wall that each robot meets, the arc length on it, and the length of
    the run, in metres.
    """
    wall = np.zeros(len(place), np.int32)
    arc, run = np.zeros(len(place)), np.full(len(place), np.inf)
    size = max(1, _CHUNK // len(boundary.length))
    parallel, near = boundary.lean - boundary.bend, 4 * boundary.tolerance
    before = boundary.bounding
    after = np.argsort(before)
    open_ = (boundary.tangent * boundary.normal[before]).sum(axis=1) < 0
    for k in range(0, len(place), size):
        part = slice(k, k + size)
        ahead = np.stack([np.cos(heading[part]), np.sin(heading[part])], axis=1)
        offset = place[part, None] - boundary.begin
        facing = -ahead @ boundary.normal.T
        with np.errstate(divide="ignore", invalid="ignore"):
            apart = (offset * boundary.normal).sum(axis=2)
            far = apart / facing
            at = (offset * boundary.tangent).sum(axis=2) + far * (ahead @ boundary.tangent.T)
        faced = facing > parallel
        met = faced & (apart >= -near) & (at >= -near) & (at <= boundary.length + near)
        robot, hit = np.nonzero(met & ((at <= near) | (at >= boundary.length - near)))
        first = at[robot, hit] <= near
        corner, other = np.where(first, [hit, before[hit]], [after[hit], after[hit]])
        passes = open_[corner] & ~faced[robot, other]
        met[robot[passes], hit[passes]] = False
        far = np.where(met, far, np.inf)
        nearest = far.argmin(axis=1)
        robots = np.arange(len(nearest))
        wall[part], run[part] = nearest, np.maximum(far[robots, nearest], 0.0)
        arc[part] = np.clip(at[robots, nearest], 0.0, boundary.length[nearest])
    return wall, arc, run


def bump_gains(
    boundary: Boundary,
    wall: Int[np.ndarray, "robots"],
    heading: Float[np.ndarray, "robots"],
    bump_turn: float | Float[np.ndarray, "robots"],
) -> tuple[Float[np.ndarray, "robots"], Float[np.ndarray, "robots"]]:
    """Compute the angle by which a bump turns each robot toward its wall.

    `heading` is the heading of the run to the wall, and `bump_turn` the angle at 45 degrees of
    incidence. At an incidence `i` the angle is `bump_turn sin(2 i)`. Above 80 degrees, it is
    between this value and `bump_turn`, because the robot slides along the wall before the bump.

    Returns both limits of the angle in radians, counter-clockwise; up to 80 degrees they are equal.
    On an arc, they are those of the chord.
    """
    if not np.any(bump_turn):
        return np.zeros(heading.shape), np.zeros(heading.shape)
    into = np.arctan2(-boundary.normal[wall, 1], -boundary.normal[wall, 0])
    incidence = np.remainder(into - heading + np.pi, 2 * np.pi) - np.pi
    gain = bump_turn * np.sin(2 * incidence)
    grazing = np.abs(incidence) > _GRAZING
    return gain, np.where(grazing, bump_turn * np.sign(incidence), gain)


def places_anywhere(
    workspace: Workspace, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "count 2"]:
    """Draw places uniformly from the free space, in metres."""
    free = workspace.free_space
    shapely.prepare(free)
    low, high = np.reshape(free.bounds, (2, 2))
    drawn: list[np.ndarray] = []
    missing = count
    while missing > 0:
        tried = rng.uniform(low, high, (2 * missing + 16, 2))
        drawn.append(tried[shapely.contains_xy(free, tried)][:missing])
        missing -= len(drawn[-1])
    return np.concatenate(drawn)
