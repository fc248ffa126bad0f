"""Describe a Create 2 among the walls of a map in the format of MuJoCo."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...space import Workspace
from ...space.workspace import edges
from ..create.packets import WHEEL_BASE


RADIUS = 0.17425
"""The radius of the body with its bumper, in metres."""
WHEEL = 0.036
"""The radius of a wheel, in metres."""
LATENCY = 0.015
"""The seconds from a command to its effect: one period of the robot's sensors."""
DAMPING = 60.0
"""The damping of the springs of the bumper, in N s/m."""

# The distance in metres by which the shell can be pushed in from the front until the chassis stops
# it. From the sides it is half of this.
_TRAVEL = 0.008
# Half the thickness of a wall in metres. The side toward the robot lies on the map.
_THIN = 1e-4


@dataclasses.dataclass(frozen=True, kw_only=True)
class Physics:
    """Assumptions about the unpublished properties of a Create 2, its floor and its walls."""

    floor: float = 0.8
    "The coefficient of friction between the wheels and the floor."
    wall: float = 0.3
    "The coefficient of friction between the bumper and the walls."
    stiffness: float = 500.0
    "The stiffness of the springs of the bumper, in N/m."
    threshold: float = 0.004
    """The distance in metres by which the bumper must be pushed in, at 45 degrees to the left or to
    the right, to close a switch. With the default stiffness, this takes a force of 2 N."""
    acceleration: float = 1.8
    "The largest acceleration of the wheels, in m/s²."
    wheels: float = 0.0
    """The standard deviation of the relative error of the radius of each wheel, which is drawn once
    per robot. A calibration corrects this error."""
    time_step: float = 0.001
    "The time step of the engine, in seconds."

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            zero = name in ("wall", "wheels")
            if not (math.isfinite(value) and (value > 0 or (zero and value == 0))):
                least = "0 or more" if zero else "more than 0"
                raise ValueError(f"{name}: expected a finite number of {least}, got {value!r}")
        for name, most in (("time_step", 0.0025), ("threshold", _TRAVEL / 2), ("wheels", 0.2)):
            if (value := getattr(self, name)) > most:
                raise ValueError(f"{name}: expected at most {most:g}, got {value!r}")


def robot_model(
    workspace: Workspace,
    physics: Physics,
    pose: Sequence[float],
    *,
    wheels: Sequence[float] = (WHEEL, WHEEL),
) -> str:
    """Write the model of a Create 2 in a map, in the XML of MuJoCo.

    Each wall is a thin box. The shell is a sphere that collides only with walls. Walls touch the
    sphere at the height of its centre, where it has the circular outline of the robot, so that
    contacts with walls and corners are exact. The wheels are ellipsoids that touch the floor at one
    point each, because cylinders touch it at two points and slip when the robot turns.

    The walls of `workspace` are not moved by the radius of the robot. `pose` is x and y in metres
    and the heading in radians. `wheels` are the radii of the left and the right wheel in metres.
    """
    x, y, heading = pose
    axle, axles = max(wheels), ("left", "right")
    walls = "".join(map(_wall, edges(workspace.environment)[:, 1:]))
    rolling = "".join(
        f'<body pos="0 {side * WHEEL_BASE / 2} {radius - axle}">'
        f'<joint name="{name}" axis="0 1 0" armature="0.005"/>'
        f'<geom class="floor" type="ellipsoid" size="{radius} 0.012 {radius}" mass="0.2"'
        f' friction="{physics.floor} 0 0"/></body>'
        for name, side, radius in zip(axles, (1, -1), wheels, strict=True)
    )
    casters = "".join(
        f'<geom class="floor" type="sphere" size="0.01" pos="{at} 0 {0.01 - axle + clearance}"'
        ' condim="1"/>'
        for at, clearance in ((0.13, 0.0), (-0.13, 0.002))
    )
    slides = "".join(
        f'<joint name="{name}" type="slide" axis="{axis}" stiffness="{physics.stiffness}"'
        f' damping="{DAMPING}"/>'
        for name, axis in (("along", "1 0 0"), ("across", "0 1 0"))
    )
    # Each motor has an integral and a proportional part, which hold a robot that stands still.
    motors = "".join(
        f'<intvelocity joint="{name}" kp="2" actrange="-1e9 1e9" forcerange="-1 1"/>'
        f'<velocity joint="{name}" kv="0.5" forcerange="-1 1"/>'
        for name in axles
    )
    return f"""<mujoco><compiler angle="radian"/>
<option timestep="{physics.time_step}" integrator="implicitfast" cone="elliptic"><flag
 midphase="disable"/></option>
<default>
<default class="wall"><geom contype="2" conaffinity="2" priority="1" solref="0.01 2"
 solimp="0.95 0.95 0.001" friction="{physics.wall} 0 0"/></default>
<default class="shell"><geom contype="2" conaffinity="2"/></default>
<default class="floor"><geom priority="1" solref="0.02 1" solimp="0.995 0.995 0.001"/></default>
</default>
<worldbody><geom type="plane" size="0 0 1"/>{walls}
<body pos="{x} {y} {axle}" euler="0 0 {heading}"><freejoint/>
<inertial pos="0.02 0 0" mass="3" diaginertia="0.024 0.024 0.045"/>
<geom class="shell" type="sphere" size="{RADIUS - _TRAVEL / 2}" pos="{-_TRAVEL / 2} 0 0.01"/>
{casters}{rolling}
<body pos="0 0 0.01">{slides}
<geom class="shell" type="sphere" size="{RADIUS}" mass="0.1"/></body>
</body></worldbody>
<actuator>{motors}</actuator>
</mujoco>"""


def _wall(ends: Float[np.ndarray, "2 2"]) -> str:
    """Write a wall from `ends[0]` to `ends[1]` for MuJoCo, with the free space to its left."""
    middle, way = ends.mean(axis=0), ends[1] - ends[0]
    length, angle = float(np.hypot(*way)), math.atan2(way[1], way[0])
    x, y = middle + _THIN * np.array([math.sin(angle), -math.cos(angle)])
    return (
        f'<geom class="wall" type="box" size="{length / 2} {_THIN} 0.1" pos="{x} {y} 0.1"'
        f' euler="0 0 {angle}"/>'
    )
