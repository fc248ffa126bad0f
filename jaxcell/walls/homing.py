"""Choose an angle at each bump, so that a robot with an unknown start reaches a goal region."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.shown import Shown
from ..space.copies import copies
from .boundary import run_to_wall
from .choice import choose_angles
from .filter import WallFilter
from .sets import WallSet


# The largest length in metres of the parts of walls for which the bumps to the goal are counted.
_PART = 0.2
# The largest number of slices of headings for which bumps are counted, if it divides that of the
# filter.
_SLICES = 72
# The number of simulated robots from each part of a wall, for each slice of headings.
_DRIVEN = 4
# The largest expected number of bumps. It replaces larger numbers and infinity.
_NEVER = 100.0


@dataclasses.dataclass(frozen=True, eq=False)
class Homing(Shown):
    """Navigation into a goal region, which is a disc, for robots whose start is unknown.

    Walls are divided into parts of at most 20 cm, and the expected number of bumps to the goal is
    computed for each part and each heading. A robot turns by the angle that minimizes the mean of
    this number over its set of possible places. While the set is large, the robot turns by the
    angle after which the set is expected to be smallest.
    """

    filter: WallFilter
    goal: tuple[float, float]
    "The centre of the region, in metres."
    radius: float
    "The radius of the region, in metres."
    angles: tuple[float, ...]
    "The bouncing angles to choose from, in radians."

    def __post_init__(self) -> None:
        if not self.angles:
            raise ValueError("bounces: expected at least one angle")
        if not self.arrived_parts.any():
            x, y = self.goal
            raise ValueError(
                f"goal: no wall lies within {self.radius:g} m of ({x:g} m, {y:g} m) for at least "
                f"{_PART:g} m, and a robot stops only at walls; expected a larger radius, or a "
                "place near a wall"
            )

    @functools.cached_property
    def parts(self) -> tuple[Int[np.ndarray, "parts"], Float[np.ndarray, "2 parts"]]:
        """The wall of each part, and the arc lengths of its two ends, in metres."""
        wall, number = copies(self._count)
        size = (self.filter.boundary.length / self._count)[wall]
        return wall, np.stack([number * size, (number + 1) * size])

    @functools.cached_property
    def _count(self) -> Int[np.ndarray, "walls"]:
        return np.ceil(self.filter.boundary.length / _PART).astype(int)

    @functools.cached_property
    def arrived_parts(self) -> Bool[np.ndarray, "parts"]:
        """True for each part of a wall that lies within the goal."""
        wall, ends = self.parts
        return self._within(wall, ends[0]) & self._within(wall, ends[1])

    @functools.cached_property
    def slices(self) -> int:
        """The number of slices of headings that `bumps` distinguishes."""
        own = self.filter.chords.slices
        return own if own <= _SLICES or own % _SLICES else _SLICES

    @functools.cached_property
    def bumps(self) -> Float[np.ndarray, "slices parts"]:
        """The expected number of bumps to the goal from each part of a wall, for each heading."""
        return self.bumps_by(self.angles)

    @functools.cached_property
    def _image(self) -> Int[np.ndarray, "driven states"]:
        """The slice and the part after simulated runs from each slice and part, as one number."""
        boundary, rng = self.filter.boundary, np.random.default_rng(0)
        wall, ends = self.parts
        slice_, part = np.indices((self.slices, wall.size)).reshape(2, -1)
        known = self.filter.chords.width == 0
        image = np.empty((_DRIVEN, slice_.size), np.int64)
        for k in range(_DRIVEN):
            share = (k + rng.uniform(size=slice_.size)) / _DRIVEN
            arc = ends[0, part] + share * (ends[1] - ends[0])[part]
            within = 0.0 if known else rng.uniform(size=slice_.size)
            place = boundary.point(wall[part], arc)
            heading = (slice_ + within) * 2 * np.pi / self.slices
            hit, at, _ = run_to_wall(boundary, place, heading)
            image[k] = slice_ * wall.size + self.part_at(hit, at)
        return image

    def bumps_by(self, angles: Sequence[float]) -> Float[np.ndarray, "slices parts"]:
        """Compute `bumps` for other angles, in radians."""
        image, shifts = self._image, self._shifts(angles)
        leaving = np.full((self.slices, self.parts[0].size), _NEVER)
        for _ in range(int(_NEVER)):
            arriving = np.min([np.roll(leaving, -shift, axis=0) for shift in shifts], axis=0)
            arriving[:, self.arrived_parts] = 0.0
            mean = arriving.ravel()[image].mean(axis=0).reshape(leaving.shape)
            after = np.minimum(1 + mean, _NEVER)
            if np.abs(after - leaving).max() < 1e-3:
                break
            leaving = after
        return leaving

    def _shifts(self, angles: Sequence[float]) -> list[int]:
        return [round(angle * self.slices / (2 * np.pi)) for angle in angles]

    def expected(
        self, place: Float[np.ndarray, "robots 2"], heading: Float[np.ndarray, "robots"]
    ) -> Float[np.ndarray, "robots"]:
        """Compute the expected bumps to the goal of robots that know their poses at each bump.

        Robots start at places in metres with headings in radians. The number is infinite if it is
        about 100 or larger.
        """
        wall, arc, _ = run_to_wall(self.filter.boundary, place, heading)
        part = self.part_at(wall, arc)
        slice_ = np.floor(heading * self.slices / (2 * np.pi) + 1e-6).astype(int)
        after = [
            self.bumps[(slice_ + shift) % self.slices, part] for shift in self._shifts(self.angles)
        ]
        more = np.where(self.arrived_parts[part], 0.0, np.min(after, axis=0))
        return np.where(more < 0.99 * _NEVER, 1 + more, np.inf)

    def part_at(
        self, wall: Int[np.ndarray, "places"], arc: Float[np.ndarray, "places"]
    ) -> Int[np.ndarray, "places"]:
        """Find the part of a wall that contains each place; `arc` is its arc length in metres."""
        count = self._count[wall]
        number = (arc * count / self.filter.boundary.length[wall]).astype(int)
        first = np.cumsum(self._count) - self._count
        return first[wall] + np.minimum(number, count - 1)

    def _within(
        self, wall: Int[np.ndarray, "places"], arc: Float[np.ndarray, "places"]
    ) -> Bool[np.ndarray, "places"]:
        place = self.filter.boundary.point(wall, arc)
        return np.hypot(*(place - np.array(self.goal)).T) <= self.radius

    def choose(
        self, state: WallSet, robots: int, rng: np.random.Generator
    ) -> Int[np.ndarray, "robots"]:
        """Choose the next angle of each robot, and return its index in `angles`.

        The angle minimizes the expected number of bumps if the extent of the robot's set is at most
        the radius of the goal, and a quarter of the diameter of the room. Otherwise it minimizes
        the expected size of the set, because the best angles for the mean of several places may
        repeat without end.
        """
        arcs = [state.begin + share * (state.end - state.begin) for share in (0.0, 0.5, 1.0)]
        weight = state.end - state.begin + 1e-3
        wide = self.filter.chords.slices // self.slices
        expected = np.zeros((len(self.angles), robots))
        for k, shift in enumerate(self._shifts(self.angles)):
            after = (state.slice // wide + shift) % self.slices
            bumps = np.mean(
                [self.bumps[after, self.part_at(state.wall, arc)] for arc in arcs], axis=0
            )
            expected[k] = np.bincount(state.robot, bumps * weight, robots)
        chosen = expected.argmin(axis=0)
        largest = min(self.radius, self.filter.boundary.diameter / 4)
        large = self.filter.extent(state, robots) > largest
        lost = np.flatnonzero(large)
        if lost.size:
            number = np.full(robots, -1)
            number[lost] = np.arange(lost.size)
            part = state.take(number[state.robot] >= 0)
            part = part._replace(robot=number[part.robot])
            chosen[lost] = choose_angles(self.filter, part, lost.size, self.angles, rng)
        return chosen
