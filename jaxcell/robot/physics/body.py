import math

import numpy as np
import shapely

from ...base.optional_modules import import_module
from ...space import Workspace
from ..create.packets import METRES_PER_COUNT
from .model import AXLE, BUMPER, RADIUS, WHEEL, Physics, robot_model


# Toward the switches of the bumper, in the frame of the body.
_SWITCHES = np.array([[1.0, 1.0], [1.0, -1.0]]) / math.sqrt(2)
# Steps of the engine between two looks at the heading; far less than half a turn.
_TOGETHER = 50
# The rounding of the walls of a map that just holds a body.
_ROUNDING = 1e-6


class PhysicsBody:
    """A Create 2 that a physics engine moves among the walls of a map.

    Its motors bring each wheel to the commanded speed, at most by the acceleration. The encoders
    show how the wheels have turned, slipping or not. A bumper is pressed while its half of the
    shell is in by the threshold.

    A robot in a room of 8 m:

        >>> from jaxcell.robot.physics import PhysicsBody
        >>> from jaxcell.space import Workspace
        >>> room = Workspace([(0, 0), (8, 0), (8, 8), (0, 8)])
        >>> body = PhysicsBody(room, (4.0, 4.0, 0.0))
        >>> for _ in range(100):
        ...     body.advance(0.2, 0.2, 0.015)
        >>> round(body.pose[0], 2), body.bump_left
        (4.29, False)
    """

    def __init__(
        self,
        workspace: Workspace,
        pose: tuple[float, float, float],
        physics: Physics | None = None,
        *,
        rng: np.random.Generator | None = None,
    ) -> None:
        """**Arguments:**

        - `workspace`: the map. Its `robot_radius` plays no part: the robot has its own.
        - `pose`: x and y in metres, and the heading in radians.
        - `physics`: the assumptions.
        - `rng`: the source of the wheels' radii, where these have an error.

        **Raises:** `ValueError` if the body would be in a wall; `ModuleNotFoundError` if there is
        no MuJoCo.
        """
        self.physics = physics or Physics()
        place, free = shapely.Point(pose[:2]), workspace.environment
        if not (
            np.isfinite(pose).all()
            and free.contains(place)
            and free.boundary.distance(place) >= RADIUS - _ROUNDING
        ):
            raise ValueError(
                f"pose: a Create 2, of radius {RADIUS:g} m, at ({pose[0]:g} m, {pose[1]:g} m) "
                "would be in a wall or off the map"
            )
        rng = rng or np.random.default_rng(0)
        radii = WHEEL * (1 + np.clip(rng.normal(0.0, self.physics.wheels, 2), -0.5, 0.5))
        self._engine = import_module("mujoco")
        self._model = self._engine.MjModel.from_xml_string(
            robot_model(workspace, self.physics, pose, wheels=radii.tolist())
        )
        self._data = self._engine.MjData(self._model)
        self._engine.mj_forward(self._model, self._data)
        joints = [self._model.joint(name).qposadr[0] for name in (*AXLE, *BUMPER)]
        self._wheels, self._bumper = joints[:2], joints[2:]
        self._speeds, self._owed = np.zeros(2), 0.0
        self._turned = pose[2]
        self.touches: list[tuple[float, float, float]] = []
        "Time in seconds, x and y of each touch of a wall, at the end of each tick."

    @property
    def pose(self) -> tuple[float, float, float]:
        """x and y in metres, and the heading in radians, not reduced to one turn."""
        x, y = self._data.qpos[:2].tolist()
        return x, y, self._turned

    @property
    def counts(self) -> tuple[int, int]:
        """The counts of the left and the right encoder, from 0 to 65535."""
        left, right = (self._data.qpos[self._wheels] * (WHEEL / METRES_PER_COUNT)).tolist()
        return math.floor(left) % 65536, math.floor(right) % 65536

    @property
    def bump_left(self) -> bool:
        """True if the left half of the bumper is pressed."""
        return self._pressed(0)

    @property
    def bump_right(self) -> bool:
        """True if the right half of the bumper is pressed."""
        return self._pressed(1)

    def advance(self, left: float, right: float, seconds: float) -> None:
        """Let the wheels turn for a tick, each toward its speed in m/s."""
        self._owed += seconds
        step, wanted = self.physics.time_step, np.array([left, right])
        steps = math.floor(self._owed / step + 1e-9)
        self._owed -= steps * step
        most = self.physics.acceleration * step
        while steps > 0:
            ramped = bool((self._speeds == wanted).all())
            self._speeds += np.clip(wanted - self._speeds, -most, most)
            # The left wheel has two motors, and so has the right one.
            self._data.ctrl[:] = np.repeat(self._speeds / WHEEL, 2)
            taken = min(steps, _TOGETHER) if ramped else 1
            self._engine.mj_step(self._model, self._data, taken)
            steps -= taken
            self._turned += math.remainder(self._heading() - self._turned, math.tau)
        self._touch()

    def _heading(self) -> float:
        w, i, j, k = self._data.qpos[3:7].tolist()
        return math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))

    def _pressed(self, side: int) -> bool:
        inward = -float(_SWITCHES[side] @ self._data.qpos[self._bumper])
        return inward >= self.physics.threshold

    def _touch(self) -> None:
        contacts = self._data.contact
        # The floor has no normal along it.
        walls = np.abs(contacts.frame[:, 2]) < 0.5
        if walls.any():
            deepest = int(np.flatnonzero(walls)[contacts.dist[walls].argmin()])
            at = contacts.pos[deepest].tolist()
            self.touches.append((float(self._data.time), at[0], at[1]))
