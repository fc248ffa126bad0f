"""Speeds of a pair of wheels, whose bytes on the line are no commands."""

import functools

from .open_interface import MAX_SPEED, RESET, START, STOP


def wheel_speeds(*, right: float, left: float) -> tuple[int, int]:
    """Choose the speeds to send for the wanted speeds.

    Where the line loses the opcode of a drive command, the robot takes its data for commands, and
    would clean, dock, switch off or reset. So a pair with such a byte gives way to the next slower
    one on the same arc: a robot that is to go straight does, and one that is to turn stays on its
    spot.

    The wanted speeds are in m/s, -0.5 to 0.5. The speeds to send are in mm/s, and have their ratio
    to half a mm/s of the slower wheel.
    """
    return _pair(_millimetres("right", right), _millimetres("left", left))


@functools.lru_cache(1024)
def _pair(right: int, left: int) -> tuple[int, int]:
    fastest = max(abs(right), abs(left))
    # Down to none, so that there always is one.
    for most in range(fastest, 0, -1):
        pair = round(right * most / fastest), round(left * most / fastest)
        if all(map(_harmless, pair)):
            return pair
    return 0, 0


def _millimetres(name: str, speed: float) -> int:
    if not abs(speed) <= MAX_SPEED / 1000:
        raise ValueError(f"{name} = {speed}: expected -0.5 to 0.5 m/s")
    return round(1000 * speed)


def _harmless(speed: int) -> bool:
    """Check that the low byte of a speed is not an opcode; the high byte never is."""
    low = speed & 0xFF
    return low != RESET[0] and not START[0] <= low <= STOP[0]
