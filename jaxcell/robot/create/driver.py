"""Drive a Create 2 or Roomba 600 over a serial line, and stop its wheels after any failure."""

import contextlib
import math
import signal
import threading
import time
from collections.abc import Callable, Mapping
from typing import TypeVar

from ...base.process import end_by_signals, leave_signals
from .line import Port as Port, open_line, plain
from .open_interface import SAFE, START, STOP, StreamParser, drive_direct, stream, wheel_speeds
from .packets import Mode
from .reading import STREAM, Reading, Strain
from .watchdog import Watchdog


_STILL = drive_direct(right=0, left=0)

# After an incomplete command the robot waits for up to four bytes of data. Zeros complete it; after
# a complete command the robot ignores them.
_HALT = bytes(4) + _STILL + START

_D = TypeVar("_D", bound="Driver")

_UNARMED = "it is not armed"

TICK = 0.1
"""The interval in seconds at which a driver sends the speeds of the wheels again."""


class RobotStopped(RuntimeError):  # noqa: N818 (it names an event, as StopIteration does)
    """Raised when the driver has stopped the wheels; the message contains the reason."""


class Driver:
    """A robot on a serial line, whose wheels turn only while this is safe.

    The wheels stop at the end of the `with` block, even if SIGINT, SIGTERM or SIGHUP ends it. They
    also stop

    - when a wheel drops or is blocked, the robot meets a cliff or a charger, the battery is low,
      the robot leaves mode Safe, or it sends nothing for `patience` seconds. Then `drive` raises
      [`RobotStopped`][] until the caller arms the robot again;
    - when the caller does not call `drive` again within `patience` seconds;
    - when this process is killed or hangs, because a second process watches it.

    One thread reads the stream, and stops the wheels without waiting for the caller. Ten times per
    second, another thread repeats the speeds, because commands can get lost, and checks for
    silence.

    **Arguments:**

    - `port`: an open line at 115200 baud, which `close` closes.
    - `patience`: the longest silence of the robot or the caller, from 0.2 to 10 seconds.

    **Raises:** `ValueError` if `patience` is outside this range. The `with` statement raises
    `OSError` if the line fails, and `ConnectionError` if no robot answers.
    """

    def __init__(self, port: Port, *, patience: float = 0.5):
        if not 2 * TICK <= patience <= 10:
            raise ValueError(f"patience = {patience}: expected {2 * TICK} to 10 seconds")
        self._port = port
        self._patience = patience
        # The lock of the fields below and of writes to the line; it is notified of each reading.
        self._news = threading.Condition(threading.RLock())
        self._reading: Reading | None = None
        self._first_mode = 0
        # The reason why the robot must not drive, or `None` if it is armed.
        self._reason: str | None = _UNARMED
        # True to repeat the halt until the robot reports a mode in which it does not drive.
        self._halting = False
        self._wheels = (0, 0)
        self._strain = Strain()
        self._renewed = -math.inf
        self._stop_on_bump = False
        self._bumped = False

        self._closing = threading.Event()
        self._threads: list[threading.Thread] = []
        self._watchdog: Watchdog | None = None
        self._handled: list[signal.Signals] = []

    @classmethod
    def open(cls: type[_D], url: str, *, patience: float = 0.5) -> _D:
        """Open the line to a robot at `url`, a device or a pySerial URL such as `socket://host:port`."""
        return cls(open_line(url), patience=patience)

    def __enter__(self: _D) -> _D:
        try:
            self._connect()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the wheels, switch the robot to mode Off, and close the line."""
        with self._news:
            self._reason = "it is closed"
            self._halt(self._reason)
        if self._threads:
            self._wait(lambda: not self._halting, 0.5)
        self._closing.set()
        for thread in self._threads:
            thread.join()
        self._threads.clear()
        with self._news:
            self._write(_HALT + STOP)
        if self._watchdog is not None:
            self._watchdog.dismiss()
            self._watchdog = None
        self._port.close()
        leave_signals(self._handled)
        self._handled.clear()

    def arm(self) -> None:
        """Switch the robot to mode Safe, in which it can drive.

        **Raises:** [`RobotStopped`][] if the robot is in danger, or does not enter mode Safe.
        """
        if (danger := self.sensors().danger) is not None:
            raise RobotStopped(danger)
        for _ in range(3):
            with self._news:
                self._halting = False
                self._wheels, self._strain = (0, 0), Strain()
                self._write(SAFE + _STILL)
                if self._wait(lambda: self._in(Mode.SAFE), 0.5):
                    self._reason = None
                    return
        with self._news:
            self._halt("it does not go to mode Safe")
        raise RobotStopped("it does not go to mode Safe")

    def sensors(self) -> Reading:
        """Return the latest reading. Raises [`RobotStopped`][] if it is older than `patience`."""
        with self._news:
            reading = self._reading
            if reading is None or self._now() - reading.time > self._patience:
                known = self._reason not in (None, _UNARMED)
                raise RobotStopped(self._reason if known else f"no reading for {self._patience} s")
            return reading

    def drive(self, *, right: float, left: float, stop_on_bump: bool = False) -> bool:
        """Set the speeds of the wheels, from -0.5 to 0.5 m/s, for at most `patience` seconds.

        If the bytes of the speeds contain the opcode of a command, which the robot could execute
        when another byte is lost, the next slower speeds on the same arc are sent. Speeds of 0.008
        to 0.082 and 0.174 to 0.248 m/s in turns on the spot, and 0.008 to 0.127 m/s straight ahead,
        are sent unchanged. With `stop_on_bump`, a bump stops the wheels immediately, and they stand
        still until the next call of `stop`, or of `drive` without `stop_on_bump`.

        **Returns:** `True` if the robot drives, and `False` after a bump.

        **Raises:** [`RobotStopped`][] if the robot is not armed.
        """
        wheels = wheel_speeds(right=right, left=left)
        with self._news:
            self._stop_on_bump = stop_on_bump
            self._bumped = stop_on_bump and (self._bumped or self.sensors().bump)
            self._renewed = self._now()
            if self._reason is None:
                self._roll((0, 0) if self._bumped else wheels)
            if self._reason is not None:
                raise RobotStopped(self._reason)
            return not self._bumped

    def stop(self) -> None:
        """Stop the wheels. The robot stays armed."""
        with self._news:
            self._stop_on_bump = self._bumped = False
            self._wheels = (0, 0)
            self._write(_STILL)

    def _after(self, reading: Reading) -> Reading:
        """Wait for a reading newer than `reading`."""
        self._wait(lambda: self._reading is not reading, self._patience)
        return self.sensors()

    def _now(self) -> float:
        return time.monotonic()

    def _in(self, mode: Mode) -> bool:
        return self._reading is not None and self._reading.mode is mode

    def _wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        with self._news:
            return self._news.wait_for(condition, seconds)

    def _connect(self) -> None:
        self._handled = end_by_signals()
        self._port.timeout = TICK
        self._port.write_timeout = self._patience
        self._watchdog = Watchdog.on_line(
            self._port.fileno(),
            pause=_HALT,
            farewell=_HALT + STOP,
            patience=max(1.0, 2 * self._patience),
        )
        self._threads = [
            threading.Thread(target=self._listen, daemon=True),
            threading.Thread(target=self._tick, args=(self._watchdog,), daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        for attempt in range(3):
            if attempt == 1:
                self._wake()
            if self._greet():
                return
        raise ConnectionError(
            "the robot sends no readings: is it on, and on this line, and is the line 115200 baud?"
        )

    def _greet(self) -> bool:
        """Open the interface in mode Passive, start the stream, and return whether it arrives."""
        # The robot needs a moment to change its mode.
        for command in (_HALT + STOP, START):
            with self._news:
                self._write(command)
            self._wait(lambda: False, 0.05)
        with self._news:
            self._first_mode = 0
            self._reading = None
            self._write(stream(STREAM))
            if not self._wait(lambda: self._reading is not None, 1.0):
                return False
            # The robot is in mode Passive. If it reports 2, it counts its modes from 1.
            self._first_mode = int(self._in(Mode.SAFE))
            return self._wait(lambda: self._in(Mode.PASSIVE), 1.0)

    def _wake(self) -> None:
        """Wake the robot with a pulse on its pin BRC, if the cable connects BRC to RTS or DTR."""
        for line in ("rts", "dtr"):
            # A pseudo-terminal has no such lines, and raises OSError 25.
            with contextlib.suppress(OSError, AttributeError):
                setattr(self._port, line, True)
                time.sleep(0.1)
                setattr(self._port, line, False)

    def _listen(self) -> None:
        parser = StreamParser(STREAM)
        while not self._closing.is_set():
            try:
                data = self._port.read(max(1, self._port.in_waiting))
            except OSError as error:
                with self._news:
                    self._halt(f"the line is lost: {plain(error)}")
                return
            for values in parser.feed(data):
                self._hear(values)

    def _hear(self, values: Mapping[str, int]) -> None:
        with self._news:
            time, before, first_mode = self._now(), self._reading, self._first_mode
            now = Reading.of(values, time=time, previous=before, first_mode=first_mode)
            self._reading = now
            if now.mode <= Mode.PASSIVE:
                self._halting = False
            blocked = self._strain.observe(self._wheels, now)
            if self._reason is None:
                if (danger := now.danger or blocked) is not None:
                    self._halt(danger)
                elif now.mode is not Mode.SAFE:
                    self._halt(f"it went from mode Safe to {now.mode.name.capitalize()}")
                elif self._stop_on_bump and now.bump and not self._bumped:
                    self._bumped = True
                    self._roll((0, 0))
            self._news.notify_all()

    def _tick(self, watchdog: Watchdog) -> None:
        while not self._closing.wait(TICK):
            with self._news:
                try:
                    watchdog.beat()
                except OSError as error:
                    self._halt(f"the watchdog is gone: {plain(error)}")
                self._repeat()

    def _repeat(self) -> None:
        """Repeat the speeds, or stop the wheels if the robot or the caller is silent too long."""
        now = self._now()
        if self._reason is None:
            if self._reading is None or now - self._reading.time > self._patience:
                self._halt(f"no reading for {self._patience} s")
            elif now - self._renewed > self._patience:
                self._wheels = (0, 0)
        if self._reason is None:
            right, left = self._wheels
            self._write(drive_direct(right=right, left=left))
        elif self._halting:
            self._write(_HALT)

    def _roll(self, wheels: tuple[int, int]) -> None:
        if wheels != self._wheels:
            self._wheels = wheels
            self._write(drive_direct(right=wheels[0], left=wheels[1]))

    def _halt(self, reason: str) -> None:
        self._forbid(reason)
        self._write(_HALT)

    def _forbid(self, reason: str) -> None:
        # The first reason is the cause of the others.
        if self._reason in (None, _UNARMED):
            self._reason = reason
        self._halting = True
        self._wheels = (0, 0)
        self._news.notify_all()

    def _write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except OSError as error:
            self._forbid(f"the line is lost: {plain(error)}")
