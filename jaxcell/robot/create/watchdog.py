"""A separate process that stops the robot when the process that drives it ends or hangs.

The Open Interface has no timeout: the wheels keep their last speed until the next command.
A process that is killed by SIGKILL cannot stop them. So the driver starts this one, which inherits
the open serial line and a pipe. The driver beats into the pipe. When the pipe ends, or stays silent
for too long, the watchdog writes the stop itself. It is in a session of its own and ignores the
signals of the terminal, so that what stops the driver does not stop it.

What it cannot help against: a cable pulled out, the loss of power of the computer, and whatever
kills both processes at once (a container or `systemd` unit that is killed whole).

The child runs this file alone, with a few modules of the standard library, to be there at once.
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
    """The driver's side of the watchdog.

    The process runs `command`, which calls `watch`, and inherits the file descriptors `lines`.

    **Raises:** `OSError` if the process does not start.
    """

    def __init__(self, command: Sequence[str], *, lines: Sequence[int] = ()):
        # Here, as the child has no use for it.
        import subprocess

        beats, self._beats = os.pipe()
        # So that a watchdog that hangs cannot make a beat block.
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
        """Watch over a robot on a serial line.

        The watchdog writes `pause` whenever there was no beat for `patience` seconds, and
        `farewell` when the driver is gone.

        **Raises:** `OSError` if the process does not start.
        """
        command = (sys.executable, "-I", "-S", os.path.abspath(__file__))
        words = (str(line), pause.hex(), farewell.hex(), str(patience))
        return cls([*command, *words], lines=[line])

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._process.pid

    def beat(self) -> None:
        """Report that the driver is alive.

        **Raises:** `OSError` if the watchdog is not.
        """
        os.write(self._beats, _BEAT)

    def dismiss(self) -> None:
        """End the watchdog without a farewell, once the driver has stopped the robot itself."""
        with contextlib.suppress(OSError):
            os.write(self._beats, _GOODBYE)
        self._end()

    def _end(self) -> None:
        os.close(self._beats)
        self._process.wait()


def watch(pause: Callable[[], None], farewell: Callable[[], None], patience: float) -> None:
    """Stop the robot when the driver is silent or gone; the loop of the process.

    `pause` is called whenever there was no beat for `patience` seconds, and `farewell` when the
    driver is gone.
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
    """Write all of `data`, whether or not the line blocks, for at most a second."""
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
