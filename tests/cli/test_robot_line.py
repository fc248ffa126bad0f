"""Whole runs of `robot run --port`, with an emulated robot on a pseudo-terminal."""

import json

import pytest
from robot_files import LAB, save_belief, save_filter, save_policy
from wheels import MAPS, body_in

from jaxcell.cli import main
from jaxcell.robot.emulation.emulator import Emulator, Line


START, HEADING = 70, 135
SAME = ("result", "reason", "observations", "colors", "cells")


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("save", [save_filter, save_policy, save_belief])
def test_a_run_on_a_line_equals_the_emulated_run(save, tmp_path, capsys, monkeypatch):
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
