import cmath
import math
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ..base.units import SAME_ANGLE
from ..space.strides import BEHIND, cell_strides as cell_strides
from .create.motion import Moved


@runtime_checkable
class Drivable(Protocol):
    """A robot that a walker can drive, such as a [`Create`][jaxcell.robot.create.motion.Create]."""

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        """Drive straight by a distance in metres, backward if negative. A bump ends the drive."""

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        """Turn in place by an angle in radians, counter-clockwise. A bump does not end the turn."""


class Walker:
    """A controller that drives a robot from cell to cell of a map with the odometry of its wheels.

    In the model of a bouncing robot (Alam 2018, Eq. 2.4), a robot is always at the centre of a
    cell. A step goes straight along the heading. After a free step the robot is at the centre of
    the cell where the step ended; this centre may lie off the line of the step. After a bump it is
    where the step began. Therefore the walker drives on to the centre of the cell after a step, and
    back to the start after a bump. A wall on the way to the centre counts as a bump as well.

    To drive to the centre, the walker must know the step in each direction, `strides`, and the
    heading at the start, for example from a compass. Without `strides` it needs no heading, and all
    steps have one length. Such steps agree with the model if all directions are along the axes;
    else they approximate it.

    Each target is a place in the frame of the odometry, so that each step corrects the error of the
    step before. Slip is not corrected, because the encoders do not sense it.

    A simulated robot in a corridor of three cells:

        >>> import math
        >>> from jaxcell import examples
        >>> walker = examples.walker()
        >>> walker.step(), walker.step(), walker.step(), walker.observations
        (False, False, True, '001')
        >>> walker.rotate(math.pi / 2)
        >>> [round(x, 2) for x in walker.place]
        [2.0, 0.0, 1.57]
    """

    observations: str
    "The observations so far: 0 for a step, 1 for a bump."
    recalled: str = ""
    "The observations of the earlier run that is resumed."
    drives: bool = True
    "True if the robot moves; false while the walker only counts the steps of an earlier run."

    def __init__(
        self,
        robot: Drivable,
        step: float,
        *,
        strides: Float[np.ndarray, "directions 2"] | None = None,
        direction: int = 0,
        recalled: str = "",
        tolerance: float | None = None,
        turn_tolerance: float = math.radians(0.4),
    ) -> None:
        """**Arguments:**

        - `robot`: a robot such as [`jaxcell.robot.Create`][].
        - `step`: the length of a step, in metres.
        - `strides`: the result of [`cell_strides`][], if the heading is known.
        - `direction`: with `strides`, the number of the robot's direction at the start.
        - `recalled`: the observations of the run to resume. The walker counts these steps without
            driving, because the robot already stands at the end of the last step, with the heading
            of the next step.
        - `tolerance`, `turn_tolerance`: the errors, in metres and radians by the encoders, up to
            which the walker corrects nothing. The default `tolerance` is 0.4 % of a step, but at
            least 1 mm (the shortest possible drive) and at most 4 mm.
        """
        if tolerance is None:
            tolerance = max(min(0.004, 0.004 * step), 0.001)
        positive = {"step": step, "tolerance": tolerance, "turn_tolerance": turn_tolerance}
        for name, value in positive.items():
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: expected a positive number, got {value}")
        if strides is not None and not 0 <= direction < len(strides):
            raise ValueError(f"direction: expected 0 to {len(strides) - 1}, got {direction}")
        self.observations, self.recalled, self.drives = "", recalled, not recalled
        self._robot, self._step, self._strides = robot, step, strides
        self._direction = direction
        self._tolerance, self._turn_tolerance = tolerance, turn_tolerance
        # In the frame of the odometry, the start is 0 and its heading is the real axis.
        self._at, self._facing = 0j, 0.0
        self._centre, self._heading = 0j, 0.0

    @property
    def estimate(self) -> tuple[float, float, float]:
        """The pose from the encoders: metres ahead and left of the start, and turn in radians."""
        return self._at.real, self._at.imag, self._facing

    @property
    def place(self) -> tuple[float, float, float]:
        """The pose in the model: metres ahead and left of the start, and the turn in radians."""
        return self._centre.real, self._centre.imag, self._heading

    @property
    def error(self) -> float:
        """The distance between the pose from the encoders and the pose in the model, in metres."""
        return abs(self._at - self._centre)

    def step(self) -> bool:
        """Drive a step, go back to its start after a bump, and return whether the robot bumped."""
        ahead = cmath.rect(1.0, self._heading)
        end = self._centre + self._step * ahead
        targets = [end]
        if self._strides is not None:
            forward, left = self._strides[self._direction].tolist()
            centre = self._centre + complex(forward, left) * ahead
            straight = abs(left) < 1e-9 and forward >= self._step - 1e-9
            targets = [centre] if straight else [end, centre]
        if len(self.observations) < len(self.recalled):
            # Count a step of the earlier run without driving.
            observation = self.recalled[len(self.observations)]
            if observation == "0":
                self._centre = self._at = targets[-1]
            self.observations += observation
            return observation == "1"
        self.drives = True
        bumped = False
        passed = [self._centre]
        for target in targets:
            bumped = self._go(target)
            if bumped:
                break
            passed.append(target)
        if bumped:
            # The robot returns on its own path, because it does not feel walls behind it.
            for place in reversed(passed):
                self._go(place, back=True)
        else:
            self._centre = targets[-1]
            self._face(self._heading)
        self.observations += "1" if bumped else "0"
        return bumped

    def run_to_wall(self, most: float, back: float = 0.0) -> float | None:
        """Drive straight until a bump, at most `most` metres, and back off by `back` metres.

        Returns the length of the run in metres by the encoders, or `None` if there was no bump.
        """
        self.drives = True
        moved = self._robot.forward(most, tolerance=self._tolerance)
        self._count(moved)
        if not moved.bumped:
            return None
        # A bumper that stays pressed would end the next run at once.
        if back > self._tolerance:
            self._count(self._robot.forward(-back, tolerance=self._tolerance))
        self._centre = self._at
        self.observations += "1"
        return moved.distance

    def rotate(self, angle: float) -> None:
        """Turn the heading by an angle in radians, counter-clockwise.

        **Raises:** `ValueError` if the heading is known, and the angle is not a multiple of the
        angle between two directions.
        """
        if self._strides is not None:
            count = len(self._strides)
            shift = angle * count / (2 * math.pi)
            if abs(shift - round(shift)) * math.tau / count > SAME_ANGLE:
                raise ValueError(
                    f"angle: {math.degrees(angle):g} deg is not a whole number of the {count} "
                    "directions"
                )
            self._direction = (self._direction + round(shift)) % count
        self._heading += angle
        self._face(self._heading)

    def _go(self, target: complex, *, back: bool = False) -> bool:
        """Drive to a point, in reverse if `back`, and return whether a bump ended the drive."""
        way = target - self._at
        if abs(way) < self._tolerance:
            return False
        bearing = cmath.phase(way)
        if back or abs(math.remainder(bearing - self._facing, math.tau)) > BEHIND:
            self._face(bearing + math.pi)
            return self._count(self._robot.forward(-abs(way), tolerance=self._tolerance))
        self._face(bearing)
        return self._count(self._robot.forward(abs(way), tolerance=self._tolerance))

    def _face(self, heading: float) -> None:
        if not self.drives:
            self._facing = heading
            return
        angle = math.remainder(heading - self._facing, math.tau)
        if abs(angle) > self._turn_tolerance:
            self._count(self._robot.turn(angle, tolerance=self._turn_tolerance))

    def _count(self, moved: Moved) -> bool:
        """Add a motion to the estimate of the pose, and return whether a bump ended the motion."""
        self._at += complex(moved.distance, moved.left) * cmath.rect(1.0, self._facing)
        self._facing += moved.angle
        return moved.bumped
