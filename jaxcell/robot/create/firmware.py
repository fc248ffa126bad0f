import time

from .driver import Port
from .open_interface import RESET, START


# Reading ends after 10 seconds, or after 2 seconds without a byte. A reboot takes about five.
_SECONDS, _QUIET = 10.0, 2.0


def firmware(port: Port) -> str:
    """Reboot a robot, and read the lines that it prints, which contain its firmware version.

    No driver may use the line at the same time. The returned text is empty if the robot is silent.
    """
    port.timeout = 0.1
    port.write(START + RESET)
    text = b""
    now = time.monotonic()
    end = until = now + _SECONDS
    # A slow reader may be late, so only a read without a byte counts as silence.
    while now < end:
        data = port.read(max(1, port.in_waiting))
        now = time.monotonic()
        if data:
            text, until = text + data, now + _QUIET
        elif now >= until:
            break
    lines = text.decode("ascii", errors="replace").splitlines()
    return "\n".join(line.strip() for line in lines if line.strip())
