"""The confirmation of the answer of a run, and the notes on it."""

import dataclasses
import json
import math

import numpy as np
import pytest
from robot_files import LAB, SPEC, run, save_filter, save_policy, simulated
from wheels import MAPS, bounce_filter, orbit

from jaxcell.automata import Policy
from jaxcell.automata.filter import CONFIRM
from jaxcell.base.bundled import bundled
from jaxcell.base.formatting import configuration
from jaxcell.cli.robot.replay import RobotReplay
from jaxcell.robot import read_log
from jaxcell.robot.tasks.files import load_task, other_rooms
from jaxcell.space import Workspace


def wrong_run(folder, **about):
    """A robot in Lab B that runs the filter of Lab A without confirmation, and is localized."""
    path = folder / "filter.jxf"
    about = {**SPEC, "name": LAB.workspace.name, "bounce_deg": 135, **about}
    bounce_filter(LAB, 135, metadata=about).save(path)
    return simulated(path, "lab_b.json", confirm=0, start="62", heading=135.0)


@pytest.mark.parametrize("place", [str(MAPS / "lab_a.json"), "nowhere.json"])
@pytest.mark.parametrize("as_json", [True, False])
def test_a_wrong_answer_of_an_emulated_robot_has_exit_status_1(place, as_json, tmp_path, capsys):
    command = dataclasses.replace(wrong_run(tmp_path, map=place), json=as_json)
    for start in range(40, 152, 8):
        heading = 45.0 * (start // 19)
        code = dataclasses.replace(command, start=str(start), heading=heading).run()
        out = capsys.readouterr().out
        if "localized to" in " ".join(out.split()):
            assert '"truth_is_a_candidate": false' in out if as_json else "NO" in out
            assert code == 1
            return
    pytest.fail("no robot was localized")


def test_cells_are_those_of_the_map_of_the_task(tmp_path, capsys):
    """In a lab with a lower obstacle the robot is localized to the pose of Lab A where it is."""
    lab = Workspace.load(bundled("lab_a"))
    path = tmp_path / "filter.jxf"
    about = {**SPEC, "name": lab.name, "positions": 19, "map": "@lab_a", "bounce_deg": 135}
    bounce_filter(LAB, 135, metadata=about).save(path)
    lower = np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0]])
    dataclasses.replace(lab, obstacles=(lower, lab.obstacles[1])).save(tmp_path / "lower.json")
    command = simulated(path, start="0.5,0.5,135", heading=135.0)
    command = dataclasses.replace(command, simulate=tmp_path / "lower.json")
    code, answer = run(command, capsys)
    assert (code, answer["result"]) == (0, "localized")
    assert answer["emulated"]["truth_is_a_candidate"] is True
    x, y, heading = answer["emulated"]["pose"]
    assert answer["cells"] == [int(LAB.index(x, y, math.radians(heading)))]
    assert dataclasses.replace(command, json=False).run() == 0
    shown = " ".join(capsys.readouterr().out.replace("│", "").split())
    assert f"may be at {configuration(LAB, answer['cells'][0])}" in shown


def test_a_run_confirms_its_answer_and_its_log_says_by_how_much(tmp_path, capsys):
    file, out = save_filter(tmp_path), tmp_path / "out"
    words = [orbit(LAB, 45, 70, 200)[0]]
    known = dataclasses.replace(simulated(file, start="70", heading=135.0), confirm=0)
    at_once = run(known, capsys)[1]
    assert at_once["reason"].endswith(f" after {len(at_once['observations'])} observations")
    for confirm, folder in ((None, out), (7, tmp_path / "other")):
        command = simulated(file, start="70", heading=135.0, confirm=confirm, out=folder)
        code, answer = run(command, capsys)
        more = CONFIRM if confirm is None else confirm
        count = len(at_once["observations"]) + more
        assert (code, answer["observations"]) == (0, words[0][:count])
        log = read_log(folder / "run.jsonl")
        assert log.header["confirm"] == more
        replayed = run(RobotReplay(log=folder / "run.jsonl", json=True), capsys)[1]
        assert replayed["reason"] == answer["reason"]


def test_the_option_is_for_robots_that_are_localized(tmp_path):
    path = tmp_path / "summary.json"
    path.write_text(json.dumps({**SPEC, "found": True, "start": 20, "actions_deg": [0.0]}))
    with pytest.raises(ValueError, match="--confirm: it has an effect only for a filter or policy"):
        simulated(path, confirm=3, heading=45.0).run()


def test_a_policy_without_its_table_is_not_confirmed_and_the_run_says_so(tmp_path, capsys):
    path = save_policy(tmp_path)
    dataclasses.replace(Policy.load(path), onward=None).save(path)
    command = simulated(path, start="3", heading=0.0, out=tmp_path / "out")
    assert command.run() == 0
    assert "a policy of an earlier version cannot confirm its answer" in capsys.readouterr().err
    assert read_log(tmp_path / "out" / "run.jsonl").header["confirm"] == 0


def test_the_share_of_robots_elsewhere_is_that_of_the_confirmation(tmp_path, capsys):
    shares = {"0": 0.25, "10": 0.125, "100": 0.0}
    file = save_filter(tmp_path, other_room_shares=shares, other_rooms=8)
    task = load_task(file)
    assert [other_rooms(task, n)["other_room_share"] for n in (0, 9, 10, 99, 100, 500)] == [
        0.25, 0.25, 0.125, 0.125, 0.0, 0.0,
    ]  # fmt: skip
    nothing = {"other_room_share": None, "other_rooms": None}
    assert other_rooms(load_task(save_policy(tmp_path)), 30) == nothing
    answer = run(simulated(file, start="70", heading=135.0), capsys)[1]
    assert (answer["other_room_share"], answer["other_rooms"]) == (0.125, 8)


def test_a_start_from_which_the_robot_touches_a_corner_is_noted(tmp_path, capsys):
    said = "From this start the robot touches a corner"
    path = tmp_path / "filter.jxf"
    bounce_filter(LAB, 135, metadata={**SPEC, "bounce_deg": 135}).save(path)
    found = set()
    for cell in range(19, 38):
        simulated(path, start=str(cell), heading=45.0, limit=1).run()
        found.add(said in capsys.readouterr().err)
    assert found == {True, False}
