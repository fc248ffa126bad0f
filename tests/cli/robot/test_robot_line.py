"""Whole runs of `robot run --port`, with an emulated robot on a pseudo-terminal."""

import json

import pytest
from helpers import run
from robot_files import LAB, save_belief, save_filter, save_policy
from wheels import MAPS, body_in

from jaxcell.robot.emulation.emulator import Emulator, Line


START, HEADING = 70, 135
SAME = ("result", "reason", "observations", "colors", "cells")


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("save", [save_filter, save_policy, save_belief])
def test_a_run_on_a_line_equals_the_emulated_run(save, tmp_path, capsys, monkeypatch):
    # No calibration of the user.
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    words = "robot run", save(tmp_path), "--heading", HEADING
    simulated = "--simulate", MAPS / "lab_a.json", "--start", START, "--speedup", 1e6
    status, expected, _ = run(capsys, *words, *simulated)
    assert status == 0
    assert len(expected["observations"]) > 3

    out = tmp_path / "out"
    with Emulator(body_in(LAB, START), line=Line(speedup=20.0)) as robot:
        status, found, _ = run(capsys, *words, "--port", robot.port, "--out", out)
        end = int(LAB.index(*robot.pose))
    assert status == 0
    assert {name: found[name] for name in SAME} == {name: expected[name] for name in SAME}
    assert end == expected["emulated"]["end"]
    assert end in found["cells"]
    assert json.loads((out / "summary.json").read_text()) == found
    _, again, _ = run(capsys, "robot replay", out / "run.jsonl")
    assert {name: again[name] for name in SAME} == {name: found[name] for name in SAME}
