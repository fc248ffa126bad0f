import contextlib
import math
import signal
import subprocess
import sys
import warnings

import numpy as np
import pytest
import rerun as rr
from recordings import Recording, poses_of, written
from waiting import wait_until
from wheels import bounce_filter, map_cells

from jaxcell.record import RecordedRobot, RobotRecording
from jaxcell.space import CellSpace


LAB = map_cells("lab_a.json")
FILTER = bounce_filter(LAB, 45)
# A robot that starts at (1, 2), to the north.
START = (1.0, 2.0, math.pi / 2)
# Metres within which a robot has not gone on.
NEAR = 0.0101


@pytest.fixture(autouse=True)
def strict():
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def recorded(events, *robots, **options):
    """The recording of a run with these events, by default of one robot."""

    def write(path):
        with RobotRecording(path, robots or [RecordedRobot()], **options) as recording:
            for name, fields in events:
                recording.event(name, fields)

    return written(write)


def observation(text, state, estimate=(0.0, 0.0, 0.0), **fields):
    refuted = state is None
    return "observation", {
        "observation": int(text),
        "estimate": list(estimate),
        "state": state,
        "color": 0 if refuted else int(FILTER.color[state]),
        "uncertainty": 0 if refuted else int(FILTER.uncertainty[state]),
        **fields,
    }


def test_the_belief_and_the_numbers_are_those_of_the_filter():
    observed = "100110001"
    states = FILTER.run(observed).states.tolist()
    steps = enumerate(zip(observed, states[1:], strict=True), 1)
    events = [observation(text, state, seconds=second) for second, (text, state) in steps]
    events.append(("end", {"seconds": 10, "result": "localized", "reason": "it is known"}))
    recording = recorded(events, RecordedRobot(start=START), cells=LAB, filter=FILTER)
    belief = recording.poses("/map/belief", "observation")
    sizes = recording.over("observation", "/filter/uncertainty", "Scalars:scalars")
    colors = recording.over("observation", "/filter/color", "Scalars:scalars")
    bumps = recording.over("observation", "/robot/robot/bumped", "Scalars:scalars")
    for time, state in enumerate(states):
        np.testing.assert_allclose(belief[time], poses_of(LAB, FILTER.cells(state)), atol=1e-6)
        assert sizes[time] == [FILTER.uncertainty[state]]
        assert colors[time] == [FILTER.color[state]]
        if time:
            assert bumps[time] == [int(observed[time - 1])]
    # By the clock too: the number after an observation begins with it.
    seconds = recording.over("seconds", "/filter/uncertainty", "Scalars:scalars")
    assert [time / 1e9 for time in sorted(seconds)] == list(range(11))
    texts = recording.over("seconds", "/log", "TextLog:text")
    assert texts[10 * 10**9] == ["end: localized: it is known"]
    left = recording.over("observation", "/map/candidates", "Boxes2D:centers")
    places = poses_of(LAB, FILTER.cells(states[-1]))[:, :2]
    np.testing.assert_allclose(left[len(observed)], places, atol=1e-6)


def test_a_refuted_robot_is_nowhere():
    end = {"seconds": 1.0, "result": "refuted", "reason": "it slipped"}
    recording = recorded(
        [observation("1", None, seconds=1.0), ("end", end)], cells=LAB, filter=FILTER
    )
    assert recording.over("observation", "/map/belief", "Arrows2D:origins")[1] == []
    assert recording.over("observation", "/filter/uncertainty", "Scalars:scalars")[1] == [0]
    assert recording.over("observation", "/map/candidates", "Boxes2D:centers") == {}
    assert recording.over("observation", "/log", "TextLog:level")[1] == ["WARN"]


def test_many_cells_are_shaded():
    cells = CellSpace.of(LAB.workspace, 0.5, 16)
    filter = bounce_filter(cells, 45)
    assert filter.cells(0).size > 400
    recording = recorded([], cells=cells, filter=filter)
    assert recording.over("observation", "/map/belief", "Arrows2D:origins")[0] == []
    # Every direction is possible at every free square.
    shades = recording.pictures("observation", "/map/grid/belief")[0]
    np.testing.assert_array_equal(shades, np.where(cells.free, 8, 0))


def test_poses_belong_to_the_observation_that_they_lead_to():
    trace = [(0.0, *START)]
    # A step of 1 m to the north in 5 s, as every 15 ms tells; then a turn, and the next step.
    step = [(t, 1.0, 2.0 + t / 5, math.pi / 2) for t in np.arange(0.015, 5.0, 0.015)]
    last = step[-1]

    def events():
        trace.extend(step)
        yield "observation", {"seconds": 0.7, "observation": 0, "estimate": [0.9, -0.1, 0.0]}
        trace.extend((5 + t, 1.0, last[2], math.pi / 2 + t) for t in np.arange(0.1, 1.0, 0.1))
        trace.extend((6 + t, 1.0 + t / 5, last[2], math.pi) for t in np.arange(0.0, 1.0, 0.1))

    recording = recorded(events(), RecordedRobot(start=START, trace=trace), cells=LAB)
    by_time = recording.over("seconds", "/map/robots/robot", "Arrows2D:origins")
    times = np.array(sorted(by_time)) / 1e9
    # Ten a second, and the last of each look, of which one may come at any time.
    assert np.diff(times).max() < 0.12
    assert len(times) < 80
    np.testing.assert_allclose(by_time[min(by_time)], [START[:2]], atol=1e-6)
    by_observation = recording.over("observation", "/map/robots/robot", "Arrows2D:origins")
    headings = recording.over("observation", "/map/robots/robot", "Arrows2D:vectors")
    assert sorted(by_observation) == [0, 1, 2]
    # The turn is part of the observation that it follows, and nothing else after it is.
    np.testing.assert_allclose(by_observation[1], [last[1:3]], atol=NEAR)
    ((right, up),) = headings[1]
    assert math.atan2(up, right) == pytest.approx(math.pi, abs=0.25)
    np.testing.assert_allclose(by_observation[2], [trace[-1][1:3]], atol=1e-6)
    # The trail has a corner where it turned: its ends are the start and the last pose.
    (trail,) = recording.over("observation", "/map/trails/robot", "LineStrips2D:strips")[2]
    expected = [START[:2], last[1:3], trace[-1][1:3]]
    np.testing.assert_allclose([trail[0], trail[-2], trail[-1]], expected, atol=NEAR)
    # 0.9 m ahead is north of the start, and 0.1 m to the right is east of it. The time is that of
    # the robot, not of the clock.
    estimates = recording.over("seconds", "/map/estimates/robot", "Points2D:positions")
    np.testing.assert_allclose(estimates[round(last[0] * 1e9)], [[1.1, 2.9]], atol=1e-6)


def test_several_robots_without_a_filter():
    traces = [[(0.0, 0.5, 0.5, 0.0)], [(0.0, 7.5, 3.5, 0.0)]]
    robots = [RecordedRobot(name=f"robot {i}", trace=trace) for i, trace in enumerate(traces, 1)]

    def events():
        traces[1].append((1.0, 7.5, 2.5, 0.0))
        yield "observation", {"seconds": 9.0, "observation": 1, "robot": 1}
        yield "visit", {"seconds": 9.0, "robot": 0, "cell": 7}

    recording = recorded(events(), *robots, cells=LAB)
    assert recording.over("seconds", "/log", "TextLog:text") == {
        10**9: ["robot 2: observation 1: bump"],
        0: ["robot 1: visit: 7"],
    }
    places = recording.over("seconds", r"/map/robots/robot\ 2", "Arrows2D:origins")
    np.testing.assert_allclose(places[10**9], [[7.5, 2.5]])
    places = recording.over("seconds", r"/map/robots/robot\ 1", "Arrows2D:origins")
    assert list(places) == [0]


def test_a_real_robot_without_a_map():
    recording = recorded([observation("0", 1, (1.0, 0.1, 0.0), seconds=3.0)])
    places = recording.over("seconds", "/odometry/estimates/robot", "Points2D:positions")
    np.testing.assert_allclose(places[3 * 10**9], [[1.0, 0.1]], atol=1e-6)
    assert not any(entity.startswith("/map/grid") for entity in recording.entities)
    assert "/map/belief" not in recording.entities


def test_the_recording_of_a_killed_process_can_be_read(tmp_path):
    program = """
import sys, time
from wheels import map_cells
from jaxcell.record import RecordedRobot, RobotRecording
with RobotRecording(sys.argv[1], [RecordedRobot()], cells=map_cells("lab_a.json")) as recording:
    for second in range(5):
        recording.event("observation", {"seconds": float(second), "observation": 1})
    time.sleep(600)
"""
    path = tmp_path / "run.rrd"

    def bumps():
        return Recording(path).over("observation", "/robot/robot/bumped", "Scalars:scalars")

    def written():
        # Part of a file may be no recording yet.
        with warnings.catch_warnings(), contextlib.suppress(Exception):
            warnings.simplefilter("ignore")
            return process.poll() is not None or len(bumps()) == 5

    with subprocess.Popen([sys.executable, "-c", program, path], cwd="tests") as process:
        try:
            wait_until(written)
        finally:
            process.kill()
    assert process.returncode == -signal.SIGKILL
    with pytest.warns(rr.error_utils.RerunWarning, match="no footer"):
        assert bumps() == {time: [1.0] for time in range(1, 6)}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "run.bin"}, r"run\.bin: expected the name of a recording"),
        ({"robots": []}, "robots: expected one or more, got none"),
        (
            {"filter": FILTER, "cells": CellSpace.of(LAB.workspace, 0.5, 8)},
            "filter: it has 152 cells, but the map has 608",
        ),
        ({"viewer": "there"}, "viewer 'there': expected here, or the address of a viewer"),
        ({"viewer": "rerun+http://127.0.0.1:1/proxy"}, "no viewer answers there"),
        ({"viewer": "here"}, "viewer here: there is no display"),
        ({"name": "none/run.rrd"}, "there is no folder"),
    ],
)
def test_bad_input(tmp_path, monkeypatch, options, message):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("jaxcell.record.viewer.PORT", 2)
    monkeypatch.setattr("sys.platform", "linux")
    path = tmp_path / options.pop("name", "run.rrd")
    with pytest.raises((ValueError, OSError), match=message):
        RobotRecording(path, options.pop("robots", [RecordedRobot()]), **options)
    assert not list(tmp_path.iterdir())


def test_the_body_and_the_touches_of_walls_are_shown_while_they_last():
    trace = [(0.1 * tick, 1.0 + 0.01 * tick, 2.0, 0.0) for tick in range(10)]
    robot = RecordedRobot(start=START, trace=trace, radius=0.174, touches=[(0.42, 1.2, 2.0)])
    end = {"seconds": 1, "result": "arrived", "reason": "it is there"}
    recording = recorded([("end", end)], robot, cells=LAB)
    bodies = recording.over("seconds", "/map/robots/robot/body", "Points2D:positions")
    np.testing.assert_allclose(list(bodies.values()), [[pose[1:3]] for pose in trace], atol=1e-6)
    touches = recording.over("seconds", "/map/robots/robot/touch", "Points2D:positions")
    shown = {round(time / 1e9, 1) for time, places in touches.items() if places}
    assert shown == {0.5}
