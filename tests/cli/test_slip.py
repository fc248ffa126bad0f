"""The commands for a robot that slips."""

import json

import numpy as np
import pytest
import xarray as xr

from jaxcell.automata import Belief, HiddenMap
from jaxcell.cli import main


ROOM = """; cell 1
######
#....#
#.#..#
#....#
######
"""


@pytest.fixture(autouse=True)
def _few_cells(monkeypatch):
    # Few cells are enough for what a command does.
    monkeypatch.setattr("jaxcell.bounce.slip.fine_cells.MAX_CELLS", 3000)


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "room.txt"
    path.write_text(ROOM)
    return path


def run(capsys, *args):
    status = main([*map(str, args), "--json"])
    captured = capsys.readouterr()
    return status, json.loads(captured.out) if captured.out else None, captured.err


def test_a_robot_that_slips_is_localized(capsys, tmp_path, room):
    out = tmp_path / "out"
    args = ("localize", room, "--bounce", 135, "--slip", 0.02, "--start", 3)
    status, found, _ = run(capsys, *args, "--out", out, "--verify")
    assert status == 0
    assert found["slip"] == 0.02
    assert found["start"] == 3
    assert len(found["candidates"]) <= 4 or len(found["word"]) == 400
    hidden = HiddenMap.load(out / "belief.jxb")
    assert hidden.cells == found["fine_cells"] <= 3000
    assert hidden.metadata["bounce_deg"] == 135
    with xr.open_dataset(out / "localization.nc") as dataset:
        times = len(found["word"]) + 1
        assert dataset.belief.shape == (times, 11)
        assert dataset.nowhere.shape == (times,)
        assert float(dataset.smoothed.sum("position").min()) == pytest.approx(1)
    assert (out / "localization.rrd").stat().st_size > 0
    status, about, _ = run(capsys, "info", out / "belief.jxb")
    assert about["fine_cells"] == hidden.cells
    again = run(capsys, *args)[1]
    assert again["word"] == found["word"]


def test_a_robot_that_slips_chooses_among_its_angles(capsys, tmp_path, room):
    out, again = tmp_path / "out", tmp_path / "run"
    args = ("localize", room, "--bounces", 90, 135, "--slip", 0.02, "--start", 3)
    status, found, _ = run(capsys, *args, "--out", out, "--verify")
    assert status == 0
    assert (found["bounces_deg"], found["slip"]) == ([90, 135], 0.02)
    assert {"bounce_deg", "goal", "aim", "open_world"}.isdisjoint(found)
    hidden = HiddenMap.load(out / "belief.jxb")
    assert hidden.angles == 2
    with xr.open_dataset(out / "localization.nc") as dataset:
        turned = dataset.turned_by.values
        np.testing.assert_array_equal(turned[1:] >= 0, dataset.observations.values == 1)
        assert set(turned.tolist()) <= {-1, 0, 1}
    belief = Belief(hidden)
    state = belief.start()
    for observation, turn in zip(found["word"], turned[1:].tolist(), strict=True):
        state = belief.observe(state, int(observation))
        assert state.turn == (None if turn < 0 else turn)
    run_it = (
        "robot",
        "run",
        out / "belief.jxb",
        "--simulate",
        room,
        "--heading",
        0,
        "--noise",
        0.02,
    )
    status, driven, _ = run(capsys, *run_it, "--out", again, "--speedup", 1000)
    assert status == 0
    status, replayed, _ = run(capsys, "robot", "replay", again / "run.jsonl")
    assert replayed["observations"] == driven["observations"]


def test_plans_of_a_robot_that_slips(capsys, room):
    ends = ("--start", "1.5,1.5,0", "--goal", "1.5,1.5,180")
    status, found, _ = run(
        capsys, "navigate", room, "--bounces", 90, 135, *ends, "--slip", 0.02, "--directions", 8
    )
    assert status == 0
    assert 0 <= found["plan_arrives"] <= found["plan_as_foretold"] <= 1
    assert found["policy_surely_arrives"]
    assert found["policy_mean_steps"] >= 1
    assert found["simulated_runs"] == 50
    least, most = found["plan_arrives_from"], found["plan_arrives_to"]
    assert least <= found["plan_arrives"] <= most <= least + 0.02
    # Runs of the emulated robot, of which there are 50, share no code with those of the plan.
    assert found["simulated_plan_arrives"] == pytest.approx(found["plan_arrives"], abs=0.2)
    assert found["simulated_policy_arrives"] > 0.3


@pytest.mark.parametrize(
    ("args", "told"),
    [
        (("--slip", "1.5"), "slip: expected a number from 0 to 1, got 1.5"),
        (("--slip", "-0.1"), "slip: expected a number from 0 to 1, got -0.1"),
        (("--slip", "nan"), "slip: expected a number from 0 to 1, got nan"),
        (("--slip", "0.1", "--open-world"), "open_world has no meaning for a robot that slips"),
        (("--slip", "0.1", "--collision", "endpoint"), "collision: expected 'swept'"),
        (("--slip", "0.1", "--bounce", "17"), "bounce: 17 deg is not a whole number"),
    ],
)
def test_bad_slips_are_refused(capsys, room, args, told):
    status, found, error = run(capsys, "localize", room, "--bounce", 135, *args)
    assert status == 2
    assert found is None
    assert told in error.replace("--", "").replace("open-world", "open_world")
    assert len(error.strip().splitlines()) <= 3


@pytest.mark.parametrize(
    ("args", "told"),
    [
        (("90", "17"), "bounces: 17 deg is not a whole number of the 8 directions"),
        (("90", "450"), "bounces: 90 and 450 deg are the same turn"),
        (("90", "--goal", "position"), "goal has no meaning for a robot that slips"),
        (("90", "--aim", "mean"), "aim has no meaning for a robot that slips"),
        (("90", "--bounce", "45"), "bounce: expected one angle, or several in bounces"),
    ],
)
def test_bad_choices_of_angles_are_refused(capsys, room, args, told):
    status, found, error = run(capsys, "localize", room, "--slip", 0.02, "--bounces", *args)
    assert (status, found) == (2, None)
    assert told in error.replace("--", "")


def test_a_bad_slip_of_a_plan_is_refused(capsys, room):
    ends = ("--start", "0", "--goal", "5")
    status, _, error = run(capsys, "navigate", room, "--bounces", 90, *ends, "--slip", 2)
    assert status == 2
    assert "expected a number from 0 to 1, got 2" in error


def test_a_damaged_belief_does_not_run(capsys, tmp_path, room):
    path = tmp_path / "belief.jxb"
    path.write_bytes(b"not a belief")
    status, _, error = run(capsys, "robot", "run", path, "--simulate", room)
    assert status == 2
    assert "belief.jxb" in error
