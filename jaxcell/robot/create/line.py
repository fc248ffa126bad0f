"""Open the serial line to a robot, reboot the robot on it, and explain failures in plain words."""

import contextlib
import errno
import re
import time
from typing import Protocol, runtime_checkable

import serial

from .open_interface import BAUD, RESET, START


# A reboot takes about five seconds. Reading ends after 10, or after 2 seconds without a byte.
_SECONDS, _QUIET = 10.0, 2.0


@runtime_checkable
class Port(Protocol):
    """A serial line for the driver, such as a `serial.Serial`."""

    timeout: float | None
    write_timeout: float | None

    @property
    def in_waiting(self) -> int: ...
    def read(self, size: int = 1, /) -> bytes: ...
    def write(self, data: bytes, /) -> int | None: ...
    def fileno(self) -> int: ...
    def close(self) -> None: ...


def open_line(url: str) -> serial.SerialBase:
    """Open a device such as `/dev/ttyUSB0`, or a pySerial URL such as `socket://host:port`.

    Some adapters, such as those of FTDI, collect bytes for 16 ms by default. They are set to
    forward each byte immediately.

    **Raises:** `OSError` if the line does not exist, or another process uses it.
    """
    try:
        line = serial.serial_for_url(url, baudrate=BAUD, exclusive=True)
    except OSError as error:
        text = f"{url}: {plain(error)}"
        if error.errno in (errno.EACCES, errno.EPERM):
            text += (
                "; on Linux the user must be in the group dialout: sudo usermod -aG dialout $USER, "
                "then log out and in"
            )
        raise OSError(text) from None
    # A pseudo-terminal and a socket do not support this.
    with contextlib.suppress(AttributeError, NotImplementedError, OSError, ValueError):
        line.set_low_latency_mode(True)
    return line


def plain(error: OSError) -> str:
    """Return the message of an error without the error numbers of the operating system."""
    text = re.sub(r"\[Errno -?\d+\] ", "", str(error))
    return re.sub(r"\(\d+, '(.*)'\)", r"\1", text)


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
