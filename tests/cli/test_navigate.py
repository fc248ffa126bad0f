import json
import math
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jaxcell.bounce import plan, replay
from jaxcell.cli import main
from jaxcell.space import CellSpace, Motion, Workspace


MAPS = Path(__file__).parents[2] / "data" / "maps"
LAB = MAPS / "lab_a.json"
BOUNCES = ("--bounces", 45, 90, 135)


@pytest.fixture(scope="module")
def lab():
    return CellSpace.of(Workspace.load(LAB), 1.0, 8)


@pytest.fixture
def two_rooms(tmp_path):
    path = tmp_path / "rooms.txt"
    path.write_text("; cell 1\n...#..\n...#..\n...#..\n")
    return path


def navigate(capsys, *args):
    """Exit status, the JSON object on standard output, and standard error."""
    status = main(["navigate", *map(str, args), "--json"])
    captured = capsys.readouterr()
    return status, json.loads(captured.out) if captured.out else None, captured.err


def test_the_plan_leads_to_the_goal(capsys, lab):
    args = (LAB, *BOUNCES, "--start", "0.5,0.5,0", "--goal", "7.5,3.5,270")
    status, found, _ = navigate(capsys, *args)
    assert status == 0
    assert found["start"] == lab.index(0.5, 0.5, 0.0)
    assert found["goal"] == lab.index(7.5, 3.5, 1.5 * math.pi)
    path = replay(lab, found["start"], np.radians(found["actions_deg"]))
    assert path.tolist() == found["visited"]
    assert path[-1] == found["goal"]
    assert set(found["actions_deg"]) <= {0, 45, 90, 135}
    expected = plan(lab, np.radians([45, 90, 135]), found["start"], found["goal"])
    assert found["cost"] == expected.cost
    assert found["cells_that_reach_the_goal"] == expected.reaching.sum()
    assert isinstance(found["cost"], int)


def test_weights_and_motion_are_passed_on(capsys, lab):
    args = (LAB, *BOUNCES, "--start", 5, "--goal", 100, "--keep", 0.5, "--change", 3)
    _, found, _ = navigate(capsys, *args, "--collision", "endpoint", "--step", 1.4)
    expected = plan(lab, np.radians([45, 90, 135]), 5, 100, 0.5, 3, motion=Motion(1.4, "endpoint"))
    assert found["cost"] == expected.cost
    np.testing.assert_allclose(np.radians(found["actions_deg"]), expected.actions)


def test_start_and_goal_may_coincide(capsys):
    status, found, _ = navigate(capsys, LAB, *BOUNCES, "--start", 7, "--goal", 7)
    assert status == 0
    assert (found["cost"], found["actions_deg"], found["visited"]) == (0, [], [7])


def test_no_path_is_status_1(capsys, two_rooms, tmp_path):
    out = tmp_path / "out"
    args = (two_rooms, *BOUNCES, "--start", "0.5,0.5,0", "--goal", "4.5,1.5,90", "--out", out)
    status, found, _ = navigate(capsys, *args)
    assert status == 1
    assert (found["found"], found["cost"], found["actions_deg"]) == (False, -1, [])
    assert found["cells_that_reach_the_goal"] == 6 * 8
    assert {path.name for path in out.iterdir()} == {
        "navigation.nc",
        "navigation.rrd",
        "summary.json",
    }
    with xr.open_dataset(out / "navigation.nc") as data:
        assert (data.reaches.values == (data.x.values > 4)).all()


def test_results_are_left_to_look_at(capsys, tmp_path):
    out = tmp_path / "new" / "folder"
    status, found, _ = navigate(capsys, LAB, *BOUNCES, "--start", 5, "--goal", 100, "--out", out)
    assert status == 0
    assert json.loads((out / "summary.json").read_text()) == found
    with xr.open_dataset(out / "navigation.nc") as data:
        assert data["visited"].values.tolist() == found["visited"]
    assert (out / "navigation.rrd").stat().st_size > 1000


@pytest.mark.parametrize("ends", [(5, 100), (5, 5)])
def test_people_read_a_table(capsys, ends):
    args = ("--start", ends[0], "--goal", ends[1])
    assert main(["navigate", *map(str, (LAB, *BOUNCES, *args))]) == 0
    printed = capsys.readouterr().out
    assert "cells that can reach the goal" in printed
    assert ("turn at each bump" in printed) == (ends[0] != ends[1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"--start": "2,2,0"}, "--start '2,2,0': the point (2, 2) lies in an obstacle"),
        ({"--goal": "99,2,0"}, "--goal '99,2,0': the point (99, 2) is off the map"),
        ({"--goal": "152"}, "--goal '152': cell 152 does not exist"),
        ({"--start": "0.5,0.5,7"}, "--start '0.5,0.5,7': expected a heading that is one of the 8"),
        ({"--goal": "here"}, "--goal 'here': expected \"x,y,heading\""),
        ({"--bounces": "50"}, "bounces: 50 deg is not a whole number"),
        ({"--bounces": "360"}, "--bounces: 360 deg leaves the robot at its wall"),
        ({"--keep": "0"}, "--keep: expected a finite cost above 0"),
        ({"--change": "nan"}, "--change: expected a finite cost above 0"),
        ({"--change": "0.5"}, "--change: expected at least what keeping the angle costs"),
        ({"--step": "0.2"}, "--step: expected at least one cell"),
    ],
)
def test_bad_input_is_one_line_and_status_2(capsys, change, message):
    given = {"--bounces": "45", "--start": "5", "--goal": "100", **change}
    status, found, errors = navigate(capsys, LAB, *(x for pair in given.items() for x in pair))
    assert (status, found) == (2, None)
    assert message in errors
    assert len(errors.strip().splitlines()) == 1


def test_an_angle_given_twice_is_refused(capsys):
    args = ("--bounces", 45, 405, "--start", 5, "--goal", 100)
    status, _, errors = navigate(capsys, LAB, *args)
    assert status == 2
    assert "--bounces: 45 and 405 deg are the same turn" in errors
