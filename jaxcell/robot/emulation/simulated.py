import math
import time
from collections.abc import Callable

import serial

from ...base.process import end_by_signals
from ..create.driver import TICK
from ..create.motion import Create
from ..create.open_interface import STREAM_PERIOD, StreamParser
from ..create.reading import STREAM
from .emulator import Emulator, Moving


class SimulatedCreate(Create):
    """An armed [`jaxcell.robot.Create`][] that drives an emulated robot in emulated time.

    The driver, its commands and the frames of the robot are the same as with a serial line, but
    there is no line, no thread and no watchdog process. Time passes only when the driver waits for
    the robot, so that runs are reproducible on any machine.
    """

    robot: Emulator
    "The emulated robot, with its true pose."

    def __init__(self, robot: Emulator | Moving) -> None:
        """Connect to an emulator, or to a new one for a body, which runs as fast as possible."""
        if isinstance(robot, Emulator):
            self.robot, self._speedup = robot, robot.line.speedup
        else:
            self.robot, self._speedup = Emulator(robot), math.inf
        self._sent, self._woke = b"", time.monotonic()
        self._parser, self._tick_due = StreamParser(STREAM), TICK
        # The driver needs a line, but all bytes go to the robot directly.
        super().__init__(serial.serial_for_url("loop://"))
        self._greet()
        self.arm()

    def sleep(self, seconds: float) -> None:
        """Advance the time of the robot."""
        self._wait(lambda: False, seconds)

    def _connect(self) -> None:
        self._handled = end_by_signals()

    def _now(self) -> float:
        return self.robot.seconds

    def _wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        end = self._now() + seconds
        while not condition():
            rest = end - self._now()
            if rest <= 0:
                return False
            self._pass(min(rest, STREAM_PERIOD))
            sent, self._sent = self._sent, b""
            for values in self._parser.feed(sent):
                self._hear(values)
            if self._now() >= self._tick_due:
                self._tick_due = self._now() + TICK
                with self._news:
                    self._repeat()
        return True

    def _pass(self, seconds: float) -> None:
        rest = seconds / self._speedup - (time.monotonic() - self._woke)
        if rest > 0:
            time.sleep(rest)
        self._woke = time.monotonic()
        self._sent += self.robot.exchange(seconds)

    def _write(self, data: bytes) -> None:
        self._sent += self.robot.exchange(0.0, data)
