"""Compute the motion of a steadily rolling robot in closed form, without steps of the engine."""

import cmath
import math
from typing import Any

import numpy as np

from ..create.packets import WHEEL_BASE
from .model import DAMPING, WHEEL


BODY, ROLL, SHELL = slice(3), slice(7, 9), slice(9, 11)
"""The slices of the engine's positions `qpos` for the body, the wheels, and the bumper."""
SPIN, SLIDE = slice(6, 8), slice(8, 10)
"""The slices of the engine's velocities `qvel` for the wheels and the bumper."""

# The range of the slow rate per second at which the lag of the motors decays.
_RATES = 3.0, 6.0
# The largest difference of equal wheel speeds (0.1 mm/s), and the least speed, in rad/s.
_EQUAL, _LEAST = 0.003, 0.1
# The speed ahead in m/s, and the turn rate in rad/s, per wheel speed in rad/s.
_AHEAD, _TURNING = WHEEL / 2 * np.ones(2), WHEEL / WHEEL_BASE * np.array([-1.0, 1.0])
# The points and weights of a Gauss rule for integrals over -1 to 1.
_TIMES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


def lag_rate(data: Any, speeds: tuple[float, float]) -> float | None:
    """Find the rate per second at which the wheels approach their commanded speeds.

    `data` is the state of the engine. `speeds` are the speeds of the left and the right wheel in
    m/s, commanded for at least 0.1 s. The rate is 0 if the wheels have these speeds. It is `None`
    if the robot neither rolls straight nor turns on the spot, or if it does not roll freely.
    """
    left, right = speeds
    if abs(abs(left) - abs(right)) > 0.1 * max(abs(left), abs(right)):
        return None
    spins, lags = data.qvel[SPIN].tolist(), (data.act - data.qpos[ROLL]).tolist()
    beyond = [spin - speed / WHEEL for spin, speed in zip(spins, speeds, strict=True)]
    if min(map(abs, spins)) < _LEAST:
        return None
    if max(map(abs, beyond)) < _EQUAL:
        return 0.0
    most = int(abs(lags[1]) > abs(lags[0]))
    rate = beyond[most] / lags[most] if lags[most] else math.inf
    apart = abs(beyond[1 - most] - rate * lags[1 - most])
    return rate if _RATES[0] < rate < _RATES[1] and apart < _EQUAL else None


def roll_on(
    data: Any, speeds: tuple[float, float], seconds: float, *, rate: float, stiffness: float
) -> float:
    """Advance a robot that rolls straight or turns on the spot, and cannot touch a wall.

    The lags of both wheels behind their motors decay at one common rate, so that the turns of the
    wheels are known. The body moves with its wheels, plus a small slip proportional to their speed.

    `data` is the state of the engine, which is changed. `speeds` are the commanded speeds of the
    left and the right wheel in m/s, `rate` is the result of `lag_rate`, and `stiffness` is that of
    the springs of the bumper, in N/m. Returns the turn of the body in radians.
    """
    wanted, before = np.array(speeds) / WHEEL, data.qvel[SPIN].copy()
    times = seconds * np.append((_TIMES + 1) / 2, 1.0)[:, None]
    kept = np.exp(-rate * times)
    rolled = wanted * times + (data.act - data.qpos[ROLL]) * (1 - kept)
    after = wanted + (before - wanted) * kept
    # The speed ahead and the turn rate of the body by its wheels, and their integrals.
    speed, spin = after @ _AHEAD, after @ _TURNING
    first, first_spin = before @ _AHEAD, before @ _TURNING
    on_the_spot = speeds[0] * speeds[1] < 0
    share = spin / first_spin if on_the_spot else speed / first
    lasts = rolled @ _TURNING / first_spin if on_the_spot else rolled @ _AHEAD / first
    angles = (data.qvel[5] - first_spin) * lasts + rolled @ _TURNING
    heading = cmath.exp(1j * heading_of(data))
    rest = complex(*data.qvel[:2].tolist()) - first * heading
    velocity = (rest * share + speed * heading) * np.exp(1j * angles)
    way, angle = complex(seconds / 2 * _WEIGHTS @ velocity[:-1]), float(angles[-1])
    half, turn = cmath.rect(1.0, angle / 2), cmath.rect(1.0, angle)
    data.qpos[:2] += way.real, way.imag
    c, s, (w, i, j, k) = half.real, half.imag, data.qpos[3:7].tolist()
    data.qpos[3:7] = c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w
    data.qpos[ROLL] += rolled[-1]
    data.act += wanted * seconds
    data.qvel[2:5] *= share[-1]
    data.qvel[5] = (data.qvel[5] - first_spin) * share[-1] + spin[-1]
    data.qvel[:2] = velocity[-1].real, velocity[-1].imag
    ahead = complex(*data.qacc_warmstart[:2].tolist()) * turn
    data.qacc_warmstart[:2] = ahead.real, ahead.imag
    data.qvel[SPIN] = after[-1]
    swung = math.exp(-stiffness / DAMPING * seconds)
    data.qpos[SHELL] *= swung
    data.qvel[SLIDE] *= swung
    data.time += seconds
    return angle


def heading_of(data: Any) -> float:
    """Compute the heading of the body from its quaternion, in radians."""
    w, i, j, k = data.qpos[3:7].tolist()
    return math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
