"""What a recording keeps of a robot that drives: where it was, and what was logged of it."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int32

from ..canvas.palette import Color


# Seconds between two poses that are kept.
_INTERVAL = 0.1
# A robot that is so many metres from where it made an observation is on its next step.
_OFF = 0.01
# A trail has so many corners at most; a run of n steps would else take n^2 points.
_MAX_CORNERS = 100
NOWHERE = np.empty(0, np.int32)
_NO_TRAIL = np.empty((0, 2))


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRobot:
    """A robot in the recording of a run."""

    name: str = "robot"
    start: Sequence[float] | None = None
    "Where its odometry begins, if that is known: x and y in metres, the heading in radians."
    trace: Sequence[tuple[float, float, float, float]] | None = None
    """Its time in seconds and its true pose, again and again: a list that grows while the robot
    drives, as that of an emulated one. `None` where nobody knows the truth."""
    radius: float = 0.0
    "The radius of its body in metres; that of a point is not drawn."
    touches: Sequence[tuple[float, float, float]] | None = None
    """Time in seconds, x and y of each touch of a wall, in the order of time: a list that grows.
    `None` where touches are not known."""


@dataclasses.dataclass(eq=False)
class Track:
    """A robot in a recording, and what was logged of it."""

    about: RecordedRobot
    color: Color
    observed: int = 0
    read: int = 0
    "How many entries of its trace were read."
    last: tuple[float, float, float, float] | None = None
    "The last of them."
    logged: float = -math.inf
    "The time of the last pose that was logged."
    place: Float[np.ndarray, "2"] | None = None
    "Where it made its last observation, as long as it is there."
    scalars: dict[str, int | float] = dataclasses.field(default_factory=dict)
    "The numbers that were logged last."
    trail: Float[np.ndarray, "corners 2"] = dataclasses.field(default_factory=lambda: _NO_TRAIL)
    believed: Float[np.ndarray, "corners 2"] = dataclasses.field(default_factory=lambda: _NO_TRAIL)
    cells: Int32[np.ndarray, "belief"] = dataclasses.field(default_factory=lambda: NOWHERE)

    def follow(self) -> tuple[Float[np.ndarray, "poses 4"], Int32[np.ndarray, "poses"]]:
        """The poses to log since the last time, and the observation that each belongs to."""
        new = list(self.about.trace[self.read :]) if self.about.trace is not None else []
        self.read += len(new)
        if not new:
            return np.empty((0, 4)), NOWHERE
        self.last = new[-1]
        if self.place is None and self.observed == 0:
            self.place = np.array(new[0][1:3])
        poses = np.array(new, float)
        kept = []
        for index, time in enumerate(poses[:, 0].tolist()):
            if time >= self.logged + _INTERVAL or index == len(poses) - 1:
                self.logged = time
                kept.append(index)
        poses = poses[kept]
        # The turn after a bump, which is part of the observation, does not move the robot.
        observation = np.full(len(poses), self.observed + 1, np.int32)
        if self.place is not None:
            off = np.hypot(*(poses[:, 1:3] - self.place).T) > _OFF
            off = np.logical_or.accumulate(off)
            observation[~off] = self.observed
            if off[-1]:
                self.place = None
        return poses, observation

    def touched(
        self, times: Float[np.ndarray, "poses"]
    ) -> tuple[Float[np.ndarray, "touches 2"], Int32[np.ndarray, "poses"]]:
        """Find the last touch of a wall in the interval before each time, if any.

        **Returns:** the places of these touches, and for each time their number, 0 or 1.
        """
        touches = np.array(self.about.touches or (), float).reshape(-1, 3)
        last = np.searchsorted(touches[:, 0], times, side="right") - 1
        there = (last >= 0) & (times - touches[last, 0] < _INTERVAL) if len(touches) else last >= 0
        return touches[last[there], 1:], there.astype(np.int32)

    def observe(self) -> None:
        """Count an observation, made where the robot was last seen."""
        self.observed += 1
        self.place = None if self.last is None else np.array(self.last[1:3])

    def seconds(self, fields: Mapping[str, Any]) -> float:
        """The time of an event: the robot's own, where it has one."""
        return float(fields.get("seconds", 0.0)) if self.last is None else self.last[0]

    def estimated(self, estimate: Sequence[float]) -> Float[np.ndarray, "2"]:
        """Where its odometry has it, in metres, from how far ahead and left of its start it is."""
        x, y, theta = self.about.start or (0.0, 0.0, 0.0)
        place = complex(x, y) + complex(*estimate[:2]) * complex(math.cos(theta), math.sin(theta))
        return np.array([place.real, place.imag])


def longer_trail(
    old: Float[np.ndarray, "old 2"], new: Float[np.ndarray, "new 2"]
) -> Float[np.ndarray, "corners 2"]:
    """The corners of a trail that goes on."""
    trail = np.concatenate([old, new])
    if len(trail) < 2:
        return trail
    line = shapely.simplify(shapely.LineString(trail), _OFF / 2, preserve_topology=False)
    return shapely.get_coordinates(line)[-_MAX_CORNERS:]
