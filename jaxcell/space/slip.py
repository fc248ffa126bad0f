import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from ..base.shown import Shown
from .workspace import Workspace, edges


ERRORS = 9
"Number of independent errors of a step; each is a standard normal number."
TURNING = 7
"Index of the error of the turn after a bump."
MISSED = 1e-3
"Probability that a particle filter gives to an observation that a particle does not predict."
# Metres between the two rays that measure the slope of a wall.
_BESIDE = 1e-4
# A wall is longer by this share at either end, so that no ray leaves through a corner.
_CORNER = 1e-9


@dataclasses.dataclass(frozen=True, kw_only=True)
class Slip(Shown):
    """The errors in the motion of a robot, which its wheel encoders do not measure.

    The errors are normal, and independent for each straight stretch and turn.

        >>> from jaxcell import space
        >>> space.Slip.of(0.02)
        Slip(step=0.02, turn=0.02, heading=0.02, bumper=0.0, give=0.0, bump_turn=0.0, bump_skid=0.0)
    """

    step: float = 0.0
    "Standard deviation of the relative error of a straight stretch, from 0 to 1."
    turn: float = 0.0
    "Standard deviation of the relative error of a turn in place, from 0 to 1."
    heading: float = 0.0
    "Standard deviation of the drift of the heading per metre of travel, in radians, from 0 to 1."
    bumper: float = 0.0
    """Standard deviation of the position at which the robot feels a wall, in metres. So it may feel
    a wall just beyond the end of a step, or miss a wall just before the end."""
    give: float = 0.0
    "Distance in metres by which the bumper is pressed in before the robot feels a bump."
    bump_turn: float = 0.0
    """Angle in radians, from -1 to 1, by which a bump at an incidence of 45 degrees turns the robot
    toward the wall. The angle is not random. At an incidence `i` it is multiplied by `sin(2 i)`, so
    a head-on bump does not turn the robot."""
    bump_skid: float = 0.0
    """Distance in metres by which the wheels skid at a head-on bump. The encoders count it as
    travel, so a robot that measures its way back with the encoders goes too far. The distance is
    multiplied by `cos(i)**2` at an incidence `i`."""

    def __post_init__(self) -> None:
        for name in ("step", "turn", "heading"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise ValueError(f"slip: {name}: expected a number from 0 to 1, got {value:g}")
        if not abs(self.bump_turn) <= 1:
            raise ValueError(
                "slip: bump_turn: expected -1 to 1 radians (57.3 degrees), got "
                f"{math.degrees(self.bump_turn):.3g} degrees"
            )
        for name in ("bumper", "give", "bump_skid"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"slip: {name}: expected a length of 0 m or more, got {value:g} m")

    @classmethod
    def of(cls, slip: float, **others: float) -> "Slip":
        """Create a slip with `slip` as `step`, `turn` and `heading`; `others` set other fields."""
        return cls(step=slip, turn=slip, heading=slip, **others)


def felt_walls(workspace: Workspace, give: float) -> Float[np.ndarray, "walls 2 2"]:
    """Move the walls back by the distance by which the bumper is pressed in at a bump.

    **Arguments:** a map, and the distance in metres. **Returns:** the ends of each wall, in metres.

    A corridor of 3 m, with a bumper that is pressed in by 2 cm:

        >>> from jaxcell import examples, space
        >>> room = examples.corridor().workspace
        >>> sorted({abs(x) for x in space.felt_walls(room, 0.02)[:, 0, 0].round(6).tolist()})
        [0.02, 3.02]
    """
    space = workspace.free_space
    if give:
        space = space.buffer(give, join_style="mitre")
    return edges(shapely.normalize(space))[:, 1:]


def free_ahead(
    walls: Float[Any, "walls 2 2"], place: Float[Any, "*batch 2"], heading: Float[Any, "*batch"]
) -> Float[Any, "*batch"]:
    """Compute the distance from each place to the first wall ahead.

    It takes arrays of NumPy or JAX, and works under `jit` and `vmap`.

    **Arguments:** the ends of each wall and places in metres, and headings in radians. **Returns:**
    distances in metres, `inf` if there is no wall.

    In a room of 3 m, from its middle to the East:

        >>> import numpy as np
        >>> from jaxcell import examples, space
        >>> room = examples.corridor().workspace
        >>> walls = space.felt_walls(room, 0.0)
        >>> space.free_ahead(walls, np.array([1.5, 0.5]), np.array(0.0)).tolist()
        1.5
    """
    xp = place.__array_namespace__()
    ux, uy = xp.cos(heading), xp.sin(heading)
    nearest = xp.full(heading.shape, xp.inf)
    for wall in walls:
        nearest = xp.minimum(nearest, to_wall(wall, place, ux, uy))
    return nearest


def to_wall(
    wall: Float[Any, "2 2"],
    place: Float[Any, "*batch 2"],
    ux: Float[Any, "*batch"],
    uy: Float[Any, "*batch"],
) -> Float[Any, "*batch"]:
    """Compute the distance to a wall along unit vectors `(ux, uy)`; `inf` if the ray misses it."""
    xp = place.__array_namespace__()
    wide, high = wall[1, 0] - wall[0, 0], wall[1, 1] - wall[0, 1]
    x, y = wall[0, 0] - place[..., 0], wall[0, 1] - place[..., 1]
    across = ux * high - uy * wide
    inverse = 1 / xp.where(across == 0, 1.0, across)
    distance = (x * high - y * wide) * inverse
    share = (x * uy - y * ux) * inverse
    meets = (across != 0) & (xp.abs(share - 0.5) <= 0.5 + _CORNER) & (distance >= 0)
    return xp.where(meets, distance, xp.inf)


def incidence_slope(
    place: Float[Any, "*batch 2"],
    heading: Float[Any, "*batch"],
    ahead: Float[Any, "*batch"],
    ahead_of: Callable[[Any, Any], Any],
) -> Float[Any, "*batch"]:
    """Compute the tangent of the angle of incidence at the wall ahead, from two parallel rays.

    The tangent is positive if the wall is on the left of the robot, and 0 for a head-on bump.
    `ahead` is the distance to the wall in metres, and `ahead_of(place, heading)` computes this
    distance from other places.
    """
    xp = place.__array_namespace__()
    left = place + _BESIDE * _unit(xp, heading + math.pi / 2)
    beside = ahead_of(left, heading)
    met = xp.isfinite(ahead) & xp.isfinite(beside)
    return (xp.where(met, ahead, 0.0) - xp.where(met, beside, 0.0)) / _BESIDE


def slipping_step(
    pose: Float[Any, "*batch 3"],
    legs: Float[Any, "*batch 3"],
    bounce: float,
    errors: Float[Any, "*batch 9"],
    walls: Float[Any, "walls 2 2"],
    slip: Slip,
    *,
    ahead_of: Callable[[Any, Any, Any], Any] = free_ahead,
) -> tuple[Float[Any, "*batch 3"], Any]:
    """Move a robot that slips by a step, or by a bump and the turn after it.

    The robot drives the stretches of the step. If it meets a wall, it drives back to the start of
    the step, according to its encoders, and turns by the bouncing angle. The function takes arrays
    of NumPy or JAX, and works under `jit` and `vmap`.

    **Arguments:** poses, x and y in metres and the heading in radians; the stretches of the
    intended step, a row of [`stride_legs`][]; the bouncing angle in radians; errors, as standard
    normal numbers; the walls of [`felt_walls`][]; the slip; and a substitute for [`free_ahead`][].
    **Returns:** the poses after the step, and a mask of the robots that bumped.

    A robot that does not slip, in a room of 3 m, with a step of 1 m:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import examples, space
        >>> room = examples.corridor().workspace
        >>> walls, exact = space.felt_walls(room, 0.0), space.Slip()
        >>> start, leg = np.array([[1.5, 0.5, 0.0], [2.5, 0.5, 0.0]]), np.array([[1.0, 0, 0]] * 2)
        >>> after, bumped = space.slipping_step(
        ...     start, leg, math.pi / 2, np.zeros((2, 9)), walls, exact
        ... )
        >>> after.round(2).tolist(), bumped.tolist()
        ([[2.5, 0.5, 0.0], [2.5, 0.5, 1.57]], [False, True])
    """
    xp = pose.__array_namespace__()
    e = [errors[..., i] for i in range(ERRORS)]
    place, heading = pose[..., :2], pose[..., 2]
    felt = slip.bumper * e[8]

    def stretch(place, heading, leg, relative, drifts, sways):  # type: ignore[no-untyped-def]
        """Drive a stretch of length `leg`, with normal errors of its length, heading and chord.

        Returns the end of the stretch, the heading at this end, the heading along the chord, the
        distance to a wall on the stretch (or `inf`), and the tangent of the incidence at this wall.
        """
        length = leg * (1 + slip.step * relative)
        drift = slip.heading * xp.sqrt(xp.abs(leg)) * drifts
        chord = heading + drift / 2 + slip.heading * xp.sqrt(xp.abs(leg) / 12) * sways
        ahead = ahead_of(walls, place, chord)
        end = place + length[..., None] * _unit(xp, chord)
        slope = 0.0
        if slip.bump_turn or slip.bump_skid:
            slope = incidence_slope(place, chord, ahead, lambda p, h: ahead_of(walls, p, h))
        return end, heading + drift, chord, xp.where(ahead < length + felt, ahead, xp.inf), slope

    first, turn, second = legs[..., 0], legs[..., 1], legs[..., 2]
    middle, drifted, chord, ahead, slope = stretch(place, heading, first, e[0], e[1], e[2])
    turned = drifted + turn * (1 + slip.turn * e[3])
    end, last, _, beyond, later = stretch(middle, turned, second, e[4], e[5], e[6])
    straight = second == 0
    beyond = xp.where(second > 0, beyond, xp.inf)
    bumped = xp.isfinite(ahead) | xp.isfinite(beyond)
    goes = xp.where(straight, drifted, last - turn * (1 + slip.turn * e[7]))

    # The drive back has errors of its own: twice the variance of the drive to the wall, and two
    # thirds of it across, since the robot backs along another heading.
    run = xp.where(xp.isfinite(ahead), ahead, first + xp.where(xp.isfinite(beyond), beyond, 0.0))
    along = slip.step * math.sqrt(2) * run * e[4]
    across = slip.heading * math.sqrt(2 / 3) * run**1.5 * e[5]
    gain = 0.0
    if slip.bump_turn or slip.bump_skid:
        slope = xp.where(xp.isfinite(ahead), slope, later)
        gain = slip.bump_turn * 2 * slope / (1 + slope**2)
        # The robot backs along its heading after the bump.
        across = across - run * xp.sin(gain)
        along = along - slip.bump_skid / (1 + slope**2)
    back = place + along[..., None] * _unit(xp, chord)
    back = back + across[..., None] * _unit(xp, chord + math.pi / 2)
    aside = xp.where(xp.isfinite(ahead), 0.0, math.sqrt(2) * turn * slip.turn * e[6])
    veered = heading + slip.heading * xp.sqrt(2 * run) * e[1] + aside + gain
    faces = veered + math.remainder(bounce, 2 * math.pi) * (1 + slip.turn * e[TURNING])

    after = xp.where(bumped[..., None], back, xp.where(straight[..., None], middle, end))
    facing = xp.where(bumped, faces, goes)
    return xp.concatenate([after, facing[..., None]], axis=-1), bumped


def _unit(xp: Any, angle: Float[Any, "*batch"]) -> Float[Any, "*batch 2"]:
    return xp.stack([xp.cos(angle), xp.sin(angle)], axis=-1)
