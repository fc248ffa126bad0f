"""The commands for a robot that slips."""

import re

import numpy as np
import pytest
import xarray as xr
from helpers import run

from jaxcell.automata import Belief, HiddenMap


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


def test_a_belief_has_at_most_the_given_number_of_fine_cells(capsys, room):
    args = ("localize slip", room, "--bounce", 90, "--errors", "slip=0.02")
    counts = [run(capsys, *args, "--max-fine-cells", most)[1]["fine_cells"] for most in (500, 1500)]
    assert 100 < counts[0] <= 500 < counts[1] <= 1500


def test_a_robot_that_slips_chooses_among_its_angles(capsys, tmp_path, room):
    out, again = tmp_path / "out", tmp_path / "run"
    args = ("localize slip", room, "--bounce", 90, 135, "--errors", "slip=2%", "--start", 3)
    status, answer, _ = run(capsys, *args, "--out", out, "--verify")
    assert status == 0
    assert (answer["bounce_deg"], answer["errors"]) == ([90, 135], ["slip=2%"])
    assert {"collision", "know", "aim", "open_world"}.isdisjoint(answer)
    said = r"After \d+ steps? and \d+ bumps? the robot is at .* with .* [\d.]+ %, by its .*"
    assert re.fullmatch(said, answer["answer"][0])
    hidden = HiddenMap.load(out / "belief.jxb")
    assert hidden.angles == 2
    with xr.open_dataset(out / "localization.nc") as dataset:
        turned = dataset.turned_by.values
        np.testing.assert_array_equal(turned[1:] >= 0, dataset.observations.values == 1)
        assert set(turned.tolist()) <= {-1, 0, 1}
    belief = Belief(hidden)
    state = belief.start()
    for observation, turn in zip(answer["word"], turned[1:].tolist(), strict=True):
        state = belief.observe(state, int(observation))
        assert state.turn == (None if turn < 0 else turn)
    words = "--simulate", room, "--seed 4 --heading 0 --errors slip=2% --speedup 1000 --out", again
    status, driven, _ = run(capsys, "robot run", out / "belief.jxb", *words)
    assert status == 0
    status, replayed, _ = run(capsys, "robot", "replay", again / "run.jsonl")
    assert replayed["observations"] == driven["observations"]


def test_plan_and_emulated_robot_arrive_alike_despite_slips(capsys, room):
    ends = ("--start", "1.5,1.5,0", "--goal", "1.5,1.5,180")
    status, answer, _ = run(
        capsys, "navigate slip", room, "--bounce 90 135", *ends, "--errors slip=2% --directions 8"
    )
    assert status == 0
    assert 0 <= answer["plan_arrives"] <= answer["plan_as_foretold"] <= 1
    assert answer["policy_surely_arrives"]
    assert answer["policy_mean_steps"] >= 1
    assert answer["simulated_runs"] == 50
    assert answer["answer"][0].startswith("With slip this plan arrives with a probability of ")
    least, most = answer["plan_arrives_from"], answer["plan_arrives_to"]
    assert least <= answer["plan_arrives"] <= most <= least + 0.02
    # Runs of the emulated robot, of which there are 50, share no code with those of the plan.
    assert answer["simulated_plan_arrives"] == pytest.approx(answer["plan_arrives"], abs=0.2)
    assert answer["simulated_policy_arrives"] > 0.3
