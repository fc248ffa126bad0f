import math

import numpy as np
import shapely

from ...base.optional_modules import import_module
from ...space import Workspace
from ...space.workspace import edges
from ..create.packets import METRES_PER_COUNT
from .model import RADIUS, WHEEL, Physics, robot_model


_ROLL, _SHELL = slice(7, 9), slice(9, 11)
"The slices of the engine's positions `qpos` for the wheels and the bumper."
# The number of steps of the engine between two readings of the heading, which is unwrapped; the
# robot turns by much less than half a turn in them.
_TOGETHER = 50
# The tolerance in metres for a start that touches a wall.
_ROUNDING = 1e-6
# The distance of a wall from the shell beyond which the shell cannot touch it, in metres.
_CLEAR = 0.01
# The engine contains the walls up to this distance from the shell, which are chosen again after a
# drive of the second distance, in metres.
_NEAR, _AGAIN = 0.3, 0.2


class PhysicsBody:
    """A Create 2 that a physics engine moves among the walls of a map.

    Its motors bring each wheel to the commanded speed with a limited acceleration. The encoders
    count the turns of the wheels, even if they slip. Each half of the bumper counts as pressed
    while it is pushed in by at least `physics.threshold`.

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

        - `workspace`: the map. Its `robot_radius` is ignored; the radius of a Create 2 is `RADIUS`.
        - `pose`: x and y in metres, and the heading in radians.
        - `physics`: the assumptions about the robot, the floor and the walls.
        - `rng`: the random generator for the radii of the wheels.
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
        self._walls = shapely.linestrings(edges(workspace.environment)[:, 1:])
        boxes = self._model.geom_type == self._engine.mjtGeom.mjGEOM_BOX
        self._boxes = np.flatnonzero(boxes)
        self._turned = pose[2]
        self._survey()
        self._speeds, self._owed = (0.0, 0.0), 0.0
        self.touches: list[tuple[float, float, float]] = []
        "The time in seconds, x and y of the contact with a wall at the end of each tick, if any."

    @property
    def pose(self) -> tuple[float, float, float]:
        x, y = self._data.qpos[:2].tolist()
        return x, y, self._turned

    @property
    def counts(self) -> tuple[int, int]:
        left, right = self._data.qpos[_ROLL].tolist()
        count = WHEEL / METRES_PER_COUNT
        return math.floor(left * count) % 65536, math.floor(right * count) % 65536

    @property
    def bump_left(self) -> bool:
        return self._pressed(1)

    @property
    def bump_right(self) -> bool:
        return self._pressed(-1)

    def advance(self, left: float, right: float, seconds: float) -> None:
        self._owed += seconds
        step = self.physics.time_step
        steps = math.floor(self._owed / step + 1e-9)
        self._owed -= steps * step
        while steps > 0:
            ramped = self._speeds == (left, right)
            if not ramped:
                most = self.physics.acceleration * step
                first, second = (
                    now + min(max(wanted - now, -most), most)
                    for now, wanted in zip(self._speeds, (left, right), strict=True)
                )
                self._speeds = first, second
            # The left wheel has two motors, and so has the right one.
            self._data.ctrl[:] = [speed / WHEEL for speed in self._speeds for _ in range(2)]
            if math.dist(self._looked, self.pose[:2]) > _AGAIN:
                self._survey()
            taken = min(steps, _TOGETHER) if ramped else 1
            self._engine.mj_step(self._model, self._data, taken)
            self._turned += math.remainder(self._heading() - self._turned, math.tau)
            steps -= taken
        if self._room - math.dist(self._looked, self.pose[:2]) < _CLEAR:
            self._touch()

    def _heading(self) -> float:
        w, i, j, k = self._data.qpos[3:7].tolist()
        return math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))

    def _survey(self) -> None:
        """Find the distance to the nearest wall, and make the engine ignore the far walls.

        Otherwise the far walls would take a third of the time of the engine.
        """
        self._looked = self.pose[:2]
        distance = shapely.distance(self._walls, shapely.Point(self._looked)) - RADIUS
        self._room = float(distance.min())
        kinds = 2 * (distance < _NEAR)
        self._model.geom_contype[self._boxes] = self._model.geom_conaffinity[self._boxes] = kinds

    def _pressed(self, side: int) -> bool:
        """Check whether the left (`side` 1) or right (`side` -1) half of the bumper is pressed."""
        ahead, left = self._data.qpos[_SHELL].tolist()
        return -(ahead + side * left) / math.sqrt(2) >= self.physics.threshold

    def _touch(self) -> None:
        contacts = self._data.contact
        # The contacts with walls are those with a horizontal normal.
        walls = np.abs(contacts.frame[:, 2]) < 0.5
        if walls.any():
            deepest = int(np.flatnonzero(walls)[contacts.dist[walls].argmin()])
            at = contacts.pos[deepest].tolist()
            self.touches.append((float(self._data.time), at[0], at[1]))
