"""Choose wheel speeds whose bytes the robot cannot mistake for commands."""

import functools

from .open_interface import MAX_SPEED, RESET, START, STOP


def wheel_speeds(*, right: float, left: float) -> tuple[int, int]:
    """Convert speeds in m/s, from -0.5 to 0.5, to speeds in mm/s that are safe to send.

    If the line loses the opcode of a drive command, the robot reads speeds as commands, and might
    clean, dock, switch off or reset. Therefore, if a byte of a pair of speeds is an opcode, the
    pair is replaced by the next slower pair on the same arc. A straight drive remains straight, and
    a turn on the spot stays on the spot. On other arcs, rounding to mm/s slightly changes the
    radius.
    """
    return _pair(_millimetres("right", right), _millimetres("left", left))


@functools.lru_cache(1024)
def _pair(right: int, left: int) -> tuple[int, int]:
    fastest = max(abs(right), abs(left))
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
    """Check that the low byte of a speed is not an opcode. The high byte is never an opcode."""
    low = speed & 0xFF
    return low != RESET[0] and not START[0] <= low <= STOP[0]
