"""Sketches for small tasks, and an Arduino that runs them with an emulated robot."""

import contextlib
import dataclasses
import functools
import math
import os
import re
import shutil
import struct
import subprocess
import tempfile
from pathlib import Path

from recording_robot import RecordingRobot
from wheels import bounce_filter

from jaxcell.automata import Filter
from jaxcell.bounce import localization_policy
from jaxcell.robot.create.open_interface import Command
from jaxcell.robot.create.packets import Mode
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.sketch import bounce_sketch
from jaxcell.robot.tasks.files import FilterTask, PolicyTask
from jaxcell.space import CellSpace, Workspace


COMPILER = next(filter(shutil.which, ("c++", "g++", "clang++")), None)
_STUB = Path(__file__).parent / "robot" / "arduino_stub"
_STRICT = ["-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
_FOLDER = tempfile.TemporaryDirectory()


def task_of(cells: CellSpace, bounce_deg: float, filter: Filter | None = None) -> FilterTask:
    sizes = cells.cell, cells.directions, cells.cell, cells.workspace.robot_radius
    filter = bounce_filter(cells, bounce_deg) if filter is None else filter
    return FilterTask(Path("filter.jxf"), *sizes, filter, math.radians(bounce_deg))


# An L-shaped room with cells of 25 cm, for short runs.
ROOM = CellSpace.of(
    Workspace([(0, 0), (1.25, 0), (1.25, 0.5), (0.5, 0.5), (0.5, 1), (0, 1)]), 0.25, 4
)
ROOM_TASK = task_of(ROOM, 90)
BOUNCE = bounce_sketch(math.radians(90), 0.25)


@functools.cache
def policy_task() -> PolicyTask:
    bounces = math.radians(90), math.radians(180)
    policy = localization_policy(ROOM, bounces).policy
    return PolicyTask(Path("policy.jxf"), ROOM.cell, 4, ROOM.cell, 0.0, bounces, policy)


@functools.cache
def compiled(text: str, *flags: str) -> Path:
    """Compile the program of a sketch on a board."""
    folder = Path(tempfile.mkdtemp(dir=_FOLDER.name))
    (folder / "sketch.ino").write_text(text)
    sketch = f'-DSKETCH="{folder / "sketch.ino"}"'
    _build(_STUB / "sketch.cpp", *flags, sketch, _board(), "-o", folder / "program")
    return folder / "program"


@functools.cache
def _board() -> Path:
    board = Path(_FOLDER.name) / "board.o"
    _build(_STUB / "board.cpp", "-DHAVE_HWSERIAL1", "-c", "-o", board)
    return board


def _build(*arguments: str | Path) -> None:
    subprocess.run([COMPILER, *_STRICT, "-D__AVR__", f"-I{_STUB}", *arguments], check=True)


class Robot(RecordingRobot):
    """An emulated robot that runs on the time of the board, and has a line with several speeds."""

    def __init__(self, body: Body, *, baud: int = 115200, wire: bool = True, **fields) -> None:
        super().__init__(body, **fields)
        self.baud, self._wire = baud, wire
        self.damage = lambda sent: sent
        "The function that changes the bytes of the robot."
        self._pulse, self._pulses = math.inf, 0

    def talk(self, until: float, data: bytes) -> bytes:
        """Advance the time, receive the bytes of the board, and return the answer."""
        while self.seconds < until:
            self._pass(min(0.015, until - self.seconds))
            self._keep_safe()
        for command in self._parser.feed(self._lossy(data)):
            self._do(command)
        self._keep_safe()
        sent, self._sent = self.damage(self._lossy(self._sent)), b""
        return sent

    def wake_line(self, high: bool) -> None:
        """Change to 19200 baud after three pulses of 50 to 500 ms."""
        if not self._wire:
            return
        if high and 0.05 <= self.seconds - self._pulse <= 0.5:
            self._pulses += 1
            if self._pulses == 3:
                self.baud = 19200
        elif not high:
            self._pulse = self.seconds

    def _do(self, command: Command) -> None:
        if command.opcode == 129 and self.mode is not Mode.OFF and not self.deaf:
            self.baud = {7: 19200, 11: 115200}.get(command.data[0], self.baud)
        super()._do(command)


@dataclasses.dataclass
class Run:
    """The run of a sketch."""

    usb: str = ""
    "The text that the sketch printed."
    end: str | None = None
    "The end that the sketch printed, or `None` without an end."
    resets: int = 0
    led: list[tuple[float, int]] = dataclasses.field(default_factory=list)
    "The times at which the LED was set, and the values."

    @property
    def observed(self) -> str:
        return "".join(re.findall(r"^([01])(?: \d+)?$", self.usb, re.MULTILINE))

    @property
    def colors(self) -> tuple[int, ...]:
        return tuple(int(c) for c in re.findall(r"^[01] (\d+)$", self.usb, re.MULTILINE))


def play(program: Path, robot: Robot, *, seconds: float, rest: float = 2.0, at=None, **env) -> Run:
    """Run a sketch for some seconds, or until `rest` seconds after its end.

    `at` is called before each exchange, with the run and the time in seconds.
    """
    run, now, ends, baud = Run(), 0.0, seconds, 0
    with subprocess.Popen(
        [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, **env}
    ) as board:
        assert board.stdin is not None
        assert board.stdout is not None
        while now < ends:
            match kind := board.stdout.read(1):
                case b"X":
                    time, count = struct.unpack("<QH", board.stdout.read(10))
                    data, now = board.stdout.read(count), time / 1e6
                    if at is not None:
                        at(run, now)
                    answer = robot.talk(now, data if baud == robot.baud else b"")
                    answer = answer if baud == robot.baud else b""
                    board.stdin.write(struct.pack("<H", len(answer)) + answer)
                    board.stdin.flush()
                case b"T":
                    run.usb += board.stdout.read(
                        *struct.unpack("<H", board.stdout.read(2))
                    ).decode()
                case b"B":
                    (baud,) = struct.unpack("<I", board.stdout.read(4))
                case b"P":
                    pin, value = board.stdout.read(2)
                    if pin == 5:
                        robot.wake_line(bool(value))
                    elif pin == 13:
                        run.led.append((now, value))
                case b"R":
                    run.resets += 1
                case _:
                    raise AssertionError(f"{kind!r}: the program is gone")
            if run.end is None and (found := re.search(r"^end: (.*)\n", run.usb, re.MULTILINE)):
                run.end, ends = found[1], now + rest
        with contextlib.suppress(BrokenPipeError):
            board.stdin.close()
        board.stdout.close()
    return run


def stands_still(robot: Robot) -> bool:
    return robot.wheels == (0, 0) and robot.mode in (Mode.PASSIVE, Mode.OFF)
