import json
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import sweep_stub
import xarray as xr
from helpers import python, run
from waiting import wait_until

from jaxcell.cli import main
from jaxcell.sweep import open_sweep, sweep_status


PROGRAM = "import sys; from jaxcell.cli import main; sys.exit(main())"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(sweep_stub.__file__).parent)}


@pytest.fixture
def spec(tmp_path):
    def written(fixed="", grid="x = {count = 10}", chunk=4):
        path = tmp_path / "some.toml"
        path.write_text(
            f'task = "sweep_stub:stub"\nchunk = {chunk}\n[fixed]\n{fixed}\n[grid]\n{grid}\n'
        )
        return str(path)

    return written


def test_a_sweep_and_its_status(spec, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, answer, _ = run(capsys, "sweep", spec(), "--netcdf")
    assert status == 0
    assert answer.pop("seconds") >= 0
    with xr.open_dataset("runs/some/sweep.nc") as one, open_sweep("runs/some") as other:
        xr.testing.assert_identical(one.load(), other.load())
    assert run(capsys, "sweep status runs/some") == (0, answer, "")
    assert main(["sweep", "status", "runs/some"]) == 0
    printed = capsys.readouterr()
    assert "3 of 3" in printed.out
    assert 'xarray.open_zarr("runs/some/sweep.zarr")' in printed.err


def test_failures_are_reported(spec, tmp_path, capsys):
    out = str(tmp_path / "out")
    assert main(["sweep", spec("fail = 5"), "--out", out]) == 1
    printed = capsys.readouterr()
    assert "2 of 3" in printed.out
    assert "a member of chunk 1 failed (x 5): RuntimeError: x is 5" in printed.err
    assert f"{tmp_path / 'out' / 'failures.json'} has their tracebacks" in printed.err
    assert "To compute the rest: the same command with --resume" in printed.err
    status, answer, _ = run(capsys, "sweep status", out)
    assert (status, answer["done"], answer["failed"]) == (1, 2, 1)
    assert answer["failures"] == [
        {"chunk": 1, "parameters": {"x": 5}, "message": "RuntimeError: x is 5"}
    ]


def test_a_resume_is_proposed_unless_all_failures_are_wrong_parameters(tmp_path, capsys):
    (tmp_path / "spec.toml").write_text(
        'task = "groups"\n[fixed]\nmap = "@lab_a"\n[grid]\nbounce = [50.0, 45.0, 55.0]\n'
    )
    words = ["sweep", str(tmp_path / "spec.toml"), "--out", str(tmp_path / "out")]
    # Two members are left to compute.
    assert main([*words, "--max-failures", "0"]) == 1
    assert "To compute the rest" in capsys.readouterr().err
    assert main([*words, "--resume"]) == 1
    printed = capsys.readouterr().err
    assert "Trying these members again cannot help" in printed
    assert "To compute the rest" not in printed


def test_only_ten_failures_are_printed(spec, tmp_path, capsys, monkeypatch):
    def broken(batch, fixed, seed):
        raise RuntimeError

    monkeypatch.setattr(sweep_stub, "stub", broken)
    assert main(["sweep", spec(chunk=1, grid="x = {count = 30}"), "--out", str(tmp_path)]) == 1
    printed = capsys.readouterr().err
    assert printed.count(" failed (") == 10
    assert "a member of chunk 9 failed (x 9): RuntimeError" in printed
    assert f"... and others: {tmp_path / 'failures.json'} has their tracebacks" in printed


@pytest.mark.parametrize("engine", ["local", "processes --workers 1", "dask --workers 1"])
def test_a_task_that_prints_leaves_the_output_to_the_result(spec, tmp_path, engine):
    path = Path(spec())
    path.write_text(path.read_text().replace(":stub", ":chatty"))
    words = ["sweep", path, "--json", "--out", tmp_path / "out", "--engine", *engine.split()]
    printed, errors = python("-c", PROGRAM, *words, env=ENVIRONMENT)
    assert json.loads(printed)["done"] == 3
    assert errors.count("from Python") == errors.count("from elsewhere") == 3


def test_a_sweep_stops_when_too_many_fail(spec, tmp_path, capsys):
    words = "sweep", spec("fail = 1", chunk=1), "--out", tmp_path / "out", "--max-failures"
    status, answer, note = run(capsys, *words, 0)
    assert (status, answer["done"], answer["failed"]) == (1, 1, 1)
    assert "Stopped: more than 0 members failed" in note
    status, _, error = run(capsys, *words, -1)
    assert status == 2
    assert "--max-failures: expected 0 or more, got -1" in error


def test_a_running_sweep_reports_its_rate(spec, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("jaxcell.sweep.workers.progress.SECONDS_BETWEEN", 0)
    kept, out = sweep_stub.stub, str(tmp_path / "out")

    def curious(batch, fixed, seed):
        main(["sweep", "status", out])
        return kept(batch, fixed, seed)

    monkeypatch.setattr(sweep_stub, "stub", curious)
    assert main(["sweep", spec(grid="x = {count = 12}"), "--out", out, "--json"]) == 0
    # Two of the three chunks begin after another has ended.
    printed = capsys.readouterr().err
    assert printed.count("members per second") == printed.count("time left") == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_sweep_prints_the_command_that_continues(spec, tmp_path, capsys, number):
    path, out = spec("seconds = 0.1", grid="x = {count = 4000}"), tmp_path / "out"
    given = ["--workers", "1", "--engine", "processes", "--max-failures", "3"]
    # A background shell may have left SIGINT ignored.
    listens = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    command = [sys.executable, "-c", listens + PROGRAM, "sweep", path, "--out", str(out), *given]
    process = subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    begun = out / "sweep.journal"
    try:
        wait_until(lambda: begun.exists() and sweep_status(out).done)
    finally:
        process.send_signal(number)
        _, printed = process.communicate()
    assert process.returncode == 128 + number
    # Where the machine is busy, Zarr grumbles when it is left.
    assert (
        f"Stopped. Finished chunks are kept in {out}; to continue: "
        f"{shlex.join(['jaxcell', 'sweep', str(path), '--out', str(out)])} --resume "
        "--engine processes --workers 1 --max-failures 3\n"
    ) in printed
    status, answer, _ = run(capsys, "sweep status", out)
    assert status == 1
    assert 0 < answer["done"] < answer["chunks"]
    assert answer["running"] is None


def test_sweep_status_imports_no_slow_package(spec, tmp_path):
    out = str(tmp_path / "out")
    assert main(["sweep", spec(), "--out", out, "--json"]) == 0
    program = (
        "import sys\nfrom jaxcell.cli import main\n"
        f"assert main(['sweep', 'status', {out!r}]) == 0\n"
        "slow = {'jax', 'xarray', 'pandas', 'zarr', 'dask', 'scipy'}\n"
        "assert not slow & set(sys.modules)"
    )
    python("-c", program)
