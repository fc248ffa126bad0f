"""The estimate of the turn by bumps from the log of a robot with a known turn."""

import dataclasses
import math

import pytest

from jaxcell import robot, space, walls
from jaxcell.robot.bump_turn import estimate_bump_turn
from jaxcell.robot.emulation.body import Body, Noise
from jaxcell.robot.emulation.direct import DirectBody


HALL = space.Workspace([(0, 0), (6, 0), (6, 2), (2, 2), (2, 5), (0, 5)])


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
