import json
import math

import pytest
from rerun.chunk import RrdReader
from wheels import MAPS, bounce_filter, bounce_tables, map_cells

from jaxcell.cli.robot import RobotRun
from jaxcell.cli.robot_check import RobotCheck
from jaxcell.cli.robot_replay import RobotReplay
from jaxcell.robot.body import Body
from jaxcell.robot.emulator import Emulator, Line
from jaxcell.robot.packets import Contact


pytestmark = pytest.mark.slow


LAB = map_cells("lab_a.json")
SPEC = {"cell_m": 1.0, "directions": 8, "step_m": 1.0, "robot_radius_m": 0.0}


@pytest.fixture
def filter_file(tmp_path):
    path = tmp_path / "filter.jxf"
    bounce_filter(LAB, 45, metadata={**SPEC, "bounce_deg": 45}).save(path)
    return path


def run(command, capsys) -> tuple[int, dict]:
    code = command.run()
    return code, json.loads(capsys.readouterr().out)


def simulated(file, name="lab_a.json", **fields) -> RobotRun:
    return RobotRun(file=file, simulate=MAPS / name, speedup=100.0, json=True, **fields)


def test_a_filter_runs_in_a_simulated_map_and_its_log_replays(filter_file, tmp_path, capsys):
    out = tmp_path / "out"
    code, found = run(simulated(filter_file, start="70", out=out), capsys)
    assert code == 0
    assert found["result"] == "localized"
    assert found["emulated"]["start"] == 70
    assert found["emulated"]["end"] in found["cells"]
    assert found["emulated"]["truth_is_a_candidate"] is True
    assert json.loads((out / "summary.json").read_text()) == found
    entities = {chunk.entity_path for chunk in RrdReader(out / "run.rrd").stream().to_chunks()}
    assert {"/map/robots/robot", "/map/belief", "/map/estimates/robot", "/log"} <= entities

    code, again = run(RobotReplay(log=out / "run.jsonl", json=True), capsys)
    assert code == 0
    for name in ("result", "observations", "colors", "cells", "reason"):
        assert again[name] == found[name]
    assert RobotReplay(log=out / "run.jsonl").run() == 0
    assert found["observations"] in capsys.readouterr().out

    recorded = (out / "run.rrd").read_bytes()
    with pytest.raises(FileExistsError):
        simulated(filter_file, start="70", out=out).run()
    assert (out / "run.rrd").read_bytes() == recorded
    bounce_filter(LAB, 135, metadata={**SPEC, "bounce_deg": 135}).save(filter_file)
    with pytest.raises(ValueError, match=r"run\.jsonl: it is of another filter"):
        RobotReplay(log=out / "run.jsonl").run()


def test_a_filter_of_another_map_is_refuted(filter_file, tmp_path, capsys):
    filter = bounce_filter(LAB, 45, metadata={**SPEC, "bounce_deg": 45, "name": LAB.workspace.name})
    filter.save(filter_file)
    out = tmp_path / "out"
    code, found = run(simulated(filter_file, "lab_b.json", start="101", out=out), capsys)
    # Its cells are not those of the map that the robot is in.
    chunks = RrdReader(out / "run.rrd").stream().to_chunks()
    beliefs = [c for c in chunks if c.entity_path == "/map/belief" and not c.is_static]
    assert not beliefs
    assert any(chunk.entity_path == "/filter/uncertainty" for chunk in chunks)
    assert code == 1
    assert found["result"] == "refuted"
    assert found["observations"] in found["reason"]


def test_a_plan_runs_from_its_start(tmp_path, capsys):
    image, bumped = bounce_tables(LAB, 135)
    cell, actions = 20, []
    for _ in range(5):
        actions.append(135 * int(bumped[cell]))
        cell = int(image[cell])
    path = tmp_path / "summary.json"
    path.write_text(json.dumps({**SPEC, "found": True, "start": 20, "actions_deg": actions}))
    code, found = run(simulated(path, out=tmp_path / "out"), capsys)
    assert (code, found["result"]) == (0, "arrived")
    assert found["emulated"]["end"] == cell
    code, again = run(RobotReplay(log=tmp_path / "out" / "run.jsonl", json=True), capsys)
    assert (code, again["result"]) == (0, "arrived")


def test_check(capsys):
    with Emulator(Body(LAB.workspace, (0.5, 0.5, 0.0)), line=Line(speedup=20.0)) as robot:
        code, found = run(RobotCheck(port=robot.port, move=True, json=True), capsys)
        assert code == 0
        assert found["forward_m"] == pytest.approx(0.1, abs=0.01)
        assert found["back_m"] == pytest.approx(-0.1, abs=0.01)
        assert found["battery_percent"] == pytest.approx(100 * 2000 / 2696, abs=0.5)
        assert robot.pose == pytest.approx((0.5, 0.5, 0.0), abs=0.02)
        robot.contact = Contact.WHEEL_DROP_LEFT
        code, found = run(RobotCheck(port=robot.port, move=True, json=True), capsys)
        assert code == 1
        assert "wheel" in found["danger"]


def test_bad_options(filter_file):
    with pytest.raises(ValueError, match="one of --port and --simulate"):
        RobotRun(file=filter_file).run()
    with pytest.raises(ValueError, match="--live: expected --out as well"):
        simulated(filter_file, live="here").run()
    with pytest.raises(ValueError, match="--heading 30: expected a multiple of the 45 degrees"):
        simulated(filter_file, heading=30.0).run()
    with pytest.raises(ValueError, match=r"--start '0\.5,9,0'"):
        simulated(filter_file, start="0.5,9,0").run()
    with pytest.raises(ValueError, match="distance: expected a finite number from 0"):
        simulated(filter_file, noise=math.nan).run()
