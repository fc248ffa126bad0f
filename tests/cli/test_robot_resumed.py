"""Runs that end in any manner go on from their logs, through the command and the whole driver."""

import functools
import json
import signal
import subprocess
import sys

import pytest
from robot_files import LAB, run, save_belief, save_filter, simulated
from waiting import wait_until
from wheels import MAPS, bounce_tables

from jaxcell.cli.robot.replay import RobotReplay


START, HEADING = 70, 135.0
ENDS = ("result", "observations", "colors", "cells", "reason")
# A shell that starts these tests in the background has the signal ignored.
MAIN = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from jaxcell.cli import main; raise SystemExit(main())"
)


@pytest.fixture(scope="module", params=[save_filter, save_belief], ids=["filter", "belief"])
def file(request, tmp_path_factory):
    """The task of a run."""
    return request.param(tmp_path_factory.mktemp("task"))


@pytest.fixture(scope="module")
def whole(file, tmp_path_factory):
    """The summary of a run that nothing stops."""
    out = tmp_path_factory.mktemp("whole") / "out"
    simulated(file, start=str(START), heading=HEADING, out=out).run()
    return json.loads((out / "summary.json").read_text())


def await_observations(log, count):
    wait_until(lambda: log.exists() and log.read_text().count('"observation":') >= count)


def stand(count):
    """The cell where the model has the robot after a number of observations."""
    image, _ = bounce_tables(LAB, 45)
    return functools.reduce(lambda cell, _: int(image[cell]), range(count), START)


def replay(log, capsys):
    capsys.readouterr()
    code, found = run(RobotReplay(log=log, json=True), capsys)
    assert code == 0
    return found


def goes_on(log, file, whole, capsys, tmp_path):
    """Resume a run and look at both logs and the end."""
    before = replay(log, capsys)
    count = len(before["observations"])
    assert 2 <= count < len(whole["observations"])
    assert whole["observations"].startswith(before["observations"])
    assert set(whole["cells"]) != set(before["cells"])
    on = tmp_path / "on"
    code, found = run(simulated(file, start=str(stand(count)), out=on, resume=log), capsys)
    again = replay(on / "run.jsonl", capsys)
    assert code == 0
    for name in ENDS:
        assert found[name] == whole[name], name
        assert again[name] == whole[name], name
    assert found["emulated"]["truth_is_a_candidate"] is True


@pytest.mark.parametrize("kill", [signal.SIGINT, signal.SIGKILL], ids=["ctrl-c", "kill"])
def test_a_run_whose_program_was_ended_can_be_resumed(file, whole, tmp_path, capsys, kill):
    out = tmp_path / "out"
    log = out / "run.jsonl"
    with subprocess.Popen(
        [
            *(sys.executable, "-c", MAIN, "robot", "run", file, "--json"),
            *("--simulate", MAPS / "lab_a.json", "--start", str(START), "--heading", str(HEADING)),
            *("--speedup", "10", "--out", out),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        await_observations(log, 2)
        process.send_signal(kill)
        said, errors = process.communicate()
    if kill == signal.SIGINT:
        assert process.returncode == 130
        found = json.loads(said)
        assert (found["result"], found["cells"]) == ("stopped", replay(log, capsys)["cells"])
        assert json.loads((out / "summary.json").read_text()) == found
        assert "jaxcell robot run: Ctrl-C; not localized after " in errors
    else:
        assert process.returncode == -signal.SIGKILL
        # It may end within a line.
        with log.open("a") as lines:
            lines.write('{"event": "observation", "obs')
    goes_on(log, file, whole, capsys, tmp_path)
