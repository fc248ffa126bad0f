"""Whole runs of `robot run --port`, with an emulated robot on a pseudo-terminal."""

import dataclasses
import json
import math

import numpy as np
import pytest
from wheels import MAPS, body_in, bounce_filter, map_cells

from jaxcell.bounce import FineCells, localization_policy, slip_map
from jaxcell.cli import main
from jaxcell.robot.emulation.emulator import Emulator, Line
from jaxcell.space import Slip


LAB = map_cells("lab_a.json")
START, HEADING = 70, 135
SAME = ("result", "reason", "observations", "colors", "cells")
ABOUT = {"cell_m": 1.0, "directions": 8, "step_m": 1.0, "robot_radius_m": 0.0}


def save_filter(folder):
    path = folder / "filter.jxf"
    bounce_filter(LAB, 45, metadata={**ABOUT, "bounce_deg": 45}).save(path)
    return path


def save_policy(folder):
    path = folder / "policy.jxf"
    about = {**ABOUT, "bounces_deg": [45.0, 135.0]}
    localization_policy(LAB, np.radians([45.0, 135.0]), metadata=about).policy.save(path)
    return path


def save_belief(folder):
    path = folder / "belief.jxb"
    fine = FineCells.of(LAB, squares=3, directions=4, reach=2)
    hidden = slip_map(fine, [math.radians(45)], Slip.of(0.02))
    dataclasses.replace(hidden, metadata={**ABOUT, "bounce_deg": 45}).save(path)
    return path


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("save", [save_filter, save_policy, save_belief])
def test_a_run_on_a_line_is_that_of_the_emulator(save, tmp_path, capsys, monkeypatch):
    # No calibration of the user.
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    words = ["robot", "run", str(save(tmp_path)), "--heading", str(HEADING), "--json"]
    simulated = ["--simulate", str(MAPS / "lab_a.json"), "--start", str(START)]
    assert main([*words, *simulated, "--speedup", "1e6"]) == 0
    expected = json.loads(capsys.readouterr().out)
    assert len(expected["observations"]) > 3

    out = tmp_path / "out"
    with Emulator(body_in(LAB, START), line=Line(speedup=20.0)) as robot:
        assert main([*words, "--port", robot.port, "--out", str(out)]) == 0
        found = json.loads(capsys.readouterr().out)
        end = int(LAB.index(*robot.pose))
    assert {name: found[name] for name in SAME} == {name: expected[name] for name in SAME}
    assert end == expected["emulated"]["end"]
    assert end in found["cells"]
    assert json.loads((out / "summary.json").read_text()) == found
    assert main(["robot", "replay", str(out / "run.jsonl"), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert {name: again[name] for name in SAME} == {name: found[name] for name in SAME}
