import dataclasses
import functools
import math

import numpy as np
import shapely

from ...space import CellSpace, Workspace, free_ahead
from ...space.slip import incidence_slope
from ...space.workspace import edges
from ..create.packets import METRES_PER_COUNT, WHEEL_BASE


# The angles around the front at which walls are sensed, in radians.
_PROBES = np.radians(np.arange(-85.0, 86.0, 10.0))
# The distance within which a wall keeps the bumper pressed, in metres.
_HELD = 1e-3
# A wall at a larger angle to one side presses only the half of the bumper on this side.
_MIDDLE = math.radians(20.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Noise:
    """The errors of the motion of an emulated robot; all zero by default.

    As on a real robot, the encoders count the turns of the wheels, not the true motion of the body.
    """

    distance: float = 0.0
    "The standard deviation of the relative error of a straight drive, drawn once per drive."
    rotation: float = 0.0
    "The standard deviation of the relative error of a turn in place, drawn once per turn."
    veer: float = 0.0
    "The standard deviation of the error of the heading after one metre straight ahead, in radians."
    encoder: float = 0.0
    "The standard deviation of the relative error of each encoder, drawn at each time step."
    bump_turn: float = 0.0
    """The angle in radians by which a bump at 45 degrees turns the robot toward the wall; see
    [`jaxcell.space.Slip`][]."""
    bump_skid: float = 0.0
    """The distance in metres by which the wheels skid at a head-on bump; see
    [`jaxcell.space.Slip`][]."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name}: expected a finite number from 0, got {value!r}")


def bumper_give(cell: float) -> float:
    """Choose the distance by which the bumper of an emulated robot can be pushed in, in metres.

    If a step would enter a wall by less than this distance, the emulated robot does not bump,
    although the ideal robot of the model does. With a rigid bumper, on the other hand, small errors
    of position would make the emulated robot bump into corners that the ideal robot grazes. The
    compromise is 2 cm for cells with a side of 1 m or more. For smaller cells, it is proportional
    to the square of the side, but at least half a millimetre.
    """
    return max(0.0005, 0.02 * min(1.0, cell) ** 2)


class Body:
    """The body of a robot with two driven wheels and a bumper, among the walls of a map.

    Time advances in steps of any length. In each step the body moves straight, along the chord of
    the arc that its wheels drive. At a wall the body and its wheels stop, so that the encoders
    count the true distance. While the body is at the wall, the half of the bumper on this side is
    pressed. The bumper faces forward, so a body that backs into a wall stops without a bump.
    """

    def __init__(
        self,
        workspace: Workspace,
        pose: tuple[float, float, float],
        *,
        give: float = 0.02,
        noise: Noise | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        """Put a body at a pose, x and y in metres and the heading in radians.

        The radius of the body is the `robot_radius` of the map, 0 for a point. The bumper is pushed
        in by `give` metres before the wall stops the body.
        """
        if not (math.isfinite(give) and give >= 0):
            raise ValueError(f"give: expected a finite number from 0, got {give!r}")
        self.noise = noise or Noise()
        self._rng = rng or np.random.default_rng(0)
        self._space = _enlarged(workspace.free_space, give)
        if not (
            np.isfinite(pose).all()
            and workspace.free_space.distance(shapely.Point(pose[:2])) < 1e-9
        ):
            raise ValueError(
                f"pose: a body of radius {workspace.robot_radius:g} m at "
                f"({pose[0]:g} m, {pose[1]:g} m) would be in a wall or off the map"
            )
        self.x, self.y, self.theta = map(float, pose)
        self.travelled = np.zeros(2)
        "The distances that the left and the right wheel have rolled by their encoders, in metres."
        self.bump_left = self.bump_right = False
        # The centre and the radius of a disc without walls, in which no test of a path is needed.
        self._clear, self._walls = (self.x, self.y), self._space.boundary
        self._radius = self._walls.distance(shapely.Point(self._clear))
        self._stretch = (0, 0)
        self._slip = (0.0, 0.0)

    @classmethod
    def in_cell(cls, cells: CellSpace, cell: int, error: float, rng: np.random.Generator) -> "Body":
        """Create a body at the centre of a cell, whose `error` is the same for all its motions.

        Its `Noise` has this value as `distance`, `rotation` and `veer`.
        """
        x, y, theta = map(float, cells.centre(cell))
        noise = Noise(distance=error, rotation=error, veer=error)
        return cls(cells.room, (x, y, theta), give=bumper_give(cells.cell), noise=noise, rng=rng)

    @property
    def pose(self) -> tuple[float, float, float]:
        return self.x, self.y, self.theta

    @property
    def counts(self) -> tuple[int, int]:
        left, right = self.travelled.tolist()
        count = METRES_PER_COUNT
        return math.floor(left / count) % 65536, math.floor(right / count) % 65536

    def advance(self, left: float, right: float, seconds: float) -> None:
        # A new slip is drawn when the kind of the motion changes, but not when its speed changes.
        stretch = np.sign(left + right), np.sign(right - left)
        if stretch != self._stretch:
            distance, rotation = self._rng.normal(0.0, (self.noise.distance, self.noise.rotation))
            self._slip = float(distance), float(rotation)
        self._stretch = stretch
        forward = (left + right) / 2 * seconds
        turn = (right - left) / WHEEL_BASE * seconds
        moved = self._move(forward * (1 + self._slip[0]), self.theta + turn / 2)
        self.theta += turn * (1 + self._slip[1])
        if self.noise.veer:
            self.theta += float(
                self._rng.normal(0.0, self.noise.veer * math.sqrt(abs(forward) * moved))
            )
        along, aside = forward * moved, turn * WHEEL_BASE / 2
        wheels = np.array([along - aside, along + aside])
        if self.noise.encoder:
            wheels = wheels * (1 + self._rng.normal(0.0, self.noise.encoder, 2))
        self.travelled += wheels
        pushing, pressed = moved < 1 and forward > 0, self.bump_left or self.bump_right
        self._feel(pushing=pushing)
        if (self.noise.bump_turn or self.noise.bump_skid) and pushing and not pressed:
            slope = self._incidence_slope()
            self.theta += self.noise.bump_turn * 2 * slope / (1 + slope**2)
            self.travelled += self.noise.bump_skid / (1 + slope**2)

    def _move(self, forward: float, heading: float) -> float:
        """Move `forward` metres along `heading`, or up to a wall; return the completed fraction."""
        if forward == 0:
            return 1.0
        ux, uy = math.cos(heading), math.sin(heading)
        share = 1.0
        if not self._free(forward * ux, forward * uy):
            # The bisection to a nanometre works for walls of any shape.
            share, blocked = 0.0, 1.0
            while (blocked - share) * abs(forward) > 1e-9:
                middle = (share + blocked) / 2
                if self._free(middle * forward * ux, middle * forward * uy):
                    share = middle
                else:
                    blocked = middle
        self.x, self.y = self.x + share * forward * ux, self.y + share * forward * uy
        return share

    def _free(self, dx: float, dy: float) -> bool:
        """Check that no wall is in the way of a straight move by `dx` and `dy` metres."""
        here, end = (self.x, self.y), (self.x + dx, self.y + dy)
        if math.dist(self._clear, here) < self._radius > math.dist(self._clear, end):
            return True
        if here != self._clear:
            self._clear, self._radius = here, self._walls.distance(shapely.Point(here))
            return self._free(dx, dy)
        return bool(shapely.covers(self._space, shapely.linestrings([here, end])))

    def _incidence_slope(self) -> float:
        heading = np.array([self.theta])
        ahead = math.cos(self.theta), math.sin(self.theta)
        before = np.array([self.pose[:2]]) - _HELD * np.array([ahead])
        walls = edges(self._space)[:, 1:]
        ahead_of = functools.partial(free_ahead, walls)
        return float(incidence_slope(before, heading, ahead_of(before, heading), ahead_of)[0])

    def _feel(self, *, pushing: bool) -> None:
        if not (pushing or self.bump_left or self.bump_right):
            return
        angles = self.theta + _PROBES
        walls = ~shapely.contains_xy(
            self._space, self.x + _HELD * np.cos(angles), self.y + _HELD * np.sin(angles)
        )
        # A wall that no probe senses, such as a sharp corner, counts as straight ahead.
        side = float(_PROBES[walls].mean()) if walls.any() else 0.0
        held = pushing or bool(walls.any())
        self.bump_left = held and side > -_MIDDLE
        self.bump_right = held and side < _MIDDLE


# Consecutive bodies are often among the same walls.
@functools.lru_cache(maxsize=1)
def _enlarged(free: shapely.Geometry, give: float) -> shapely.Geometry:
    """Enlarge the free space by `give`, the metres by which the bumper can be pushed in."""
    space = free.buffer(give, join_style="mitre")
    shapely.prepare(space)
    return space
