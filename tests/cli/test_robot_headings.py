"""The heading of a robot at the start, and the travel of an emulated bumper."""

import json

import numpy as np
import pytest
import robot_files
from robot_files import LAB, SPEC
from wheels import MAPS, bounce_filter, map_cells

from jaxcell.bounce import localization_policy
from jaxcell.cli import main


@pytest.fixture
def plan_file(tmp_path):
    """A plan in a file that does not say how many positions its map has."""
    path = tmp_path / "summary.json"
    path.write_text(json.dumps({**SPEC, "found": True, "start": 20, "actions_deg": [0]}))
    return path


def simulated(file, capsys, **fields) -> dict:
    robot_files.simulated(file, **fields).run()
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("place", [["--simulate", str(MAPS / "lab_a.json")], ["--port", "none"]])
@pytest.mark.parametrize("kind", ["filter_file", "plan_file"])
def test_a_task_that_needs_a_heading_is_refused_without_it(request, capsys, place, kind):
    path = request.getfixturevalue(kind)
    assert main(["robot", "run", str(path), *place]) == 2
    said = capsys.readouterr().err
    assert f"because the steps of {path} differ between directions" in said
    assert said.count("\n") == 1


def test_an_emulated_robot_knows_only_the_heading_of_the_option(filter_file, capsys):
    # A wrong heading makes its steps those of another direction.
    right, wrong = [
        simulated(filter_file, capsys, start="70", heading=heading) for heading in (135.0, 0.0)
    ]
    assert right["emulated"]["start"] == wrong["emulated"]["start"] == 70
    assert right["emulated"]["truth_is_a_candidate"]
    assert not wrong["emulated"]["truth_is_a_candidate"]


@pytest.mark.parametrize("step", [1.0, 1.4])
def test_a_robot_of_equal_steps_needs_no_heading(tmp_path, capsys, step):
    # A step of 1.4 m ends in the next cell, and the walker goes back to its centre.
    cells = map_cells("lab_a.json", directions=4)
    path = tmp_path / "filter.jxf"
    about = SPEC | {"directions": 4, "step_m": step, "bounce_deg": 90}
    bounce_filter(cells, 90, metadata=about).save(path)
    found = simulated(path, capsys, start="5", out=tmp_path / "out")
    assert found["result"] == "localized"
    assert found["emulated"]["truth_is_a_candidate"]
    header = json.loads((tmp_path / "out" / "run.jsonl").read_text().splitlines()[0])
    assert header["direction"] is None


def test_a_random_start_has_the_heading_of_the_option(filter_file, capsys):
    starts = [
        simulated(filter_file, capsys, heading=90.0, seed=seed, limit=1)["emulated"]["start"]
        for seed in range(4)
    ]
    assert {start // LAB.positions for start in starts} == {2}
    assert len(set(starts)) > 1


def test_the_travel_of_the_bumper_decides_whether_a_corner_is_grazed(tmp_path, capsys):
    path = tmp_path / "policy.jxf"
    spec = {**SPEC, "bounces_deg": [45.0, 135.0]}
    found = localization_policy(LAB, np.radians([45.0, 135.0]), metadata=spec)
    found.policy.save(path)
    results = [
        simulated(path, capsys, start="39", heading=90.0, give=give)["result"]
        for give in (None, 0.002)
    ]
    assert results == ["localized", "refuted"]
