"""The walls of a room as segments, and the straight runs of robots between them."""

import dataclasses
import functools

import numpy as np
import shapely
from jaxtyping import Float, Int

from ..space import Workspace
from ..space.workspace import edges


# The tolerance of intersections in metres, which is larger than any rounding error.
ROUNDING = 1e-11
# The largest number of pairs of a ray and a wall that are computed together.
_CHUNK = 1_000_000
# The incidence above which a robot slides along its wall before it feels the bump, in radians.
_GRAZING = np.radians(80)


@dataclasses.dataclass(frozen=True, eq=False)
class Boundary:
    """The walls of the free space of a room. The free space lies to the left of each wall."""

    begin: Float[np.ndarray, "walls 2"]
    "The corner where each wall begins, in metres."
    tangent: Float[np.ndarray, "walls 2"]
    "The unit vector along each wall, from its start to its end."
    length: Float[np.ndarray, "walls"]
    "The length of each wall, in metres."
    following: Int[np.ndarray, "walls"]
    "The index of the next wall, which begins where this wall ends."

    @classmethod
    def of(cls, workspace: Workspace) -> "Boundary":
        """Build the boundary of the region where the centre of a disc robot can be."""
        before, begin, end = edges(workspace.free_space.simplify(0)).swapaxes(0, 1)
        along = end - begin
        length = np.linalg.norm(along, axis=1)
        # The walls of a ring are consecutive, so a new ring begins at a wall that does not continue
        # the wall before it.
        number = np.arange(len(begin))
        first = np.r_[True, (before[1:] != begin[:-1]).any(axis=1)]
        ring_begin = np.maximum.accumulate(np.where(first, number, 0))
        last = np.r_[first[1:], True]
        following = np.where(last, ring_begin, number + 1).astype(np.int32)
        return cls(begin, along / length[:, None], length, following)

    @functools.cached_property
    def normal(self) -> Float[np.ndarray, "walls 2"]:
        """The unit vector from each wall into the free space."""
        return np.stack([-self.tangent[:, 1], self.tangent[:, 0]], axis=1)

    @functools.cached_property
    def preceding(self) -> Int[np.ndarray, "walls"]:
        """The index of the previous wall, which ends where this wall begins."""
        return np.argsort(self.following)

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
    wall, or grazes a corner, drives on. Places are in metres, in the free space or on a wall, and
    headings in radians.

    Returns the number of the wall that each robot meets, the arc length on it, and the length of
    the run, in metres.
    """
    wall = np.zeros(len(place), np.int32)
    arc, run = np.zeros(len(place)), np.full(len(place), np.inf)
    size = max(1, _CHUNK // len(boundary.length))
    for k in range(0, len(place), size):
        part = slice(k, k + size)
        ahead = np.stack([np.cos(heading[part]), np.sin(heading[part])], axis=1)
        offset = place[part, None] - boundary.begin
        facing = -ahead @ boundary.normal.T
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (offset * boundary.normal).sum(axis=2) / facing
            at = (offset * boundary.tangent).sum(axis=2) + far * (ahead @ boundary.tangent.T)
        met = (facing > 1e-12) & (far >= -1e-9) & (at >= -1e-9) & (at <= boundary.length + 1e-9)
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
