"""A robot that is put down anywhere, and the estimate of its turn by bumps."""

import dataclasses
import math

import numpy as np
import pytest

from jaxcell import robot, space, walls
from jaxcell.robot.anywhere import SetFollower
from jaxcell.robot.bump_turn import estimate_bump_turn
from jaxcell.robot.emulation.body import Body, Noise
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.tasks.anywhere_task import save_anywhere


HALL = space.Workspace([(0, 0), (6, 0), (6, 2), (2, 2), (2, 5), (0, 5)], name="hall")
FIELDS = {
    "cell_m": 0.5,
    "directions": 8,
    "step_m": 0.5,
    "bounce_deg": [70.0, 135.0],
    "headings": None,
    "slices": 360,
    "errors": {"run": 0.01, "distance": 0.05, "turn": math.radians(2), "displacement": 0.06},
    "counted_m": 0.0,
    "known_m": 0.5,
    "goal_m": [5.5, 1.0],
    "goal_radius_m": 1.2,
}


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    path = tmp_path_factory.mktemp("task") / "anywhere.json"
    save_anywhere(path, HALL, **FIELDS)
    return robot.load_task(path)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_robot_comes_home_from_anywhere_and_a_replay_agrees(task, seed, tmp_path):
    rng = np.random.default_rng(seed)
    x, y = walls.places_anywhere(HALL, 1, rng)[0].tolist()
    body = Body(HALL, (x, y, float(rng.uniform(0, math.tau))))
    path = tmp_path / "run.jsonl"
    with SimulatedCreate(body) as create, robot.RunLog(path, task.header) as log:
        outcome = robot.run_anywhere(robot.Walker(create, 1.0), task.settings, log=log, limit=80)
    assert outcome.result == "arrived"
    assert math.dist(body.pose[:2], (5.5, 1.0)) < 1.2 + 0.1
    assert math.dist(body.pose[:2], outcome.place) <= outcome.extent / 2 + 0.1
    assert robot.replay_anywhere(robot.read_log(path), task.settings) == outcome


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("run", "far", "event 0: run: expected a length in metres, got 'far'"),
        ("turn", "left", "event 0: turn: expected radians, got 'left'"),
        ("turn", None, "event 1: expected no observation after a bump without a turn"),
    ],
)
def test_a_damaged_log_is_refused(task, field, value, message):
    events = [{"event": "observation", "observation": 1, "run": 1.0, "turn": 0.0} for _ in range(2)]
    events[0][field] = value
    with pytest.raises(ValueError, match=message):
        robot.replay_anywhere(robot.LoggedRun({}, tuple(events), True), task.settings)


def test_another_map_is_refuted(task):
    elsewhere = space.Workspace([(0, 0), (9, 0), (9, 7), (0, 7)])
    walker = robot.Walker(SimulatedCreate(Body(elsewhere, (4.0, 3.0, 1.0))), 1.0)
    outcome = robot.run_anywhere(walker, task.settings, limit=60)
    assert outcome.result == "refuted"
    assert "the map is wrong" in outcome.reason
    assert "--errors" not in outcome.reason


def test_the_option_for_a_bumper_is_named_where_the_task_lacks_it(tmp_path):
    save_anywhere(tmp_path / "anywhere.json", HALL, **FIELDS | {"errors": {"distance": 0.05}})
    settings = robot.load_task(tmp_path / "anywhere.json").settings
    walker = robot.Walker(SimulatedCreate(Body(HALL, (4.0, 1.0, 1.0), give=0.06)), 1.0)
    outcome = robot.run_anywhere(walker, settings, limit=60)
    assert outcome.result == "refuted"
    assert "--errors displacement=0.06" in outcome.reason


def test_a_robot_without_walls_stops_within_the_size_of_its_room(task):
    field = space.Workspace([(0, 0), (50, 0), (50, 50), (0, 50)])
    body = Body(field, (25.0, 25.0, 0.3))
    outcome = robot.run_anywhere(robot.Walker(SimulatedCreate(body), 1.0), task.settings)
    assert outcome.result == "refuted"
    assert math.dist(body.pose[:2], (25.0, 25.0)) < 10


@pytest.fixture(scope="module")
def settings():
    errors = walls.Errors(run=0.01, distance=0.03, turn=math.radians(3), displacement=0.06)
    angles = tuple(math.radians(angle) for angle in (70.0, 100.0, 135.0))
    return robot.AnywhereSettings(walls.WallFilter.of(HALL, errors=errors), angles, radius=0.0)


def log_of(settings, path, degrees, bumps):
    """Read the log of a robot that a bump at 45 degrees turns by `degrees`."""
    noise = Noise(bump_turn=math.radians(degrees))
    body = Body(HALL, (1.2, 0.7, 0.4), give=0.001, noise=noise)
    with robot.RunLog(path, {"kind": "anywhere"}) as log:
        robot.run_anywhere(robot.Walker(DirectBody(body), 1.0), settings, log=log, limit=bumps)
    return robot.read_log(path)


@pytest.mark.parametrize("degrees", [0.0, 2.5])
def test_the_turn_by_bumps_is_estimated_within_half_a_degree(settings, tmp_path, degrees):
    run = log_of(settings, tmp_path / "run.jsonl", degrees, bumps=40)
    assert math.degrees(estimate_bump_turn(run, settings)) == pytest.approx(degrees, abs=0.5)


def test_sets_that_know_the_turn_by_bumps_localize_the_robot(settings):
    turn = math.radians(4)
    errors = walls.Errors(distance=0.03, displacement=0.06, turn=math.radians(1), bump_turn=turn)
    known = dataclasses.replace(
        settings, filter=walls.WallFilter.of(HALL, errors=errors), radius=0.3
    )
    body = Body(HALL, (1.2, 0.7, 0.4), give=0.001, noise=Noise(bump_turn=turn))
    outcome = robot.run_anywhere(robot.Walker(DirectBody(body), 1.0), known, limit=40)
    assert outcome.result == "localized"
    assert math.dist(outcome.place, body.pose[:2]) <= outcome.extent / 2 + 0.06


def test_a_run_that_is_too_short_for_an_estimate_is_refused(settings, tmp_path):
    run = log_of(settings, tmp_path / "run.jsonl", 0.0, bumps=2)
    with pytest.raises(ValueError, match="expected a longer run"):
        estimate_bump_turn(run, settings)


def runs_in_rectangle(width, height, start, heading, turn, count):
    """The lengths of the straight runs of a point in a rectangle that turns at each bump."""
    place, lengths = np.array(start), []
    for _ in range(count):
        ahead = np.array([math.cos(heading), math.sin(heading)])
        bounds = np.where(ahead > 0, (width, height), 0.0)
        lengths.append(float(((bounds - place) / ahead).min()))
        place = np.clip(place + lengths[-1] * ahead, 0.0, (width, height))
        heading += turn
    return lengths


def test_a_robot_in_another_room_is_localized_only_without_confirmation():
    filter = walls.WallFilter.of(HALL, errors=walls.Errors(run=0.02, distance=0.03))
    angle = math.radians(130)
    known = {0: 0, 20: 0}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        width, height = rng.uniform(2, 6, 2)
        start = rng.uniform((0, 0), (width, height))
        lengths = runs_in_rectangle(width, height, start, rng.uniform(0, math.tau), angle, 40)
        events = tuple({"event": "observation", "run": run, "turn": angle} for run in lengths)
        log = robot.LoggedRun({}, events, True)
        for confirm in known:
            settings = robot.AnywhereSettings(filter, (angle,), 0.5, confirm=confirm)
            follower = SetFollower(settings)
            for _ in follower.follow(log):
                if follower.result is not None:
                    break
            known[confirm] += follower.result == "localized"
    assert known[0] > 4
    assert known[20] == 0


def test_a_robot_in_its_room_is_localized_after_the_confirmation():
    room = space.Workspace([(0, 0), (5, 0), (5, 3), (0, 3)])
    angle = math.radians(130)
    errors = walls.Errors(run=0.001, distance=0.001)
    filter = walls.WallFilter.of(room, headings=None, errors=errors)
    lengths = runs_in_rectangle(5, 3, (1.0, 2.0), 0.3, angle, 60)
    events = tuple({"event": "observation", "run": run, "turn": angle} for run in lengths)
    counts = {}
    for confirm in (0, 7):
        settings = robot.AnywhereSettings(filter, (angle,), 4.0, confirm=confirm)
        follower = SetFollower(settings)
        for _ in follower.follow(robot.LoggedRun({}, events, True)):
            if follower.result is not None:
                break
        assert follower.result == "localized"
        counts[confirm] = follower.bumps
    assert counts[7] >= counts[0] + 7
    outcome = follower.outcome()
    assert outcome.reason.endswith(
        f" after {counts[0]} bumps, and {counts[7] - counts[0]} more agreed"
    )


def _events(trial, robot_number):
    """Make the log of a simulated robot, whose only bouncing angle is 135 degrees."""
    turn = math.radians(135)
    runs = trial.run[robot_number].tolist()
    return tuple(
        {"event": "observation", "observation": 1, "run": run, "turn": turn} for run in runs
    )


def test_a_run_with_a_bump_that_is_not_on_the_map_is_not_refuted_and_says_so():
    turn = math.radians(135)
    filter = walls.WallFilter.of(HALL, headings=8, errors=walls.Errors(distance=0.02))
    trial = walls.drive_anywhere(HALL, filter, [turn], robots=20, bumps=15, headings=8, outliers=1)
    plain = robot.AnywhereSettings(filter, (turn,), 0.0, confirm=100)
    relaxed = dataclasses.replace(plain, outliers=1)
    again = dataclasses.replace(plain, restarts=2)
    refuted = 0
    for number in range(20):
        log = robot.LoggedRun({}, _events(trial, number), True)
        outcome = robot.replay_anywhere(log, relaxed)
        first = np.flatnonzero(trial.disbelieved[number]) + 1
        assert outcome.result == "unfinished"
        assert outcome.disbelieved == tuple(first[:1].tolist())
        assert ("disbelieved 1 bump" in outcome.reason) == bool(first.size)
        assert math.dist(outcome.place, trial.place[number, -1]) <= outcome.extent + 1e-6
        if first.size:
            refuted += 1
            part = dataclasses.replace(log, events=log.events[: first[0]])
            broken = robot.replay_anywhere(part, plain)
            assert (broken.result, broken.refuted) == ("refuted", (first[0],))
            assert f"the run to bump {first[0]} is impossible" in broken.reason
            goes_on = robot.replay_anywhere(log, again)
            assert goes_on.refuted == (first[0],)
            assert f"begun again from everywhere after bump {first[0]}" in goes_on.reason
    assert refuted > 5


def test_a_robot_that_begins_again_does_not_stop():
    chair = space.Workspace(HALL.boundary, [[(3.0, 0.8), (3.4, 0.8), (3.4, 1.2), (3.0, 1.2)]])
    errors = walls.Errors(distance=0.05, turn=math.radians(1), displacement=0.06)
    filter = walls.WallFilter.of(HALL, errors=errors, slices=72)
    settings = robot.AnywhereSettings(
        filter, (math.radians(70), math.radians(135)), 0.5, restarts=9
    )
    body = Body(chair, (4.5, 1.0, math.pi))
    outcome = robot.run_anywhere(robot.Walker(DirectBody(body), 1.0), settings, limit=30)
    assert len(outcome.refuted) > 0
    assert len(outcome.observations) == 30 or outcome.result == "localized"
