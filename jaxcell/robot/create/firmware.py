import time

from .driver import Port
from .open_interface import RESET, START


def firmware(port: Port, *, seconds: float = 10.0, quiet: float = 2.0) -> str:
    """Reboot the robot, and read the lines that it prints, which name its firmware version.

    No driver uses the open line. Reading ends after `quiet` seconds without a byte, and at most
    after `seconds`; a reboot takes about five. The text is empty if the robot is silent.
    """
    port.timeout = 0.1
    port.write(START + RESET)
    text = b""
    now = time.monotonic()
    end = until = now + seconds
    # A late reader finds what came meanwhile: only a read without a byte is quiet.
    while now < end:
        data = port.read(max(1, port.in_waiting))
        now = time.monotonic()
        if data:
            text, until = text + data, now + quiet
        elif now >= until:
            break
    lines = text.decode("ascii", errors="replace").splitlines()
    return "\n".join(line.strip() for line in lines if line.strip())
