"""Sketches on an Arduino with an emulated robot, compared with the host."""

import dataclasses
import itertools
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from arduino import (
    BOUNCE,
    COMPILER,
    ROOM,
    ROOM_TASK,
    Robot,
    Run,
    compiled,
    play,
    policy_task,
    stands_still,
    task_of,
)
from hypothesis import given, settings
from wheels import body_in, bounce_filter, map_cells, orbit

from jaxcell.automata import fewest_bytes
from jaxcell.automata.filter import CONFIRM
from jaxcell.robot.create.packets import Contact, Mode
from jaxcell.robot.emulation.body import Noise
from jaxcell.robot.emulation.emulator import Line
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.followers import run_follower
from jaxcell.robot.sketch import filter_sketch, policy_sketch
from jaxcell.robot.walker import Walker
from jaxcell.space import CellSpace


pytestmark = pytest.mark.skipif(
    COMPILER is None, reason="no C++ compiler (c++, g++, clang++) to compile the sketch with"
)

LAB_A, LAB_B = map_cells("lab_a.json"), map_cells("lab_b.json")
# The filter of this map has more than 255 states, which need wider tables.
MAZE = map_cells("maze.txt", directions=8)


def localize(cells, cell, task, *, known: bool = True, machine=None, **fields):
    """Run a task by a sketch and on a host from the same start, and compare the runs."""
    direction = cell // cells.positions if known else None
    sketch = filter_sketch if task.kind == "filter" else policy_sketch
    text = sketch(task, direction=direction, machine=machine)
    robot = Robot(body_in(cells, cell), **fields)
    run = play(compiled(text), robot, seconds=600)
    walker = Walker(
        SimulatedCreate(body_in(cells, cell)),
        task.step,
        strides=task.strides if known else None,
        direction=direction or 0,
    )
    # Neither policies nor the smallest machines are confirmed.
    if task.kind == "policy":
        follower = task.follower(confirm=0)
    else:
        follower = task.follower("cycle", confirm=CONFIRM if machine is None else 0)
    host = run_follower(walker, follower, task.bounces, limit=200)
    assert run.observed == host.observations
    # The smallest machine of a policy has other colours.
    assert run.colors == host.colors or (machine is not None and task.kind == "policy")
    assert stands_still(robot)
    if host.result == "localized":
        assert run.end == "localized"
        assert f"configurations: {len(host.cells)}\n" in run.usb
        # The robot has turned after its last bump too.
        assert int(cells.index(*robot.pose)) in host.cells
    return robot, run, host


def smallest_machine(source):
    pytest.importorskip("pysat.solvers")
    return fewest_bytes(source).machine


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
def test_the_colours_are_those_of_the_host(cells, bounce_deg, cell, smallest):
    task = task_of(cells, bounce_deg)
    machine = smallest_machine(task.filter) if smallest else None
    robot, run, host = localize(cells, cell, task, machine=machine)
    assert host.result == "localized"
    assert run.led[-1][1] == 1
    assert [command.opcode for _, command in robot.commands if command.opcode == 141] == [141]


@pytest.mark.parametrize("open_world", [False, True])
def test_another_map_is_refuted_where_the_host_refutes_it(open_world):
    filter = bounce_filter(LAB_B, 45, open_world=open_world)
    here = CellSpace.of(ROOM.workspace, ROOM.cell, 8)
    _, run, host = localize(here, 9, task_of(here, 45, filter))
    assert host.result == "refuted"
    assert run.colors[-1] == (filter.color[-1] if open_world else 0)
    assert run.end == "refuted: the robot is on another map, or it slipped"
    # It blinks fast: 4 times a second.
    states = [on for _, on in run.led[-300:]]
    assert 6 <= sum(a < b for a, b in itertools.pairwise(states)) <= 10


def test_a_heading_is_not_needed_where_all_steps_are_equal():
    # The robot faces North, but the sketch does not know this.
    _, _, host = localize(ROOM, 25, ROOM_TASK, known=False)
    assert host.result == "localized"


@pytest.mark.parametrize("smallest", [False, True])
def test_a_policy_chooses_the_angles_that_the_host_does(smallest):
    task = policy_task()
    machine = smallest_machine(task.policy) if smallest else None
    _, _, host = localize(ROOM, 9, task, machine=machine)
    assert host.result == "localized"


@pytest.mark.parametrize(("byte", "seconds"), [(None, 45), (0, 17), (10, 17), (14, 17)])
def test_a_robot_that_only_bounces_is_where_the_cells_say(byte, seconds):
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
    word, cells = orbit(ROOM, 90, 5, len(places))
    assert run.observed == word
    assert np.array(places)[:, :2] == pytest.approx(np.stack(ROOM.centre(cells)[:2], 1), abs=0.02)


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
def test_the_sketch_stops_the_robot_in_danger(danger, end):
    robot, moving = Robot(body_in(ROOM, 0)), []

    def at(run: Run, now: float) -> None:
        if run.observed:
            moving.append(now)
            if now - moving[0] > 0.5:
                danger(robot)

    run = play(compiled(BOUNCE), robot, seconds=40, at=at)
    assert run.observed.startswith("0")
    assert run.end == f"stopped: {end}"
    assert stands_still(robot)


def test_a_lost_line_stops_the_wheels_at_once():
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


def test_a_sketch_that_hangs_is_reset_and_stops_the_robot():
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


@pytest.mark.parametrize("flags", [(), ("-DHAVE_HWSERIAL1",)])
def test_the_line_comes_to_19200_baud(flags):
    program = compiled(BOUNCE, *flags)
    for fields in ({"baud": 19200}, {"baud": 115200}, {"baud": 115200, "wire": False}):
        robot = Robot(body_in(ROOM, 0), **fields)
        run = play(program, robot, seconds=9)
        assert run.observed.startswith("0")
        assert robot.baud == 19200


@pytest.mark.parametrize(
    ("change", "end"),
    [({"deaf": True}, "stopped: the robot does not answer"), ({"first_mode": 1}, None)],
)
def test_a_deaf_robot_ends_a_sketch_and_modes_from_1_do_not(change, end):
    robot = Robot(body_in(ROOM, 0))
    vars(robot).update(change)
    run = play(compiled(BOUNCE), robot, seconds=60 if end else 9)
    assert run.end == end
    assert run.observed.startswith("0") is (end is None)


def test_bytes_that_get_lost_change_nothing():
    _, _, host = localize(ROOM, 9, ROOM_TASK, line=Line(dropped=0.002), seed=1)
    assert host.result == "localized"


def damaged(data: bytes, rng: np.random.Generator, rate: float) -> bytes:
    """Lose, change or double some bytes, each with a probability of `rate`."""
    kind = np.floor(rng.random(len(data)) / rate)
    noise = rng.integers(0, 256, len(data), np.uint8)
    bytes_ = np.where(kind == 1, noise, np.frombuffer(data, np.uint8))
    return bytes(np.repeat(bytes_, np.select([kind == 0, kind == 2], [0, 2], 1)))


def test_the_data_of_a_drive_command_are_not_opcodes():
    # The robot would obey opcodes if the first byte got lost. Noisy encoders make it steer a lot.
    noise = Noise(encoder=1.0)
    robot = Robot(body_in(ROOM, 0, noise=noise, rng=np.random.default_rng(0)))
    play(compiled(BOUNCE), robot, seconds=12)
    wheels = b"".join(command.data for _, command in robot.commands if command.opcode == 145)
    assert len(set(wheels)) > 30
    assert not {7, *range(128, 174)} & set(wheels)


@settings(max_examples=4)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.1, 0.5]))
def test_a_sketch_never_hangs_on_a_damaged_line(seed, rate):
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


def test_a_file_name_cannot_end_the_comment():
    path = Path("a*/ int x; /* $tables ??/ \n // \\")
    compiled(filter_sketch(dataclasses.replace(ROOM_TASK, path=path)))
