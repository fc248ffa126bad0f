import contextlib
import dataclasses
import functools
import itertools
import math
import os
import re
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from recording_robot import RecordingRobot
from wheels import body_in, bounce_filter, bounce_tables, map_cells

from jaxcell.automata import Filter, fewest_bytes, subset_construction, to_c_header
from jaxcell.bounce import localization_policy
from jaxcell.robot.create.open_interface import Command
from jaxcell.robot.create.packets import Contact, Mode
from jaxcell.robot.emulation.body import Body, Noise
from jaxcell.robot.emulation.emulator import Line
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.followers import FilterFollower, PolicyFollower, run_follower
from jaxcell.robot.sketch import (
    PROGRAM_BYTES,
    bounce_sketch,
    filter_sketch,
    policy_sketch,
    policy_table_bytes,
    table_bytes,
)
from jaxcell.robot.tasks.files import FilterTask, PolicyTask
from jaxcell.robot.walker import Walker
from jaxcell.space import CellSpace, Workspace


STUB = Path(__file__).with_name("arduino_stub")
COMPILER = next(filter(shutil.which, ("c++", "g++", "clang++")), None)
STRICT = ["-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
LAB_A, LAB_B = map_cells("lab_a.json"), map_cells("lab_b.json")
# The filter of this map has more than 255 states, which need wider tables.
MAZE = map_cells("maze.txt", directions=8)

needs_compiler = pytest.mark.skipif(
    COMPILER is None, reason="no C++ compiler (c++, g++, clang++) to compile the sketch with"
)


def task_of(cells: CellSpace, bounce_deg: float, filter: Filter | None = None) -> FilterTask:
    return FilterTask(
        path=Path("filter.jxf"),
        cell=cells.cell,
        directions=cells.directions,
        step=cells.cell,
        radius=cells.workspace.robot_radius,
        filter=bounce_filter(cells, bounce_deg) if filter is None else filter,
        bounce=math.radians(bounce_deg),
    )


@pytest.fixture(scope="module")
def compiled(tmp_path_factory) -> Callable[..., Path]:
    """A function that compiles a sketch for a board, which is compiled once."""
    folder = tmp_path_factory.mktemp("sketch")
    build(STUB / "board.cpp", "-DHAVE_HWSERIAL1", "-c", "-o", folder / "board.o")

    @functools.cache
    def program(text: str, *flags: str) -> Path:
        place = Path(tempfile.mkdtemp(dir=folder))
        (place / "sketch.ino").write_text(text)
        sketch = f'-DSKETCH="{place / "sketch.ino"}"'
        build(STUB / "sketch.cpp", *flags, sketch, folder / "board.o", "-o", place / "program")
        return place / "program"

    return program


def build(*arguments: str | Path) -> None:
    subprocess.run([COMPILER, *STRICT, "-D__AVR__", f"-I{STUB}", *arguments], check=True)


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
        while self._now < until:
            self._pass(min(0.015, until - self._now))
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
        if high and 0.05 <= self._now - self._pulse <= 0.5:
            self._pulses += 1
            if self._pulses == 3:
                self.baud = 19200
        elif not high:
            self._pulse = self._now

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


def expected(cells, cell, task, *, known: bool = True, **fields):
    """Run the filter on a host from the same start."""
    walker = Walker(
        SimulatedCreate(body_in(cells, cell, **fields)),
        task.step,
        strides=task.strides if known else None,
        direction=cell // cells.positions if known else 0,
    )
    return run_follower(walker, FilterFollower(task.filter, "cycle"), [task.bounce], limit=200)


def room(cell: float) -> CellSpace:
    """An L-shaped room without a symmetry."""
    corners = [(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)]
    return CellSpace.of(Workspace([(cell * x, cell * y) for x, y in corners]), cell, 4)


def smallest_machine(source):
    pytest.importorskip("pysat.solvers")
    return fewest_bytes(source).machine


# Cells of 25 cm, for short runs.
ROOM = room(0.25)
ROOM_TASK = task_of(ROOM, 90)
ROOM_IMAGE, ROOM_BUMPED = bounce_tables(ROOM, 90)


@needs_compiler
@pytest.mark.parametrize(
    ("cells", "bounce_deg", "cell", "smallest"),
    [
        (LAB_A, 45, 28, False),
        (LAB_A, 45, 28, True),
        (LAB_B, 135, 16, False),
        (MAZE, 45, 131, False),
        (ROOM, 90, 9, False),
    ],
)
def test_the_colours_are_those_of_the_host(compiled, cells, bounce_deg, cell, smallest):
    task = task_of(cells, bounce_deg)
    machine = smallest_machine(task.filter) if smallest else None
    robot = Robot(body_in(cells, cell))
    program = compiled(filter_sketch(task, direction=cell // cells.positions, machine=machine))
    run = play(program, robot, seconds=600)
    host = expected(cells, cell, task)
    assert host.result == "localized"
    assert run.observed == host.observations
    assert run.colors == host.colors
    assert run.end == "localized"
    assert f"configurations: {len(host.cells)}\n" in run.usb
    # The robot has turned after its last bump too.
    assert int(cells.index(*robot.pose)) in host.cells
    assert stands_still(robot)
    assert run.led[-1][1] == 1
    assert [command.opcode for _, command in robot.commands if command.opcode == 141] == [141]


@needs_compiler
@pytest.mark.parametrize("open_world", [False, True])
def test_another_map_is_refuted_where_the_host_refutes_it(compiled, open_world):
    cell = 9
    filter = bounce_filter(LAB_B, 45, open_world=open_world)
    task = task_of(ROOM, 45, filter)
    task = dataclasses.replace(task, directions=8)
    here = CellSpace.of(ROOM.workspace, ROOM.cell, 8)
    robot = Robot(body_in(here, cell))
    run = play(compiled(filter_sketch(task, direction=0)), robot, seconds=600)
    host = expected(here, cell, task)
    assert host.result == "refuted"
    assert run.observed == host.observations
    assert run.colors == host.colors
    assert run.colors[-1] == (filter.color[-1] if open_world else 0)
    assert run.end == "refuted: the map is another, or the robot slipped"
    assert stands_still(robot)
    # It blinks fast: 4 times a second.
    states = [on for _, on in run.led[-300:]]
    assert 6 <= sum(a < b for a, b in itertools.pairwise(states)) <= 10


@needs_compiler
def test_a_heading_is_not_needed_where_all_steps_are_equal(compiled):
    program = compiled(filter_sketch(ROOM_TASK))
    # The robot faces North, but the sketch does not know this.
    cell = 25
    run = play(program, Robot(body_in(ROOM, cell)), seconds=600)
    host = expected(ROOM, cell, ROOM_TASK, known=False)
    assert (run.observed, run.colors) == (host.observations, host.colors)
    assert run.end == host.result == "localized"


@functools.cache
def policy_task() -> PolicyTask:
    bounces = math.radians(90), math.radians(180)
    return PolicyTask(
        path=Path("policy.jxf"),
        cell=ROOM.cell,
        directions=ROOM.directions,
        step=ROOM.cell,
        radius=0.0,
        policy=localization_policy(ROOM, bounces).policy,
        bounces=bounces,
    )


@needs_compiler
@pytest.mark.parametrize("smallest", [False, True])
def test_a_policy_chooses_the_angles_that_the_host_does(compiled, smallest):
    task, cell = policy_task(), 9
    machine = smallest_machine(task.policy) if smallest else None
    robot = Robot(body_in(ROOM, cell))
    text = policy_sketch(task, direction=cell // ROOM.positions, machine=machine)
    run = play(compiled(text), robot, seconds=600)
    body = SimulatedCreate(body_in(ROOM, cell))
    walker = Walker(body, task.step, strides=task.strides, direction=cell // ROOM.positions)
    host = run_follower(walker, PolicyFollower(task.policy), task.bounces)
    assert (run.end, host.result) == ("localized", "localized")
    assert run.observed == host.observations
    # A smallest machine has other colours.
    assert smallest or run.colors == host.colors
    assert f"configurations: {len(host.cells)}\n" in run.usb
    assert int(ROOM.index(*robot.pose)) in host.cells


BOUNCE = bounce_sketch(math.radians(90), 0.25)


def check_places(run: Run, places: list[tuple[float, float, float]], cell: int) -> None:
    """Check that a robot which only bounces went from cell to cell as the map says."""
    for bumped, (x, y, _) in zip(run.observed, places, strict=True):
        assert int(bumped) == ROOM_BUMPED[cell]
        cell = int(ROOM_IMAGE[cell])
        assert math.dist((x, y), [float(part) for part in ROOM.centre(cell)[:2]]) < 0.02


@needs_compiler
@pytest.mark.parametrize(("byte", "seconds"), [(None, 45), (0, 17), (10, 17), (14, 17)])
def test_a_robot_that_only_bounces_is_where_the_cells_say(compiled, byte, seconds):
    """This holds even if every fifth answer has a wrong bumper or a wrong byte of an encoder."""
    robot, count = Robot(body_in(ROOM, 5)), itertools.count()
    places: list[tuple[float, float, float]] = []

    def wrong(sent: bytes) -> bytes:
        if byte is None or len(sent) != 24 or next(count) % 5:
            return sent
        return sent[:byte] + bytes([sent[byte] ^ 1]) + sent[byte + 1 :]

    def look(run: Run, now: float) -> None:
        if len(run.observed) > len(places):
            places.append(robot.pose)
        robot.damage = wrong

    run = play(compiled(BOUNCE), robot, seconds=seconds, at=look)
    assert run.end is None
    assert run.colors == ()
    assert len(places) >= seconds // 5
    assert seconds < 45 or run.observed.count("1") > 3
    check_places(run, places, 5)


def after(count: int, act):
    """Call `act` from half a second after a number of observations."""
    begun: list[float] = []

    def at(run: Run, now: float) -> None:
        if len(run.observed) >= count:
            begun.append(now)
        if begun and now - begun[0] > 0.5:
            act()

    return at


@needs_compiler
@pytest.mark.parametrize(
    ("danger", "end"),
    [
        (lambda r: setattr(r, "contact", Contact.WHEEL_DROP_LEFT), "a wheel hangs in the air"),
        (lambda r: r.cliffs.add("cliff_front_left"), "there is a cliff"),
        (lambda r: setattr(r, "charger", True), "it is on the charger"),
        (lambda r: setattr(r, "charge", 240.0), "the battery is low"),
        (lambda r: setattr(r, "mode", Mode.PASSIVE), "it is not in mode Safe"),
        # The wheels do not turn.
        (lambda r: setattr(r.body, "advance", lambda *_: None), "a motion takes too long"),
    ],
)
def test_the_sketch_stops_the_robot_in_danger(compiled, danger, end):
    robot = Robot(body_in(ROOM, 0))
    run = play(compiled(BOUNCE), robot, seconds=40, at=after(1, lambda: danger(robot)))
    assert run.observed.startswith("0")
    assert run.end == f"stopped: {end}"
    assert stands_still(robot)


@needs_compiler
def test_a_lost_line_stops_the_wheels_at_once(compiled):
    robot = Robot(body_in(ROOM, 0))
    silent: list[float] = []
    rolling: list[float] = []

    def at(run: Run, now: float) -> None:
        if run.observed and robot.wheels != (0, 0) and not silent:
            silent.append(now)
            robot.damage = lambda sent: b""
        if silent and robot.wheels != (0, 0):
            rolling.append(now - silent[0])

    run = play(compiled(BOUNCE), robot, seconds=40, at=at)
    assert run.end == "stopped: the robot does not answer"
    assert max(rolling) < 0.15
    # The line works again, but the run is over.
    assert stands_still(robot)


@needs_compiler
def test_a_sketch_that_hangs_is_reset_and_stops_the_robot(compiled):
    robot = Robot(body_in(ROOM, 0))
    rolling: list[float] = []

    def at(run: Run, now: float) -> None:
        if robot.wheels != (0, 0):
            rolling.append(now)

    run = play(compiled(BOUNCE), robot, seconds=40, rest=10, at=at, HANG_AT="8000000")
    assert run.observed
    assert run.resets == 1
    assert run.end == "stopped: the board was reset while it drove"
    assert 9.5 < max(rolling) < 10.3
    assert stands_still(robot)


@needs_compiler
@pytest.mark.parametrize("flags", [(), ("-DHAVE_HWSERIAL1",)])
def test_the_line_comes_to_19200_baud(compiled, flags):
    program = compiled(BOUNCE, *flags)
    for fields in ({"baud": 19200}, {"baud": 115200}, {"baud": 115200, "wire": False}):
        robot = Robot(body_in(ROOM, 0), **fields)
        run = play(program, robot, seconds=9)
        assert run.observed.startswith("0")
        assert robot.baud == 19200


@needs_compiler
@pytest.mark.parametrize(
    ("change", "end"),
    [({"deaf": True}, "stopped: the robot does not answer"), ({"first_mode": 1}, None)],
)
def test_a_deaf_robot_ends_a_sketch_and_modes_from_1_do_not(compiled, change, end):
    robot = Robot(body_in(ROOM, 0))
    vars(robot).update(change)
    run = play(compiled(BOUNCE), robot, seconds=60 if end else 9)
    assert run.end == end
    assert run.observed.startswith("0") is (end is None)


@needs_compiler
def test_bytes_that_get_lost_change_nothing(compiled):
    cell = 9
    robot = Robot(body_in(ROOM, cell), line=Line(dropped=0.002), seed=1)
    run = play(compiled(filter_sketch(ROOM_TASK, direction=0)), robot, seconds=600)
    host = expected(ROOM, cell, ROOM_TASK)
    assert (run.observed, run.colors) == (host.observations, host.colors)
    assert run.end == "localized"
    assert stands_still(robot)


def damaged(data: bytes, rng: np.random.Generator, rate: float) -> bytes:
    """Lose, change or double some bytes."""
    kinds = rng.random(len(data))
    noise = rng.integers(0, 256, len(data), np.uint8).tobytes()
    return b"".join(
        b""
        if kind < rate
        else bytes(n for n in noise[i : i + 1])
        if kind < 2 * rate
        else data[i : i + 1] * 2
        if kind < 3 * rate
        else data[i : i + 1]
        for i, kind in enumerate(kinds)
    )


@needs_compiler
def test_the_data_of_a_drive_command_are_not_opcodes(compiled):
    # The robot would obey opcodes if the first byte got lost. Noisy encoders make it steer a lot.
    noise = Noise(encoder=1.0)
    robot = Robot(body_in(ROOM, 0, noise=noise, rng=np.random.default_rng(0)))
    play(compiled(BOUNCE), robot, seconds=12)
    wheels = b"".join(command.data for _, command in robot.commands if command.opcode == 145)
    assert len(set(wheels)) > 30
    assert not {7, *range(128, 174)} & set(wheels)


@needs_compiler
@settings(max_examples=4)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.1, 0.5]))
def test_a_sketch_never_hangs_on_a_damaged_line(compiled, seed, rate):
    robot, rng = Robot(body_in(ROOM, 0)), np.random.default_rng(seed)
    asked: list[float] = []

    def at(run: Run, now: float) -> None:
        if now > 7.0:
            robot.damage = lambda sent: damaged(sent, rng, rate)
        asked[:] = [time for time, command in robot.commands if command.opcode in (145, 149)]

    run = play(compiled(BOUNCE), robot, seconds=9, at=at)
    # The sketch keeps sending, and the watchdog does not reset the board.
    assert run.resets == 0
    assert np.diff(asked).max() < 0.5
    if rate == 0.5:
        assert run.end == "stopped: the robot does not answer"
    if run.end is not None:
        assert stands_still(robot)


def test_the_tables_are_those_of_the_header():
    rng = np.random.default_rng(0)
    for states in (100, 255, 256, 2000):
        image = ((np.arange(states) + 1) % states).astype(np.int32)
        filter = Filter.of(subset_construction(image, rng.random(states) < 0.5))
        header = to_c_header(filter)
        found = re.findall(r"static const uint(\d+)_t \w+\[(\d+)\](\[2\])?", header)
        sizes = [int(bits) // 8 * int(n) * (2 if pair else 1) for bits, n, pair in found]
        assert list(table_bytes(filter).values()) == sizes


def sketches():
    """The task, the function of its sketch, and the bytes of its tables, for filter and policy."""
    policy = policy_task()
    return [
        (ROOM_TASK, filter_sketch, sum(table_bytes(ROOM_TASK.filter).values())),
        (policy, policy_sketch, sum(policy_table_bytes(policy.policy).values())),
    ]


def test_tables_that_do_not_fit_the_flash_are_refused_with_sizes():
    for task, sketch, total in sketches():
        sketch(task, flash=PROGRAM_BYTES + total)
        message = rf"\.jxf: the tables have {total} bytes; there is room for {total - 1},"
        with pytest.raises(ValueError, match=message):
            sketch(task, flash=PROGRAM_BYTES + total - 1)
    task, _, total = sketches()[0]
    with pytest.raises(ValueError, match=f"the tables have {total + 32} bytes"):
        filter_sketch(task, direction=0, flash=PROGRAM_BYTES + total)
    states = 9000
    line = np.full((states, 2), -1, np.int32)
    line[:-1, 0] = np.arange(1, states)
    filter = Filter(
        transition=line,
        uncertainty=np.ones(states, np.int32),
        offsets=np.arange(states + 1),
        members=np.zeros(states, np.int32),
    )
    large = dataclasses.replace(task, filter=filter)
    with pytest.raises(ValueError, match=r"the table of the transitions has \d+,\d+ bytes; an AVR"):
        filter_sketch(large, flash=10**6)


def test_bad_directions_and_angles_of_sketches_are_refused():
    with pytest.raises(ValueError, match="direction: expected 0 to 3, got 4"):
        filter_sketch(ROOM_TASK, direction=4)
    oblique = dataclasses.replace(ROOM_TASK, bounce=1.0)
    with pytest.raises(
        ValueError, match=r"bounce_deg: 57\.2958 deg is not a whole number of the 4"
    ):
        filter_sketch(oblique, direction=0)
    filter_sketch(oblique)
    task = policy_task()
    oblique = dataclasses.replace(task, bounces=(task.bounces[0], 1.0))
    with pytest.raises(ValueError, match=r"bounces_deg: 57\.2958 deg is not a whole number of the"):
        policy_sketch(oblique, direction=0)
    for step in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="step: expected a positive number"):
            bounce_sketch(1.0, step)
    with pytest.raises(ValueError, match="bounce: expected a finite angle"):
        bounce_sketch(math.inf, 1.0)


@needs_compiler
def test_a_file_name_cannot_end_the_comment(compiled):
    path = Path("a*/ int x; /* $tables ??/ \n // \\")
    compiled(filter_sketch(dataclasses.replace(ROOM_TASK, path=path)))


def test_the_comment_of_a_sketch_is_complete():
    for text in (filter_sketch(ROOM_TASK, direction=1), BOUNCE):
        comment = text[: text.index("*/")]
        assert "$" not in text
        assert max(map(len, comment.splitlines())) <= 100
    assert "facing 90 degrees" in filter_sketch(ROOM_TASK, direction=1)
