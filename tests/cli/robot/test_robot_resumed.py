"""Runs whose process was ended are resumed from their logs, by the command and the whole driver."""

import json
import shlex
import signal
import subprocess
import sys

import pytest
from robot_files import LAB, run, save_belief, save_filter, simulated
from waiting import wait_until
from wheels import bounce_tables

from jaxcell.cli import main
from jaxcell.cli.robot.replay import RobotReplay
from jaxcell.robot import read_log


START, HEADING = 70, 135.0
ENDS = ("result", "observations", "colors", "cells", "reason")
# A shell that starts these tests in the background has the signal ignored.
MAIN = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from jaxcell.cli import main; raise SystemExit(main())"
)


def replay(log, capsys):
    capsys.readouterr()
    code, found = run(RobotReplay(log=log, json=True), capsys)
    assert code == 0
    return found


@pytest.mark.parametrize(
    ("save", "kill"),
    [(save_filter, signal.SIGINT), (save_belief, signal.SIGKILL)],
    ids=["ctrl-c", "kill"],
)
def test_a_run_whose_program_was_ended_can_be_resumed(save, kill, tmp_path, capsys):
    file, out, resumed = save(tmp_path), tmp_path / "out", tmp_path / "out-2"
    _, whole = run(simulated(file, start=str(START), heading=HEADING), capsys)
    log, place = out / "run.jsonl", ["--start", str(START), "--heading", str(HEADING)]
    words = ["robot", "run", str(file), "--simulate", "@lab_a", *place, "--json"]
    command = [sys.executable, "-c", MAIN, *words, "--out", str(out)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as process:
        wait_until(lambda: log.exists() and log.read_text().count('"observation":') >= 2)
        process.send_signal(kill)
        said, errors = process.communicate()
    before = replay(log, capsys)
    count = len(before["observations"])
    assert 2 <= count < len(whole["observations"])
    assert whole["observations"].startswith(before["observations"])
    assert set(whole["cells"]) != set(before["cells"])
    (image, _), here = bounce_tables(LAB, 45), START
    for _ in range(count):
        here = int(image[here])
    if kill == signal.SIGINT:
        assert process.returncode == 130
        stopped = json.loads(said)
        assert (stopped["result"], stopped["cells"]) == ("stopped", before["cells"])
        assert json.loads((out / "summary.json").read_text()) == stopped
        assert "jaxcell robot run: Ctrl-C; not localized after " in errors
        *_, to_resume, line = errors.splitlines()
        assert to_resume == "To resume:"
        code = main([*shlex.split(line)[1:], "--speedup", "1e6"])
        printed = capsys.readouterr()
        assert "The robot must stand " in printed.err
        found = json.loads(printed.out)
    else:
        assert process.returncode == -signal.SIGKILL
        # It may end within a line.
        with log.open("a") as lines:
            lines.write('{"event": "observation", "obs')
        code, found = run(simulated(file, start=str(here), out=resumed, resume=log), capsys)
    again = replay(resumed / "run.jsonl", capsys)
    assert code == 0
    for name in ENDS:
        assert found[name] == again[name] == whole[name], name
    # It stands where the model has it after the last whole step.
    assert found["emulated"]["start"] == here
    assert found["emulated"]["truth_is_a_candidate"] is True
    first, second = (read_log(folder / "run.jsonl").header for folder in (out, resumed))
    assert second["resumed"]["log"] == str(log)
    assert second["resumed"]["observations"] == count
    assert second["pose"] == first["pose"]
