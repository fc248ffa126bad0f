"""Clusters of Dask whose scheduler is gone, or was never there."""

import os
import signal
import subprocess
import sys

import pytest
from waiting import wait_until

from jaxcell.cli import main


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_error_of_a_lost_scheduler_is_one_line(spec_file, tmp_path, calls, number):
    file, fixed = tmp_path / "scheduler.json", f'seconds = 0.1\nfolder = "{calls}"'
    spec = spec_file("[grid]\nx = {count = 1000}", head="chunk = 1", fixed=fixed)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    processes = []

    def start(module, *options, **more):
        command = [sys.executable, "-m", module, *options, "--scheduler-file", str(file)]
        process = subprocess.Popen(command, cwd=tmp_path, env=environment, **more)
        processes.append(process)
        return process

    quiet = {"stderr": subprocess.DEVNULL}
    alone = ["--no-dashboard", "--host", "127.0.0.1"]
    try:
        scheduler = start("distributed.cli.dask_scheduler", *alone, "--port", "0", **quiet)
        wait_until(file.exists)
        start("distributed.cli.dask_worker", *alone, "--nthreads", "1", "--no-nanny", **quiet)
        driver = start("jaxcell", "sweep", spec, stderr=subprocess.PIPE, text=True)
        wait_until(lambda: any(calls.iterdir()))
        scheduler.send_signal(number)
        message = driver.communicate()[1]
    finally:
        for process in processes:
            process.kill()
            process.wait()
    assert driver.returncode == 2
    lines = [line for line in message.splitlines() if " ... (0:" not in line]
    assert len(lines) == 1, message
    assert lines[0].startswith("jaxcell sweep: tcp://127.0.0.1:")
    assert "the scheduler of the cluster cannot be reached, or is gone" in lines[0]


def test_the_error_of_a_missing_scheduler_is_one_line(spec_file, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("jaxcell.sweep.workers.engines.CONNECT_SECONDS", 0.2)
    out = ["--out", str(tmp_path / "out"), "--engine", "dask://127.0.0.1:1"]
    assert main(["sweep", str(spec_file()), *out]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("jaxcell sweep: tcp://127.0.0.1:1: the scheduler of the cluster cannot")
