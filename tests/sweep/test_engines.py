import os
import re
import subprocess
import sys
import types
from pathlib import Path

import dask
import numpy as np
import pytest
import sweep_kills
import sweep_workers
from distributed import LocalCluster
from helpers import run
from sweep_kills import kill_apart, tree
from waiting import is_running, wait_until

from jaxcell.sweep import engine_named, open_sweep, run_sweep, scheduler_address, sweep_status
from jaxcell.sweep.workers.engines import worker_environment
from jaxcell.sweep.workers.work import Computed, Failed, Job


TESTS = Path(sweep_kills.__file__).parent
ONE_WORKER = {
    **{"n_workers": 1, "threads_per_worker": 1, "processes": False},
    **{"protocol": "tcp://", "dashboard_address": ":0"},
}
LOCAL_QUEUE = 'LocalCluster(cores=1, memory="1GB", interface="lo")'


@pytest.fixture(scope="module")
def server():
    """The process from which workers are forked."""
    with sweep_workers.server():
        yield


@pytest.fixture
def forked(server, monkeypatch):
    """Workers that start in milliseconds."""
    monkeypatch.setattr("jaxcell.sweep.workers.process.subprocess", sweep_workers.FORKED)


@pytest.fixture(scope="module")
def cluster(server):
    """The address of a cluster that another program started."""
    settings = {
        "distributed.worker.multiprocessing-method": "forkserver",
        "distributed.worker.preload": ["sweep_workers"],
        "distributed.worker.daemon": False,
        "distributed.worker.profile.enabled": False,
        # We try again what was on a worker that died, in halves.
        "distributed.scheduler.allowed-failures": 0,
    }
    with dask.config.set(settings):
        found = LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        )
    with found:
        yield found.scheduler_address.replace("tcp://", "dask://")


def jobs_of(count, task="sweep_stub:stub", **fixed):
    """Gives jobs of one member each, and a list of the numbers of those that were taken."""
    taken = []

    def take():
        number = len(taken)
        if number == count:
            return None
        taken.append(number)
        return Job(
            np.array([number]), np.arange(1), task, {"x": np.array([number])}, fixed, 0, True
        )

    return take, taken


@pytest.mark.usefixtures("forked")
def test_the_engine_processes_gives_the_same_bytes(stub_spec, tmp_path, whole):
    spec, out = stub_spec(name="whole.toml"), tmp_path / "out"
    before = dict(os.environ)
    assert run_sweep(spec, out, engine="processes", workers=2).complete
    assert tree(out) == whole
    assert dict(os.environ) == before


@pytest.mark.usefixtures("forked")
def test_a_worker_that_dies_is_replaced(stub_spec, tmp_path, calls):
    # Chunks 1 and 4 have it; the first of them to come kills its worker, once.
    spec = stub_spec(f'kill = 5\nonce = "{tmp_path / "once"}"\nfolder = "{calls}"')
    status = run_sweep(spec, tmp_path / "out", engine="processes", workers=1)
    assert status.complete
    assert (tmp_path / "once").exists()
    processes = {int(path.name.partition("-")[0]) for path in calls.iterdir()}
    assert len(processes) >= 2
    assert not any(is_running(process) for process in processes)


@pytest.mark.usefixtures("forked")
def test_a_job_that_kills_its_workers_takes_no_other_with_it(tmp_path):
    take, _ = jobs_of(3, kill=1, folder=str(tmp_path))
    outcomes = {job.numbers[0]: outcome for job, outcome in engine_named("processes", 1)(take)}
    assert outcomes[1] == Failed("its worker died each of 3 times: out of memory?")
    assert all(isinstance(outcomes[number], Computed) for number in (0, 2))
    calls = [path.name.split("-") for path in tmp_path.iterdir()]
    # The others lost none, though one of them waited beside it.
    assert sorted(numbers for *_, numbers in calls) == ["0", "1", "1", "1", "2"]
    assert len({process for process, _, numbers in calls if numbers == "1"}) == 3


@pytest.mark.usefixtures("forked")
def test_a_job_that_hangs_takes_no_other_with_it():
    take, _ = jobs_of(3, hang=1)
    outcomes = {job.numbers[0]: outcome for job, outcome in engine_named("processes", 1, 5.0)(take)}
    assert outcomes[1] == Failed("TimeoutError: it was not done after 5 s")
    assert all(isinstance(outcomes[number], Computed) for number in (0, 2))


@pytest.mark.usefixtures("forked")
def test_the_processes_of_a_job_end_with_its_worker(tmp_path):
    take, _ = jobs_of(1, hang=0, starts=str(tmp_path / "number"))
    ((_, outcome),) = engine_named("processes", 1, 5.0)(take)
    assert isinstance(outcome, Failed)
    started = int((tmp_path / "number").read_text())
    wait_until(lambda: not is_running(started))


def test_a_worker_that_never_says_a_word_counts_as_dead(monkeypatch):
    silent = [sys.executable, "-c", "import signal; signal.pause()"]
    stand_in = types.SimpleNamespace(
        Popen=lambda _, **options: subprocess.Popen(silent, start_new_session=True), DEVNULL=None
    )
    monkeypatch.setattr("jaxcell.sweep.workers.process.subprocess", stand_in)
    monkeypatch.setattr("jaxcell.sweep.workers.process.START_SECONDS", 0.01)
    take, _ = jobs_of(1)
    ((_, outcome),) = engine_named("processes", 1)(take)
    assert outcome == Failed("its worker died each of 3 times: out of memory?")


def test_a_sweep_says_that_its_cluster_has_no_workers(stub_spec, tmp_path):
    spec, out = stub_spec(text="[grid]\nx = {count = 4}"), tmp_path / "out"
    waits = []
    with LocalCluster(**{**ONE_WORKER, "n_workers": 0}) as cluster:

        def look(progress):
            if progress.waiting and not waits:
                cluster.scale(1)
            if progress.waiting != (waits[-1:] or [""])[0]:
                waits.append(progress.waiting)
                assert sweep_status(out).waiting == progress.waiting

        address = cluster.scheduler_address.replace("tcp://", "dask://")
        assert run_sweep(spec, out, engine=address, progress=look).complete
    assert waits[0].startswith("a worker: the cluster has none;")
    assert waits[1:] == [""]


def test_workers_of_a_cluster_come_and_go(monkeypatch, tmp_path):
    # Jobs that are over in no time leave none for a look each second.
    monkeypatch.setattr("jaxcell.sweep.workers.engines.LOOK_SECONDS", 0.01)
    with LocalCluster(**ONE_WORKER) as cluster:
        address = cluster.scheduler_address.replace("tcp://", "dask://")
        take, taken = jobs_of(60, task="sweep_stub:who", seconds=0.02)
        ahead, names = [], []
        for i, (_, outcome) in enumerate(engine_named(address)(take)):
            names.append(int(outcome.variables["name"].values[0]))
            ahead.append(len(taken) - i)
            if i in (5, 30):
                cluster.scale(6 if i == 5 else 2)
                cluster.sync(cluster._correct_state)
    assert len(names) == 60
    # Two jobs for each worker.
    assert max(ahead[:5]) == 2
    assert max(ahead[7:30]) == 12
    assert max(ahead[45:]) <= 4
    assert set(names[:5]) == {names[0]}
    assert len(set(names)) >= 4


def test_a_cluster_by_the_file_of_its_scheduler(spec_file, tmp_path, capsys):
    file, spec = tmp_path / "scheduler.json", str(spec_file(text="[grid]\nx = {count = 4}"))
    with LocalCluster(**ONE_WORKER, scheduler_kwargs={"scheduler_file": str(file)}) as cluster:
        assert scheduler_address(file) == cluster.scheduler_address
        words = "sweep", spec, "--out", tmp_path / "out", "--scheduler-file", file
        assert run(capsys, *words)[1]["done"] == 4
        status, _, error = run(capsys, *words, "--engine dask")
        assert status == 2
        assert "--scheduler-file: it has an effect only with --engine local" in error


@pytest.mark.parametrize("text", ["", "{}", "[]", '"tcp://a:1"', "[" * 100_000])
def test_other_files_are_refused_as_files_of_a_scheduler(tmp_path, text):
    (tmp_path / "scheduler.json").write_text(text)
    with pytest.raises(ValueError, match=r"scheduler\.json: expected the file that a scheduler"):
        scheduler_address(tmp_path / "scheduler.json")


def test_the_script_of_the_documentation_for_a_queue_runs(spec_file, tmp_path):
    """The script of the documentation on this machine in place of a queue, from no worker on."""
    page = (TESTS.parent / "docs/pages/how_to/sweep.md").read_text()
    script = re.search(r'title="slurm.py"\n(.*?)```', page, re.DOTALL)[1]
    for there, here in (
        ("dask_jobqueue import SLURMCluster", "dask_jobqueue.local import LocalCluster"),
        ('SLURMCluster(cores=1, memory="4GB", walltime="01:00:00")', LOCAL_QUEUE),
        ("maximum=100", "maximum=2"),
    ):
        assert script.count(there) == 1
        script = script.replace(there, here)
    (tmp_path / "slurm.py").write_text(script)
    spec_file("[grid]\nx = {count = 6}", "angles.toml", head="chunk = 1", fixed="seconds = 0.2")
    environment = {**os.environ, "PYTHONPATH": f"{TESTS}:{TESTS.parent}"}
    subprocess.run([sys.executable, "slurm.py"], cwd=tmp_path, env=environment, check=True)
    assert sweep_status(tmp_path / "runs" / "angles").complete


def test_wrong_timeouts_are_refused():
    with pytest.raises(ValueError, match=r"the engine local .* cannot end a chunk"):
        engine_named("local", timeout=3.0)
    for timeout in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="timeout: expected more than 0 s, got"):
            engine_named("processes", timeout=timeout)


@pytest.mark.usefixtures("forked")
def test_workers_end_with_the_run(stub_spec, tmp_path, calls):
    spec = stub_spec(f'seconds = 0.05\nfolder = "{calls}"', text="[grid]\nx = {count = 400}")

    def stop(progress):
        if progress.done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sweep(spec, tmp_path / "out", engine="processes", workers=1, progress=stop)
    count = len(list(calls.iterdir()))
    assert 0 < count < 100
    assert not any(is_running(int(path.name.partition("-")[0])) for path in calls.iterdir())


@pytest.mark.usefixtures("forked")
def test_few_jobs_are_submitted_at_a_time():
    take, taken = jobs_of(100)
    outcomes = engine_named("processes", 1)(take)
    first = next(outcomes)
    assert isinstance(first[1], Computed)
    assert len(taken) <= 4
    outcomes.close()


def test_workers_get_their_share_of_the_processors(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(8)))
    for name in ("PJRT_NPROC", "OMP_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MKL_NUM_THREADS", "7")
    found = worker_environment(3)
    assert (found["PJRT_NPROC"], found["OMP_NUM_THREADS"]) == ("2", "2")
    assert found["MKL_NUM_THREADS"] == "7"
    assert worker_environment(100)["PJRT_NPROC"] == "1"


@pytest.mark.parametrize(
    ("name", "workers", "message"),
    [
        ("ray", None, "engine: expected local, processes, dask or dask://host:port, got 'ray'"),
        ("dask://host", None, "got 'dask://host'"),
        ("dask://host:x", None, "got 'dask://host:x'"),
        ("local", 2, "workers: the engine local takes none, got 2"),
        ("dask://host:1", 2, "takes none"),
        ("processes", 0, "workers: expected at least 1, got 0"),
    ],
)
def test_unknown_engines_are_refused(name, workers, message):
    with pytest.raises(ValueError, match=message):
        engine_named(name, workers)


def test_dask_is_an_extra(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"the extra `cluster`.*jaxcell\[cluster\]"):
        engine_named("dask")


@pytest.mark.parametrize(("engine", "kills"), [("processes", 2), ("dask", 1)])
def test_killed_sweeps_of_workers_are_resumed(stub_spec, tmp_path, engine, kills):
    spec = stub_spec("seconds = 0.01")
    (counts,) = kill_apart(
        {"file": str(spec.path), "base": str(tmp_path), "kills": kills, "engine": engine}
    )
    assert counts["kills"] >= kills


def test_workers_of_a_killed_run_end(stub_spec, tmp_path, calls):
    number = tmp_path / "number"
    text = f'seconds = 0.05\nfolder = "{calls}"\nstarts = "{number}"'
    spec = stub_spec(text, text="[grid]\nx = {count = 8000}")
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
    try:
        wait_until(lambda: any(calls.iterdir()))
    finally:
        process.kill()
        process.wait()
    workers = {int(path.name.partition("-")[0]) for path in calls.iterdir()}
    workers.add(int(number.read_text()))
    wait_until(lambda: not any(map(is_running, workers)))
    assert sweep_status(tmp_path / "out").running is None


def test_a_member_that_hangs_on_dask_is_ended_alone(cluster, stub_spec, tmp_path, calls):
    spec = stub_spec(f'hang = 1\nfolder = "{calls}"', text="[grid]\nx = {count = 2}")
    status = run_sweep(spec, tmp_path / "out", engine=cluster, timeout=2.0)
    assert [one.parameters for one in status.failures] == [{"x": 1}]
    assert status.failures[0].message == "TimeoutError: it was not done after 2 s"
    with open_sweep(tmp_path / "out") as dataset:
        assert dataset.status.values.tolist() == [1, 2]
    assert not any(is_running(int(path.name.partition("-")[0])) for path in calls.iterdir())


def test_dask_gives_the_same_bytes(cluster, stub_spec, tmp_path, whole):
    out = tmp_path / "out"
    assert run_sweep(stub_spec(name="whole.toml"), out, engine=cluster).complete
    assert tree(out) == whole


def test_jobs_of_a_dask_worker_that_dies_are_tried_again(cluster, stub_spec, tmp_path):
    spec = stub_spec(f'kill = 5\nonce = "{tmp_path / "once"}"')
    assert run_sweep(spec, tmp_path / "out", engine=cluster).complete
    assert (tmp_path / "once").exists()
    always = stub_spec("kill = 1", text="[grid]\nx = [1]", name="always.toml")
    status = run_sweep(always, tmp_path / "always", engine=cluster)
    assert status.done == 0
    assert [one.parameters["x"] for one in status.failures] == [1]
    assert status.failures[0].message.startswith("KilledWorker: ")
