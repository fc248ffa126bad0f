"""A separate process that stops the robot when the process that drives it ends or hangs.

A process that is killed by SIGKILL cannot stop the wheels. Therefore the driver starts the
watchdog, which inherits the open serial line and a pipe. The driver writes into the pipe ten times
per second. When the pipe closes, or stays silent for too long, the watchdog stops the robot. It has
its own session and ignores the signals of the terminal, so that they do not end it together with
the driver. It cannot help if both processes are killed together (as when a container or `systemd`
unit is killed as a whole).

The process runs this file alone, with a few modules of the standard library, to start quickly.
"""

import contextlib
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Sequence


_READY = b"r"
_BEAT = b"b"
_GOODBYE = b"q"


class Watchdog:
    """A handle with which a driver controls its watchdog process.

    The process runs `command`, which must call `watch`; it inherits the file descriptors `lines`.

    **Raises:** `OSError` if the process does not start.
    """

    def __init__(self, command: Sequence[str], *, lines: Sequence[int] = ()):
        # Imported here because the child does not need it.
        import subprocess

        beats, self._beats = os.pipe()
        # A beat must not block if the watchdog hangs.
        os.set_blocking(self._beats, False)
        try:
            self._process = subprocess.Popen(
                command,
                stdin=beats,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                pass_fds=lines,
                start_new_session=True,
            )
        except OSError:
            os.close(self._beats)
            raise
        finally:
            os.close(beats)
        ready = b""
        if self._process.stdout is not None:
            with self._process.stdout as output:
                if select.select([output], [], [], 30)[0]:
                    ready = output.read(1)
        if ready != _READY:
            self._process.kill()
            self._end()
            raise OSError("the watchdog process did not start")

    @classmethod
    def on_line(cls, line: int, *, pause: bytes, farewell: bytes, patience: float) -> "Watchdog":
        """Start a watchdog for the robot on a serial line, whose file descriptor is `line`.

        It sends the bytes `pause` whenever the driver is silent for `patience` seconds, and the
        bytes `farewell` when the driver has ended.
        """
        command = (sys.executable, "-I", "-S", os.path.abspath(__file__))
        words = (str(line), pause.hex(), farewell.hex(), str(patience))
        return cls([*command, *words], lines=[line])

    @property
    def pid(self) -> int:
        """The identifier of the process."""
        return self._process.pid

    def beat(self) -> None:
        """Signal that the driver is alive. Raises `OSError` if the watchdog has ended."""
        os.write(self._beats, _BEAT)

    def dismiss(self) -> None:
        """End the watchdog without stopping the robot, which the driver has already stopped."""
        with contextlib.suppress(OSError):
            os.write(self._beats, _GOODBYE)
        self._end()

    def _end(self) -> None:
        os.close(self._beats)
        self._process.wait()


def watch(pause: Callable[[], None], farewell: Callable[[], None], patience: float) -> None:
    """Run the loop of the watchdog process.

    Both `pause` and `farewell` stop the robot. `pause` is called whenever the driver is silent for
    `patience` seconds, and `farewell` when the driver has ended.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGPIPE", "SIGTSTP"):
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    os.write(1, _READY)
    while True:
        if not select.select([0], [], [], patience)[0]:
            pause()
            continue
        words = os.read(0, 4096)
        if _GOODBYE in words:
            return
        if not words:
            break
    farewell()


def _watch_line(line: int, pause: bytes, farewell: bytes, patience: float) -> None:
    def end() -> None:
        for _ in range(3):
            _write(line, farewell)
            time.sleep(0.05)

    watch(lambda: _write(line, pause), end, patience)


def _write(line: int, data: bytes) -> None:
    """Write `data` to a line that may block. Give up after one second."""
    end = time.monotonic() + 1
    while data and time.monotonic() < end:
        try:
            if select.select([], [line], [], 0.1)[1]:
                data = data[os.write(line, data) :]
        except BlockingIOError:
            continue
        except OSError:
            return


if __name__ == "__main__":
    _watch_line(
        int(sys.argv[1]), bytes.fromhex(sys.argv[2]), bytes.fromhex(sys.argv[3]), float(sys.argv[4])
    )
