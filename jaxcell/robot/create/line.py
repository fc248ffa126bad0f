"""Open the serial line to a robot, and say in words what is wrong with it."""

import contextlib
import errno
import re
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from .open_interface import BAUD


if TYPE_CHECKING:
    import serial


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


def open_line(url: str) -> "serial.SerialBase":
    """Open a device such as `/dev/ttyUSB0`, or an address of pySerial such as `socket://host:port`.

    Where the adapter of the line can, as those of FTDI, it passes bytes on at once and does not
    gather them for 16 ms.

    **Raises:** `OSError` with a sentence if there is no such line, or another process has it.
    """
    import serial

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
    # Neither a pseudo-terminal nor a socket has this.
    with contextlib.suppress(AttributeError, NotImplementedError, OSError, ValueError):
        line.set_low_latency_mode(True)
    return line


def plain(error: OSError) -> str:
    """Get the text of an error of a line, without numbers of the operating system."""
    text = re.sub(r"\[Errno -?\d+\] ", "", str(error))
    return re.sub(r"\(\d+, '(.*)'\)", r"\1", text)
