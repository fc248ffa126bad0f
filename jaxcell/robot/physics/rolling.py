"""Move a robot that rolls steadily in closed form, in place of many steps of the engine."""

import cmath
import math
from typing import Any

import numpy as np

from .model import DAMPING, WHEEL


BODY, ROLL, SHELL = slice(3), slice(7, 9), slice(9, 11)
"""The place of the body, the wheels, and the bumper among the positions of the model."""
SPIN, SLIDE = slice(6, 8), slice(8, 10)
"""The wheels and the bumper among its velocities."""

# The rate per second at which the lag of the motors behind their commands dies out, slow part.
_RATES = 3.0, 6.0
# Differences of wheel speeds that do not matter, in rad/s, which is 0.1 mm/s, and the least speed.
_EQUAL, _LEAST = 0.003, 0.1


def lag_rate(data: Any, speeds: tuple[float, float]) -> float | None:
    """Find the rate at which the wheels approach their commanded speeds.

    **Arguments:**

    - `data`: the state in the engine.
    - `speeds`: the commanded speeds of the left and the right wheel, in m/s, for 0.1 s or more.

    **Returns:** the rate per second, 0 for wheels at their speeds; `None` if they do not approach
    them as wheels do that roll freely, straight or on the spot.
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
    """Let a robot roll on, straight or on the spot, without a wall in its reach.

    In the frame of the body nothing changes but the speed, which approaches the commanded one as
    the lag of the wheels dies out. So the body moves along an arc, and its state turns with it.

    **Arguments:**

    - `data`: the state in the engine, which is changed.
    - `speeds`: the commanded speeds of the left and the right wheel, in m/s.
    - `seconds`: the time.
    - `rate`: the rate of `lag_rate`.
    - `stiffness`: the stiffness of the springs of the bumper, which swings back, in N/m.

    **Returns:** the turn of the body, in radians.
    """
    kept, swung = math.exp(-rate * seconds), math.exp(-stiffness / DAMPING * seconds)
    wanted, before = np.array(speeds) / WHEEL, data.qvel[SPIN].copy()
    rolled = wanted * seconds + (data.act - data.qpos[ROLL]) * (1 - kept)
    after = wanted + (before - wanted) * kept
    # The seconds that the way takes at the first speed, and the last speed as a share of that.
    whole = np.abs(before).sum()
    lasts, share = float(np.abs(rolled).sum() / whole), float(np.abs(after).sum() / whole)
    angle = float(data.qvel[5]) * lasts
    half, turn = cmath.rect(1.0, angle / 2), cmath.rect(1.0, angle)
    way = complex(*data.qvel[:2].tolist()) * lasts * ((turn - 1) / (1j * angle) if angle else 1.0)
    data.qpos[:2] += way.real, way.imag
    c, s, (w, i, j, k) = half.real, half.imag, data.qpos[3:7].tolist()
    data.qpos[3:7] = c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w
    data.qpos[ROLL] += rolled
    data.act += wanted * seconds
    data.qvel[:6] *= share
    for vector in (data.qvel, data.qacc_warmstart):
        ahead = complex(*vector[:2].tolist()) * turn
        vector[:2] = ahead.real, ahead.imag
    data.qvel[SPIN] = after
    data.qpos[SHELL] *= swung
    data.qvel[SLIDE] *= swung
    data.time += seconds
    return angle
