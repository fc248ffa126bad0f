import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int32

from ..canvas.marks import MAX_CORNERS
from ..canvas.palette import Color


# Seconds between two logged poses.
_INTERVAL = 0.1
# A robot has begun its next step at this distance from the last observation, in metres.
_OFF = 0.01
NOWHERE = np.empty(0, np.int32)
_NO_TRAIL = np.empty((0, 2))


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRobot:
    """A robot in the recording of a run."""

    name: str = "robot"
    start: Sequence[float] | None = None
    "The start of the odometry: x and y in metres, the heading in radians; `None` if unknown."
    trace: Sequence[tuple[float, float, float, float]] | None = None
    """Time in seconds, x, y and heading of each true pose, for example of an emulated robot. The
    list grows while the robot drives; `None` if true poses are unknown."""
    radius: float = 0.0
    "The radius of the body in metres; with the radius 0 the body is not drawn."
    touches: Sequence[tuple[float, float, float]] | None = None
    """Time in seconds, x and y of each touch of a wall, ordered by time. The list grows while the
    robot drives; `None` if touches are unknown."""


@dataclasses.dataclass(eq=False)
class Track:
    """The state of a robot in a recording: its poses, and the last logged values."""

    about: RecordedRobot
    color: Color
    observed: int = 0
    read: int = 0
    "The number of entries of the trace that [`Track.follow`][] has read."
    last: tuple[float, float, float, float] | None = None
    "The last entry that was read from the trace."
    logged: float = -math.inf
    "The time of the last logged pose."
    place: Float[np.ndarray, "2"] | None = None
    "The position at the last observation; `None` once the robot has moved on from there."
    scalars: dict[str, int | float] = dataclasses.field(default_factory=dict)
    "The last logged number of each curve."
    trail: Float[np.ndarray, "corners 2"] = dataclasses.field(default_factory=lambda: _NO_TRAIL)
    believed: Float[np.ndarray, "corners 2"] = dataclasses.field(default_factory=lambda: _NO_TRAIL)
    cells: Int32[np.ndarray, "belief"] = dataclasses.field(default_factory=lambda: NOWHERE)

    def follow(self) -> tuple[Float[np.ndarray, "poses 4"], Int32[np.ndarray, "poses"]]:
        """Read new entries of the trace.

        **Returns:** the poses to log, with their times, and the number of the observation at the
        end of each pose's step; a turn belongs to the step before it.
        """
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
        # Poses of the turn after a bump belong to the observation of the bump.
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
        """Find, for each time, the last touch of a wall in the 0.1 seconds before, if any.

        **Returns:** the positions of these touches, and 1 for each time with a touch, 0 for others.
        """
        touches = np.array(self.about.touches or (), float).reshape(-1, 3)
        last = np.searchsorted(touches[:, 0], times, side="right") - 1
        there = (last >= 0) & (times - touches[last, 0] < _INTERVAL) if len(touches) else last >= 0
        return touches[last[there], 1:], there.astype(np.int32)

    def observe(self) -> None:
        """Count an observation, and store the position of the robot."""
        self.observed += 1
        self.place = None if self.last is None else np.array(self.last[1:3])

    def seconds(self, fields: Mapping[str, Any]) -> float:
        """Return the time of an event, from the trace if there is one, otherwise from `fields`."""
        return float(fields.get("seconds", 0.0)) if self.last is None else self.last[0]

    def estimated(self, estimate: Sequence[float]) -> Float[np.ndarray, "2"]:
        """Convert an estimate, in metres ahead and to the left of the start, to x and y."""
        x, y, theta = self.about.start or (0.0, 0.0, 0.0)
        place = complex(x, y) + complex(*estimate[:2]) * complex(math.cos(theta), math.sin(theta))
        return np.array([place.real, place.imag])


def longer_trail(
    old: Float[np.ndarray, "old 2"], new: Float[np.ndarray, "new 2"]
) -> Float[np.ndarray, "corners 2"]:
    """Add positions to a trail, and return the last corners of the trail, at most `MAX_CORNERS`."""
    trail = np.concatenate([old, new])
    if len(trail) < 2:
        return trail
    line = shapely.simplify(shapely.LineString(trail), _OFF / 2, preserve_topology=False)
    return shapely.get_coordinates(line)[-MAX_CORNERS:]
