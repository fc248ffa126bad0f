"""The sizes of jobs, if the specification gives no size of chunks."""

import math

import numpy as np
import pytest
import sweep_workers
from sweep_kills import tree

from jaxcell.sweep import Spec, open_sweep, run_sweep
from jaxcell.sweep.workers import work


@pytest.fixture
def spec(spec_file):
    """A sweep of the stub in 1,250 chunks of two members, of which the last has one."""
    return Spec.load(spec_file("[grid]\ny = [0.5]\nx = {count = 2499}"))


@pytest.fixture
def large(monkeypatch):
    """Jobs may be larger by the greatest factor, however long they take."""
    monkeypatch.setattr(work, "JOB_SECONDS", math.inf)


@pytest.fixture
def small(spec, tmp_path, monkeypatch):
    """The files of the sweep, computed by jobs of one chunk."""
    with monkeypatch.context() as patch:
        patch.setattr(work, "JOB_SECONDS", 0.0)
        run_sweep(spec, tmp_path / "small")
    return tree(tmp_path / "small")


@pytest.fixture(autouse=True)
def new_process(monkeypatch):
    """This process has computed no task yet."""
    monkeypatch.setattr(work, "_grown", {})


@pytest.mark.usefixtures("large")
def test_jobs_grow_after_the_first_ones(spec, tmp_path, task):
    assert run_sweep(spec, tmp_path / "out").complete
    sizes = [len(batch["x"]) for batch in task[0]]
    # The first job may compile; then the rest is in equal parts of at most 100 chunks.
    assert sizes[:3] == [2, 2, 192]
    assert sum(sizes[:4]) < 2499
    # Repeated members fill the last job, and jobs of equal sizes leave no more than a few.
    assert sum(sizes) < 2499 + 2 * len(sizes)
    assert len(sizes) <= 2 + 13


@pytest.mark.usefixtures("large")
def test_the_result_does_not_depend_on_the_sizes_of_jobs(spec, tmp_path, small):
    assert run_sweep(spec, tmp_path / "out").complete
    assert tree(tmp_path / "out") == small


@pytest.mark.usefixtures("large")
def test_processes_choose_sizes_themselves(spec, tmp_path, small, monkeypatch):
    monkeypatch.setattr("jaxcell.sweep.workers.process.subprocess", sweep_workers.FORKED)
    with sweep_workers.server():
        assert run_sweep(spec, tmp_path / "out", engine="processes", workers=2).complete
    assert tree(tmp_path / "out") == small


def test_a_sweep_is_resumed_with_other_sizes(spec, tmp_path, small, monkeypatch, task):
    def stop(progress):
        if progress.done > 100:
            raise KeyboardInterrupt

    monkeypatch.setattr(work, "JOB_SECONDS", math.inf)
    with pytest.raises(KeyboardInterrupt):
        run_sweep(spec, tmp_path / "out", progress=stop)
    task[0].clear()
    monkeypatch.setattr(work, "JOB_SECONDS", 0.0)
    assert run_sweep(spec, tmp_path / "out", resume=True).complete
    assert {len(batch["x"]) for batch in task[0]} == {2}
    assert tree(tmp_path / "out") == small


@pytest.mark.usefixtures("large")
def test_a_member_of_a_large_job_fails_alone(spec, tmp_path, task):
    _, bad = task
    bad |= {700, 701, 2498}
    status = run_sweep(spec, tmp_path / "out")
    assert [one.parameters["x"] for one in status.failures] == [700, 701, 2498]
    assert status.done == status.chunks - 2
    with open_sweep(tmp_path / "out") as dataset:
        failed = np.isin(dataset.x, [*bad])
        assert (dataset.status.values[0] == np.where(failed, 2, 1)).all()
        assert (np.isnan(dataset.value.values[0]) == failed).all()
    bad.clear()
    assert run_sweep(spec, tmp_path / "out", resume=True).complete


def test_a_job_leaves_room_in_memory(spec, monkeypatch):
    monkeypatch.setattr(work, "JOB_SECONDS", math.inf)
    monkeypatch.setattr(work, "free", lambda: 4000)
    # The first call grows by the modules that it imports, and the first one of four by 20 bytes.
    peaks = iter([0, 5000, 5000, 5020, 5020])
    monkeypatch.setattr(work, "_peak", lambda: next(peaks))
    two, four = (work.Job.of(spec, [spec.chunk(0)], count, True) for count in (1, 2))
    # A job may grow by a quarter of the bytes that are free.
    assert [work.compute(job).room for job in (two, two, four, four)] == [1, 100, 1, 50]


STUDY = """
import dataclasses
from typing import ClassVar

import numpy as np

from jaxcell.base.quantities import quantity
from jaxcell.study import Study


@dataclasses.dataclass(frozen=True, kw_only=True)
class Root(Study):
    '''Find a root.'''

    varied: ClassVar[tuple[str, ...]] = ("x",)

    x: float
    '''A number.'''

    def numbers(self, columns, wanted):
        if (columns["x"] < 0).any():
            raise RuntimeError("the certificate of a member fails")
        return {"root": (quantity("", "root of the number", "m"), np.sqrt(columns["x"]))}
"""


@pytest.mark.usefixtures("large")
def test_a_member_without_certificate_is_found_in_its_batch(tmp_path):
    (tmp_path / "root.py").write_text(STUDY)
    path = tmp_path / "spec.toml"
    path.write_text(
        f'task = "{tmp_path}/root.py:Root"\n[grid]\nx = {{start = -1, stop = 999, step = 1}}'
    )
    status = run_sweep(Spec.load(path), tmp_path / "out")
    (failure,) = status.failures
    assert failure.parameters == {"x": -1}
    assert failure.message == "RuntimeError: the certificate of a member fails"
    with open_sweep(tmp_path / "out") as dataset:
        np.testing.assert_array_equal(dataset.root.values[1:], np.sqrt(np.arange(999)))
        assert np.isnan(dataset.root.values[0])


def test_bytes_of_derivatives_do_not_depend_on_chunks_and_resumption(tmp_path):
    text = """
    task = "cover"
    results = ["distance", "goal_time", "d_distance_d_reliability", "d_goal_time_d_reliability"]
    {chunk}
    [fixed]
    map = "@lab_a"
    directions = 8
    errors_turn = 45
    goal = "7.5,3.5"
    [grid]
    bounce = [45, 90]
    reliability = [0.3, 0.5, 0.7, 0.9, 1.0]
    """
    found = {}
    for chunk in ("", "chunk = 1", "chunk = 7", "chunk = 3"):
        (tmp_path / "spec.toml").write_text(text.format(chunk=chunk))
        spec, out = Spec.load(tmp_path / "spec.toml"), tmp_path / f"out{len(found)}"
        if chunk == "chunk = 3":
            run_sweep(spec, out, chunks=[1])
        run_sweep(spec, out, resume=True)
        with open_sweep(out) as dataset:
            found[chunk] = {name: dataset[name].values.tobytes() for name in spec.results}
    assert all(one == found[""] for one in found.values())
