"""The heading of a robot at the start, and the travel of an emulated bumper."""

import pytest
from robot_files import LAB, SPEC, run, save_policy, simulated
from wheels import bounce_filter, map_cells

from jaxcell.robot import read_log


def test_an_emulated_robot_knows_only_the_heading_of_the_option(filter_file, capsys):
    # A wrong heading makes its steps those of another direction.
    right, wrong = [
        run(simulated(filter_file, start="70", heading=heading), capsys)[1]
        for heading in (135.0, 0.0)
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
    _, found = run(simulated(path, start="5", out=tmp_path / "out"), capsys)
    assert found["result"] == "localized"
    assert found["emulated"]["truth_is_a_candidate"]
    assert read_log(tmp_path / "out" / "run.jsonl").header["direction"] is None


def test_a_random_start_has_the_heading_of_the_option(filter_file, capsys):
    runs = [simulated(filter_file, heading=90.0, seed=seed, limit=1) for seed in range(4)]
    starts = [run(command, capsys)[1]["emulated"]["start"] for command in runs]
    assert {start // LAB.positions for start in starts} == {2}
    assert len(set(starts)) > 1


def test_the_travel_of_the_bumper_decides_whether_a_corner_is_grazed(tmp_path, capsys):
    path = save_policy(tmp_path)
    results = [
        run(simulated(path, start="39", heading=90.0, give=give), capsys)[1]["result"]
        for give in (None, 0.002)
    ]
    assert results == ["localized", "refuted"]
