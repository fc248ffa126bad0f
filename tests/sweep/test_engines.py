import json
import os
import subprocess
import sys
import time
from pathlib import Path

import dask
import numpy as np
import pytest
import sweep_kills
from distributed import LocalCluster
from sweep_kills import tree

from jaxcell.sweep import engine_named, run_sweep, sweep_status
from jaxcell.sweep.engines import worker_environment
from jaxcell.sweep.work import Computed, Job


pytestmark = pytest.mark.slow


TESTS = Path(sweep_kills.__file__).parent


@pytest.fixture(scope="module")
def cluster():
    """The address of a cluster that was started by somebody else."""
    with (
        # Dask tries again what was on a worker that died, but not for ever.
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as found,
    ):
        yield found.scheduler_address.replace("tcp://", "dask://")


def test_processes_give_the_same_and_leave_nobody(stub_spec, tmp_path, whole):
    spec, out = stub_spec(name="whole.toml"), tmp_path / "out"
    before = dict(os.environ)
    assert run_sweep(spec, out, engine="processes", workers=2).complete
    assert tree(out) == whole
    assert dict(os.environ) == before


def test_a_worker_that_dies_is_replaced(stub_spec, tmp_path):
    calls = tmp_path / "calls"
    calls.mkdir()
    # Chunks 1 and 4 have it; the first of them to come kills its worker, once.
    spec = stub_spec(f'kill = 5\nonce = "{tmp_path / "once"}"\nfolder = "{calls}"')
    found = run_sweep(spec, tmp_path / "out", engine="processes", workers=1)
    assert found.complete
    assert (tmp_path / "once").exists()
    processes = {int(path.name.partition("-")[0]) for path in calls.iterdir()}
    assert len(processes) >= 2
    assert not any(alive(process) for process in processes)


def test_a_chunk_that_kills_its_workers_fails_alone(stub_spec, tmp_path):
    spec = stub_spec("kill = 5", text="[grid]\nx = {count = 12}")
    found = run_sweep(spec, tmp_path / "out", engine="processes", workers=1)
    assert found.done == 2
    assert [one.chunk for one in found.failures] == [1]
    assert found.failures[0].message == "its worker died each of 3 times: out of memory?"


def test_workers_end_with_the_run(stub_spec, tmp_path):
    calls = tmp_path / "calls"
    calls.mkdir()
    spec = stub_spec(f'seconds = 0.05\nfolder = "{calls}"', text="[grid]\nx = {count = 400}")

    class StopError(Exception):
        pass

    def stop(progress):
        if progress.done == 1:
            raise StopError

    with pytest.raises(StopError):
        run_sweep(spec, tmp_path / "out", engine="processes", workers=1, progress=stop)
    count = len(list(calls.iterdir()))
    assert 0 < count < 100
    assert not any(alive(int(path.name.partition("-")[0])) for path in calls.iterdir())


def test_dask_gives_the_same(cluster, stub_spec, tmp_path, whole):
    out = tmp_path / "out"
    assert run_sweep(stub_spec(name="whole.toml"), out, engine=cluster).complete
    assert tree(out) == whole


def test_a_dask_worker_that_dies_mid_run(cluster, stub_spec, tmp_path):
    spec = stub_spec(f'kill = 5\nonce = "{tmp_path / "once"}"')
    assert run_sweep(spec, tmp_path / "out", engine=cluster).complete
    assert (tmp_path / "once").exists()
    always = stub_spec("kill = 5", text="[grid]\nx = {count = 12}", name="always.toml")
    found = run_sweep(always, tmp_path / "always", engine=cluster)
    # Its neighbour may have been on the worker both times, as Dask counts.
    failed = [one.chunk for one in found.failures]
    assert 1 in failed
    assert found.done == 3 - len(failed)
    assert found.failures[0].message.startswith("KilledWorker: ")


def test_few_jobs_are_on_their_way():
    taken = []

    def jobs():
        for number in range(100):
            taken.append(number)
            yield Job(number, "sweep_stub:stub", {"x": np.array([number])}, {}, 0, True)

    outcomes = engine_named("processes", 1)(jobs())
    first = next(outcomes)
    assert isinstance(first[1], Computed)
    assert len(taken) <= 4
    outcomes.close()


def test_workers_are_told_their_share(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(8)))
    for name in ("PJRT_NPROC", "OMP_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MKL_NUM_THREADS", "7")
    found = worker_environment(3)
    assert (found["PJRT_NPROC"], found["OMP_NUM_THREADS"]) == ("2", "2")
    assert found["MKL_NUM_THREADS"] == "7"
    assert worker_environment(100)["PJRT_NPROC"] == "1"


@pytest.mark.parametrize(
    ("name", "workers", "told"),
    [
        ("ray", None, "engine: expected local, processes, dask or dask://host:port, got 'ray'"),
        ("dask://host", None, "got 'dask://host'"),
        ("dask://host:x", None, "got 'dask://host:x'"),
        ("local", 2, "workers: the engine local is not told how many, got 2"),
        ("dask://host:1", 2, "is not told how many"),
        ("processes", 0, "workers: expected at least 1, got 0"),
    ],
)
def test_engines_that_are_none(name, workers, told):
    with pytest.raises(ValueError, match=told):
        engine_named(name, workers)


def test_dask_is_an_extra(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"the extra `cluster`.*jaxcell\[cluster\]"):
        engine_named("dask")


@pytest.mark.parametrize(("engine", "kills"), [("local", 20), ("processes", 2), ("dask", 1)])
def test_sweeps_that_are_killed_and_gone_on_with(stub_spec, tmp_path, engine, kills):
    spec = stub_spec("seconds = 0.01")
    found = subprocess.run(
        [sys.executable, TESTS / "sweep_kills.py", spec.path, tmp_path, engine, str(kills), "1"],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert found.returncode == 0, found.stderr
    told = json.loads(found.stdout)
    assert told["kills"] >= kills
    assert told["rounds"] >= 1
    # Some were in the middle of it.
    assert engine == "dask" or told["partial"] > 0


def test_a_killed_run_leaves_its_workers_to_die(stub_spec, tmp_path):
    calls = tmp_path / "calls"
    calls.mkdir()
    spec = stub_spec(f'seconds = 0.05\nfolder = "{calls}"', text="[grid]\nx = {count = 8000}")
    program = (
        "import sys; from jaxcell.sweep import *\n"
        "if __name__ == '__main__':\n"
        "    run_sweep(Spec.load(sys.argv[1]), sys.argv[2], engine='processes', workers=1)"
    )
    script = tmp_path / "script.py"
    script.write_text(program)
    environment = {**os.environ, "PYTHONPATH": str(TESTS)}
    process = subprocess.Popen(
        [sys.executable, script, spec.path, tmp_path / "out"], env=environment
    )
    workers = set()
    limit = time.monotonic() + 60
    while not workers and time.monotonic() < limit:
        workers = {int(path.name.partition("-")[0]) for path in calls.iterdir()}
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert workers
    limit = time.monotonic() + 20
    while any(map(alive, workers)) and time.monotonic() < limit:
        time.sleep(0.01)
    assert not any(map(alive, workers))
    assert sweep_status(tmp_path / "out").running is None


def alive(process: int) -> bool:
    try:
        # One that nobody waited for is there, but does not run.
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
