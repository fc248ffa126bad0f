import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jaxcell.bounce import team_trajectory
from jaxcell.cli import main
from jaxcell.space import CellSpace, Workspace


MAPS = Path(__file__).parents[2] / "data" / "maps"
LAB = MAPS / "lab_b.json"


def run(capsys, *args):
    """Exit status, the JSON object on standard output, and standard error."""
    status = main(["team", *map(str, args), "--json"])
    captured = capsys.readouterr()
    return status, json.loads(captured.out) if captured.out else None, captured.err


@pytest.fixture
def two_rooms(tmp_path):
    """A map that a wall parts into rooms of 3 x 3 and 2 x 3 squares."""
    path = tmp_path / "rooms.txt"
    path.write_text("; cell 1\n...#..\n...#..\n...#..\n")
    return path


def test_a_team_covers_a_map(capsys):
    args = (LAB, "--bounces", 135, "--starts", "1.5,3.5,0", "0.5,1.5,90", 7)
    status, found, _ = run(capsys, *args)
    assert status == 0
    assert (found["robots"], found["uncovered"], found["uncovered_positions"]) == (3, 0, [])
    assert found["outcome"] == "covered"
    cells = CellSpace.of(Workspace.load(LAB), 1.0, 8)
    starts = [int(cells.index(1.5, 3.5, 0.0)), int(cells.index(0.5, 1.5, np.pi / 2)), 7]
    assert found["starts"] == starts
    team = team_trajectory(cells, starts, np.radians(135))
    assert found["steps"] == found["steps_to_100_percent"] == team.steps
    assert found["ends"] == team.ends.tolist()
    assert found["bumps"] == team.bumped.sum()
    assert found["collisions_in_all"] == team.collisions.sum()
    half = int(found["steps_to_50_percent"])
    assert team.covered[half] * 2 >= cells.positions
    assert team.covered[half - 1] * 2 < cells.positions


def test_each_robot_can_have_its_own_angle(capsys):
    starts = ("--starts", 0, 30)
    _, own, _ = run(capsys, LAB, "--bounces", 135, 45, *starts)
    _, common, _ = run(capsys, LAB, "--bounces", 135, *starts)
    assert (own["bounces_deg"], common["bounces_deg"]) == ([135, 45], [135])
    assert own["ends"] != common["ends"]


def test_random_starts_are_apart_and_reproducible(capsys):
    args = (LAB, "--bounces", 135, "--robots", 8, "--max-parts", 1, "--part-steps", 1)
    first, again, other = (run(capsys, *args, "--seed", s)[1]["starts"] for s in (1, 1, 2))
    assert first == again != other
    assert len({z % 19 for z in first}) == len(first) == 8


def test_what_stays_uncovered_is_said(capsys, two_rooms):
    args = (two_rooms, "--bounces", 90, "--starts", "0.5,0.5,0", "1.5,1.5,90")
    status, found, _ = run(capsys, *args)
    assert status == 1
    assert found["outcome"] == "out_of_reach"
    assert found["steps_to_100_percent"] is None
    # Position 3 is the first square of the other room, in the lowest of three rows of five.
    assert found["uncovered_positions"] == [3, 4, 8, 9, 13, 14]
    assert main(["team", *map(str, args)]) == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert "positions that stay uncovered │ 6" in shown
    assert "(4.5 m, 0.5 m)" in shown


def test_results_are_left_to_look_at(capsys, tmp_path):
    folder = tmp_path / "new" / "folder"
    status, found, _ = run(capsys, LAB, "--bounces", 135, "--robots", 2, "--out", folder)
    assert status == 0
    assert {path.name for path in folder.iterdir()} == {
        "team.nc",
        "team.rrd",
        "team.json",
        "summary.json",
    }
    assert json.loads((folder / "summary.json").read_text()) == found
    with xr.open_dataset(folder / "team.nc") as dataset:
        assert dataset.cell.isel(time=0).values.tolist() == found["starts"]
        assert dataset.sizes["move"] == found["steps"]
        assert json.loads(dataset.attrs["spec"])["bounces_deg"] == [135]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--bounces",), "--bounces: expected at least one angle"),
        (("--bounces", 50), "bounce: 50 deg is not a whole number of the 8 directions"),
        (("--bounces", 45, 90, 135), "bounces: got 3 angles for 2 robots"),
        (("--bounces", 135, "--robots", 0), "--robots 0: expected from 1 to 19"),
        (("--bounces", 135, "--robots", 20), "--robots 20: expected from 1 to 19"),
        (("--bounces", 135, "--robots", 3, "--starts", 1, 2), "--robots 3: starts names 2"),
        (("--bounces", 135, "--starts", 1, 20), "robots 0 and 1 are both at position 1"),
        (("--bounces", 135, "--starts", 1, 152), "--starts '152': cell 152 does not exist"),
        (("--bounces", 135, "--starts", "9,9,0"), "--starts '9,9,0': the point (9, 9) is off the"),
        (("--bounces", 135, "--starts", "1,2"), 'expected "x,y,heading"'),
        (("--bounces", 135, "--max-parts", 0), "--max-parts: expected at least 1, got 0"),
        (("--bounces", 135, "--part-steps", 0), "--part-steps: expected at least 1, got 0"),
    ],
)
def test_bad_input_is_one_line_and_status_2(capsys, args, message):
    status, found, errors = run(capsys, LAB, *args)
    assert (status, found) == (2, None)
    assert message in errors
    assert len(errors.strip().splitlines()) == 1
