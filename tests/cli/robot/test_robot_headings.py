"""The heading of a robot at the start, and the travel of an emulated bumper."""

import re

import pytest
from robot_files import LAB, SPEC, run, save_policy, simulated
from wheels import bounce_filter, map_cells

from jaxcell.cli.robot.run import RobotRun
from jaxcell.robot import read_log
from jaxcell.robot.tasks.anywhere_task import save_anywhere
from jaxcell.space import Workspace


SIZES = {"cell_m": 0.5, "directions": 8, "step_m": 0.5}


def test_a_heading_that_contradicts_the_start_is_refused(filter_file, capsys):
    # Cell 70 of 19 positions looks to 3 * 45 degrees.
    _, right = run(simulated(filter_file, start="70", heading=135.0), capsys)
    assert right["emulated"]["start"] == 70
    assert right["emulated"]["truth_is_a_candidate"]
    for start in ("70", "2.5,3.5,135"):
        with pytest.raises(
            ValueError, match=f"^--heading: .* 0 degrees, but at --start {start} .* 135"
        ):
            simulated(filter_file, start=start, heading=0.0).run()


def test_a_robot_whose_set_has_lost_the_truth_exits_with_status_1(tmp_path, capsys):
    # The same room, 20 m farther East than on the map of the robot.
    path = tmp_path / "anywhere.json"
    fields = {"bounce_deg": [100.0], "headings": None, "slices": 360, "errors": {"distance": 0.5}}
    room = Workspace([(0, 0), (6, 0), (6, 2), (2, 2), (2, 5), (0, 5)])
    save_anywhere(path, room, **fields, **SIZES, counted_m=0.0, known_m=5.0)
    moved = tmp_path / "moved.json"
    Workspace([(20, 0), (26, 0), (26, 2), (22, 2), (22, 5), (20, 5)]).save(moved)
    here, there = tmp_path / "room.json", moved
    room.save(here)
    # The errors of the emulated robot exceed their bounds after more bumps.
    options = {"speedup": 1e6, "json": True, "confirm": 0}
    for map, start, lost in ((here, "1,1,20", False), (there, "21,1,20", True)):
        command = RobotRun(file=path, simulate=map, start=start, **options)
        status, found = run(command, capsys)
        assert found["result"] == "localized"
        assert found["emulated"]["truth_is_a_candidate"] is not lost
        assert status == lost
    assert RobotRun(file=path, simulate=there, start="21,1,20", speedup=1e6, confirm=0).run() == 1
    assert re.search(r"started at *│ \(21\.00 m, 1\.00 m, 20\.0°\)", capsys.readouterr().out)


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
