import json
import math
import shlex
from unittest import mock

import numpy as np
import pytest
from rerun.chunk import RrdReader
from robot_files import LAB, SPEC, run, save_filter, simulated
from wheels import MAPS, bounce_filter, bounce_tables, map_cells, pose_of

from jaxcell.cli import app
from jaxcell.cli.robot.check import RobotCheck
from jaxcell.cli.robot.emulation import Emulation
from jaxcell.cli.robot.outcome import show
from jaxcell.cli.robot.replay import RobotReplay
from jaxcell.cli.robot.resume import resume_command
from jaxcell.cli.robot.run import RobotRun
from jaxcell.robot.calibration import Calibration, calibration_file
from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.create.motion import Create
from jaxcell.robot.create.packets import Contact
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.emulator import Emulator, Line
from jaxcell.robot.run_log import RunLog, read_log
from jaxcell.robot.tasks.files import load_task
from jaxcell.robot.walker import Walker


def test_a_filter_runs_in_a_simulated_map_and_its_log_replays(tmp_path, capsys):
    filter_file = save_filter(tmp_path, map=str(MAPS / "lab_a.json"), name=LAB.workspace.name)
    out, seen = tmp_path / "out", tmp_path / "seen"
    code, answer = run(simulated(filter_file, start="70", heading=135.0, out=out), capsys)
    assert code == 0
    assert answer["result"] == "localized"
    assert answer["emulated"]["start"] == 70
    assert answer["emulated"]["end"] in answer["cells"]
    assert answer["emulated"]["truth_is_a_candidate"] is True
    assert json.loads((out / "summary.json").read_text()) == answer

    recorded = (out / "run.rrd").read_bytes()
    with pytest.raises(FileExistsError, match=r"^--out .*: it has the run\.jsonl of another run"):
        simulated(filter_file, start="70", heading=135.0, out=out).run()
    assert (out / "run.rrd").read_bytes() == recorded

    # Elsewhere, the log and the filter make the recording.
    log, moved = out / "run.jsonl", filter_file.rename(tmp_path / "moved.jxf")
    code, again = run(RobotReplay(log=log, file=moved, out=seen, json=True), capsys)
    assert code == 0
    for name in ("result", "observations", "colors", "cells", "reason"):
        assert again[name] == answer[name]
    replay = RobotReplay(log=log, file=moved, out=seen, json=True)
    full = mock.patch("jaxcell.record.RobotRecording.event", side_effect=OSError("full"))
    with full, pytest.raises(OSError, match="full"):
        replay.run()
    assert sorted(path.name for path in seen.iterdir()) == ["result.json", "run.rrd"]
    assert run(replay, capsys)[0] == 0
    chunks = [RrdReader(folder / "run.rrd").stream().to_chunks() for folder in (out, seen)]
    here, there = ({chunk.entity_path for chunk in each} for each in chunks)
    assert {"/map/robots/robot", "/map/belief", "/map/estimates/robot", "/log"} <= here <= there
    rows = [
        sum(c.to_record_batch().num_rows for c in each if c.entity_path == "/filter/uncertainty")
        for each in chunks
    ]
    assert rows[0] == rows[1] > 5
    assert RobotReplay(log=log, file=moved).run() == 0
    assert answer["observations"] in capsys.readouterr().out
    bounce_filter(LAB, 135, metadata={**SPEC, "bounce_deg": 135}).save(filter_file)
    with pytest.raises(ValueError, match=r"run\.jsonl: the log is of another filter"):
        RobotReplay(log=log).run()


PLAN_START = 20


def plan_file(folder, **about):
    """A plan of five actions from `PLAN_START`, where the robot heads North East."""
    path = folder / "summary.json"
    actions = [135 * int(one) for one in model_run(135, PLAN_START, 5)[1]]
    plan = {**SPEC, "found": True, "start": PLAN_START, "actions_deg": actions}
    path.write_text(json.dumps(plan | about))
    return path


def model_run(bounce, cell, count):
    """The cell where the model has a robot after a number of steps, and what it observes."""
    image, bumped = bounce_tables(LAB, bounce)
    observed = ""
    for _ in range(count):
        observed += str(int(bumped[cell]))
        cell = int(image[cell])
    return cell, observed


@pytest.mark.parametrize("about", [{"positions": LAB.positions}, {}], ids=["whole", "no map"])
def test_a_plan_runs_from_its_start(tmp_path, capsys, about):
    path = plan_file(tmp_path, **about)
    # The file of a plan says its heading if it has the number of positions.
    heading = None if about else 45.0
    code, answer = run(simulated(path, heading=heading, out=tmp_path / "out"), capsys)
    assert (code, answer["result"]) == (0, "arrived")
    assert answer["emulated"]["end"] == model_run(135, PLAN_START, 5)[0]
    code, again = run(RobotReplay(log=tmp_path / "out" / "run.jsonl", json=True), capsys)
    assert (code, again["result"]) == (0, "arrived")


@pytest.mark.usefixtures("patient")
def test_check_reports_sensors_and_danger(capsys):
    with Emulator(Body(LAB.workspace, (0.5, 0.5, 0.0)), line=Line(speedup=20.0)) as robot:
        code, answer = run(RobotCheck(port=robot.port, move=True, json=True), capsys)
        assert code == 0
        assert answer["forward_m"] == pytest.approx(0.1, abs=0.01)
        assert answer["back_m"] == pytest.approx(-0.1, abs=0.01)
        assert answer["battery_percent"] == pytest.approx(100 * 2000 / 2696, abs=0.5)
        assert robot.pose == pytest.approx((0.5, 0.5, 0.0), abs=0.02)
        robot.contact = Contact.WHEEL_DROP_LEFT
        code, answer = run(RobotCheck(port=robot.port, move=True, json=True), capsys)
        assert code == 1
        assert "wheel" in answer["danger"]


# The error that stops a run at its fourth step, the exit status, and the reason in the summary.
STOPS = [
    (RobotStopped("there is a cliff"), 1, "the robot was stopped: there is a cliff"),
    (KeyboardInterrupt(), 130, "Ctrl-C"),
    (SystemExit(143), 143, "a signal ended the program"),
]


@pytest.mark.parametrize(("error", "status", "why"), STOPS, ids=["cliff", "ctrl-c", "signal"])
@pytest.mark.parametrize("to_files", [True, False])
def test_a_stopped_run_reports_the_reason(
    filter_file, tmp_path, capsys, monkeypatch, error, status, why, to_files
):
    def step(walker, step=Walker.step):
        if walker.drives and len(walker.observations) == 3:
            raise error
        return step(walker)

    monkeypatch.setattr(Walker, "step", step)
    observed = model_run(45, 70, 3)[1]
    out = tmp_path / "out" if to_files else None
    code = simulated(filter_file, start="70", heading=135.0, out=out).run()
    captured = capsys.readouterr()
    answer = json.loads(captured.out)
    assert why in captured.err
    assert (code, answer["result"], answer["observations"]) == (status, "stopped", observed)
    assert answer["reason"].startswith(f"{why}; not localized after 3 observations; ")
    assert len(answer["colors"]) == 3
    assert answer["cells"]
    assert answer["emulated"]["start"] == 70
    if out is not None:
        assert json.loads((out / "summary.json").read_text()) == answer
        code, again = run(RobotReplay(log=out / "run.jsonl", json=True), capsys)
        assert code == 0
        for name in ("result", "observations", "colors", "cells", "reason"):
            assert again[name] == answer[name]


def test_a_robot_that_cannot_be_armed_has_a_summary_too(filter_file, capsys, monkeypatch):
    def arm(_):
        raise RobotStopped("it is on the charger")

    monkeypatch.setattr(Create, "arm", arm)
    code, answer = run(simulated(filter_file, start="70", heading=135.0), capsys)
    assert (code, answer["result"], answer["observations"]) == (1, "stopped", "")
    assert answer["reason"] == "the robot was stopped: it is on the charger"


def test_the_command_that_resumes_has_the_options_of_the_run(filter_file, tmp_path):
    fields = {"remap": ("a:=b", "c:=d"), "out": tmp_path / "my run-2", "until": "cycle"}
    command = RobotRun(file=filter_file, ros="base", heading=0.0, json=True, **fields)
    for name in ("my run-2", "my run-3"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.jsonl").touch()
    words = shlex.split(resume_command(command, tmp_path / "run.jsonl", None))
    _, read = app.read(words[1:])
    resumed = {"heading": None, "resume": tmp_path / "run.jsonl", "out": tmp_path / "my run-4"}
    assert vars(read) == vars(command) | resumed
    words = shlex.split(resume_command(command, tmp_path / "run.jsonl", "-0.5,1,90"))
    assert app.read(words[1:])[1].start == "-0.5,1,90"


def test_cells_of_a_map_that_is_not_found_are_shown_by_their_numbers(capsys):
    emulated = {"start": 0, "end": 1, "truth_is_a_candidate": False}
    summary = {"result": "localized", "reason": "", "observations": "01", "cells": [0, 5000]}
    emulation = Emulation(None, LAB, 0, (0.5, 0.5, 0.0))
    show("belief.jxb", summary | {"emulated": emulated}, emulation)
    assert "cell 5000 of another map" in capsys.readouterr().out
    show("belief.jxb", summary | {"emulated": emulated, "cells": [0]}, emulation, LAB)
    assert "may be at" in (shown := capsys.readouterr().out)
    assert shown.count("0.5 m, 0.5 m, heading 0° (cell 0)") == 2


def test_logs_of_another_task_cannot_be_resumed(filter_file, tmp_path):
    task = load_task(filter_file)
    log = tmp_path / "run.jsonl"

    def go_on(events, **changed):
        log.unlink(missing_ok=True)
        with RunLog(log, {**task.header, "direction": 0} | changed) as file:
            for observation, color in events:
                file.event("observation", observation=observation, color=color)
        simulated(filter_file, start="70", resume=log).run()

    filter = task.filter
    whole, state = [], filter.start()
    while not state.localized:
        one = 0 if filter.transition[state.index, 0] >= 0 else 1
        state = state.observe(one)
        whole.append((one, state.color))
    for events, changed, message in (
        ([(0, 1)], {"sha256": "0"}, r"it is the log of another filter than .*\.jxf$"),
        ([(0, 1)], {"step_m": 2.0}, r"step_m: the log has 2\.0, .* has 1\.0$"),
        ([(0, 5)], {}, "observation 0: the log has colour 5"),
        ([], {}, "it has no observation"),
        (whole, {}, "that run is complete: localized"),
    ):
        with pytest.raises(ValueError, match=rf"run\.jsonl: {message}"):
            go_on(events, **changed)
    with pytest.raises(ValueError, match="heading: it has an effect only without `resume`"):
        simulated(filter_file, start="70", heading=0.0, resume=log).run()
    with pytest.raises(ValueError, match="--resume: expected --start too"):
        simulated(filter_file, resume=log).run()


@pytest.mark.usefixtures("patient")
def test_a_run_on_a_line_goes_by_the_calibration_of_its_user(
    filter_file, tmp_path, capsys, monkeypatch
):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    # It heads East, and a step ahead of it is free.
    start = pose_of(LAB, int(np.flatnonzero(~bounce_tables(LAB, 45)[1])[0]))
    calibration_file().parent.mkdir()
    Calibration(distance=1.05).save(calibration_file())

    def run_on(**fields):
        out = tmp_path / f"out{len(list(tmp_path.iterdir()))}"
        with Emulator(Body(LAB.workspace, start), line=Line(speedup=100.0)) as robot:
            RobotRun(file=filter_file, port=robot.port, limit=1, out=out, **fields).run()
            pose = robot.pose
        calibration = read_log(out / "run.jsonl").header["calibration"]
        return calibration, math.dist(pose[:2], start[:2])

    kept, far = run_on(heading=0.0)
    assert kept == {"distance": 1.05, "angle": 1.0}
    assert f"The robot uses the calibration in {calibration_file()}" in capsys.readouterr().err
    other = tmp_path / "other.json"
    Calibration().save(other)
    kept, whole = run_on(heading=0.0, calibration=other)
    assert kept == {"distance": 1.0, "angle": 1.0}
    assert far == pytest.approx(whole / 1.05, abs=0.01)
    assert whole == pytest.approx(1.0, abs=0.01)


def test_a_filter_runs_on_a_robot_that_the_physics_engine_moves(tmp_path, capsys):
    cells = map_cells("cafe.json", cell=0.5)
    path, out = tmp_path / "filter.jxf", tmp_path / "out"
    about = {**SPEC, "cell_m": 0.5, "step_m": 0.5, "robot_radius_m": 0.17, "directions": 16}
    bounce_filter(cells, 90, metadata={**about, "bounce_deg": 90}).save(path)
    command = simulated(path, "cafe.json", physics=True, limit=6, out=out, seed=3, heading=0)
    _, answer = run(command, capsys)
    assert len(answer["observations"]) > 0
    chunks = RrdReader(out / "run.rrd").stream().to_chunks()
    assert "/map/robots/robot/body" in {chunk.entity_path for chunk in chunks}


def test_a_task_for_a_point_causes_a_note_that_a_create_is_wider(filter_file, capsys):
    simulated(filter_file, start="70", heading=135, physics=True, limit=1).run()
    assert "is for a robot of radius 0 m, and the body of a Create 2" in capsys.readouterr().err


def test_a_faster_robot_takes_less_time(filter_file, capsys):
    slow, fast = (
        run(simulated(filter_file, start="70", heading=135, speed=speed), capsys)[1]["emulated"]
        for speed in (0.1, 0.4)
    )
    assert fast["seconds"] < 0.6 * slow["seconds"]
