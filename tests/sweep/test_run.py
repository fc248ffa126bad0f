import contextlib
import dataclasses
import errno
import json
import os
import random
import resource
import socket

import numpy as np
import pytest
import sweep_stub
import xarray as xr
from sweep_kills import kill_apart, tree

from jaxcell.sweep import Spec, open_sweep, run_sweep, sweep_status, verify_sweep
from jaxcell.sweep.storage.export import write_result
from jaxcell.sweep.storage.lock import locked
from jaxcell.sweep.storage.store import SweepStore
from jaxcell.sweep.workers.work import compute


def test_the_result_of_a_member_is_that_of_a_batch_of_one(stub_spec, tmp_path):
    text = "[grid]\ny = [0.5, 1.5, 2.5]\n[random]\nsamples = 11\nx = {integers = [0, 99]}"
    spec = stub_spec(text=text)
    assert 11 % spec.lengths["sample"] != 0
    status = run_sweep(spec, tmp_path / "out")
    assert status.complete
    assert (status.members, status.chunks, status.done) == (33, 9, 9)
    with open_sweep(tmp_path / "out") as dataset:
        assert dict(dataset.sizes) == {"y": 3, "sample": 11, "exponent": 3}
        assert set(dataset.coords) == {"y", "sample", "x", "exponent"}
        assert dataset.x.dims == ("sample",)
        assert dataset.value.attrs == {"units": "m", "long_name": "a value"}
        assert (dataset.status == 1).all()
        for i, y in enumerate(dataset.y.values):
            for j, x in enumerate(dataset.x.values):
                alone = sweep_stub.stub({"x": np.array([x]), "y": np.array([y])}, {}, 3)
                xr.testing.assert_identical(
                    dataset.drop_vars("status")
                    .isel(y=i, sample=j)
                    .load()
                    .drop_vars(["x", "y", "sample"])
                    .drop_attrs(deep=False),
                    alone.isel(member=0)[sorted(alone.data_vars)],
                )


def test_a_specification_with_wrong_results_may_be_corrected(tmp_path):
    path = tmp_path / "spec.toml"
    text = (
        'task = "groups"\nresults = ["wrong"]\n[fixed]\nmap = "@lab_a"\n[grid]\nbounce = [45, 90]'
    )
    path.write_text(text)
    with pytest.raises(ValueError, match="Groups has no number 'wrong'"):
        run_sweep(Spec.load(path), tmp_path / "out")
    path.write_text(text.replace("wrong", "count"))
    assert run_sweep(Spec.load(path), tmp_path / "out").complete


def test_strings_and_booleans_are_coordinates(stub_spec, tmp_path):
    text = '[grid]\nname = ["b.json", "é"]\non = [true, false]\n[list]\nx = [1, 2]\nw = ["p", "q"]'
    run_sweep(stub_spec(text=text), tmp_path / "out")
    with open_sweep(tmp_path / "out") as dataset:
        assert dataset.name.values.tolist() == ["b.json", "é"]
        assert dataset.on.values.tolist() == [True, False]
        assert dataset.w.values.tolist() == ["p", "q"]
        assert float(dataset.value.sel(name="é", on=True).sel(member=1)) == 7
        dataset.to_netcdf(tmp_path / "out.nc")
    with xr.open_dataset(tmp_path / "out.nc") as again, open_sweep(tmp_path / "out") as dataset:
        xr.testing.assert_equal(again, dataset)


def test_a_variable_may_have_a_dimension_of_nothing(stub_spec, tmp_path, monkeypatch):
    def stub(batch, fixed, seed):
        x = np.asarray(batch["x"])
        nothing = (("member", "k"), np.zeros((len(x), 0)))
        names = ("name", np.zeros(0, str))
        return xr.Dataset({"x2": ("member", x**2), "nothing": nothing}, {"k": [], "name": names})

    monkeypatch.setattr(sweep_stub, "stub", stub)
    spec, out = stub_spec(), tmp_path / "out"
    run_sweep(spec, out, chunks=[0])
    assert run_sweep(spec, out, resume=True).complete
    with open_sweep(out) as dataset:
        assert dict(dataset.sizes) == {"y": 2, "x": 10, "k": 0, "name": 0}
        assert (dataset.x2 == dataset.x**2).all()
    assert verify_sweep(out, mend=True).damaged == ()


def test_the_order_of_chunks_does_not_matter(stub_spec, tmp_path, whole, monkeypatch):
    def shuffled(take):
        jobs = list(iter(take, None))
        random.Random(1).shuffle(jobs)
        numbers = [job.numbers[0] for job in jobs]
        assert numbers != sorted(numbers)
        for job in jobs:
            yield job, compute(job)

    monkeypatch.setattr("jaxcell.sweep.run.engine_named", lambda *_: shuffled)
    assert run_sweep(stub_spec(name="whole.toml"), tmp_path / "out").complete
    assert tree(tmp_path / "out") == whole


def test_all_chunks_are_one_call_of_one_length(stub_spec, tmp_path, task):
    run_sweep(stub_spec(), tmp_path / "out")
    assert [len(batch["x"]) for batch in task[0]] == [4] * 6


def test_a_member_that_fails_is_reported_and_does_not_stop_others(stub_spec, tmp_path, whole):
    spec, out = stub_spec("fail = 5"), tmp_path / "out"
    seen = []
    status = run_sweep(spec, out, progress=seen.append)
    assert not status.complete
    assert (status.done, status.chunks) == (4, 6)
    assert [one.chunk for one in status.failures] == [1, 4]
    first, second = status.failures
    assert first.index == {"y": 0, "x": 5}
    assert first.parameters == {"y": 0.5, "x": 5}
    assert second.parameters == {"y": 1.5, "x": 5}
    assert first.message == "RuntimeError: x is 5"
    assert "sweep_stub.py" in first.trace
    assert [failure for one in seen for failure in one.failures] == list(status.failures)
    assert [(one.done, one.failed) for one in seen] == [
        (0, 0), (1, 0), (2, 1), (3, 1), (4, 1), (5, 2), (6, 2)
    ]  # fmt: skip
    assert seen[-1].left == 0
    with open_sweep(out) as dataset, open_sweep(tmp_path / "whole") as good:
        missing = dataset.x == 5
        assert (dataset.status == xr.where(missing, 2, 1)).all()
        assert (dataset["count"].where(missing, drop=True) == -1).all()
        for name in ("value", "noise", "power"):
            assert dataset[name].identical(good[name].where(~missing)), name

    listed = json.loads((out / "failures.json").read_text())
    assert listed == [dataclasses.asdict(one) for one in status.failures]


@pytest.mark.parametrize("bad", [8, 9])
def test_a_member_of_a_padded_chunk_fails_alone(stub_spec, tmp_path, bad):
    spec = stub_spec(f"fail = {bad}")
    assert spec.chunk(2).shape != tuple(spec.lengths.values())
    status = run_sweep(spec, tmp_path / "out")
    assert [one.index for one in status.failures] == [{"y": 0, "x": bad}, {"y": 1, "x": bad}]
    with open_sweep(tmp_path / "out") as dataset:
        assert (dataset.status == xr.where(dataset.x == bad, 2, 1)).all()
        assert (dataset["count"] == xr.where(dataset.x == bad, -1, dataset.x)).all()


def test_a_sweep_whose_chunks_all_fail_has_no_result(stub_spec, tmp_path):
    out = tmp_path / "out"
    status = run_sweep(stub_spec("fail = 5", text="[list]\nx = [5, 5]"), out)
    assert (status.done, [one.index["member"] for one in status.failures]) == (0, [0, 1])
    with pytest.raises(ValueError, match="no chunk is done yet, of 1"):
        open_sweep(out)


def test_chunks_that_failed_whole_before_the_first_result_are_in_it(stub_spec, tmp_path):
    spec = stub_spec("fail = 1", text="[list]\nx = [1, 1, 1, 1, 1, 2]")
    status = run_sweep(spec, tmp_path / "out")
    assert (status.done, len(status.failures)) == (0, 5)
    with open_sweep(tmp_path / "out") as dataset:
        assert dataset.status.values.tolist() == [2] * 5 + [1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda found: found.drop_vars("noise"), "the task gave count, even, exponent, power"),
        (lambda found: found.assign(more=found.value), "the chunk that was done first has count"),
        (lambda found: found.assign(value=found.value.astype("f4")),
         "'value' with the kind float32"),
        (lambda found: found.isel(exponent=[0, 1]), "'power' with the shape"),
        (lambda found: found.assign_coords(exponent=[0, 1, 4]), "a coordinate 'exponent' with"),
        (lambda found: found.assign(value=found.value.assign_attrs(units="s")), "attributes"),
        (lambda found: found.rename(exponent="other"), "exponent"),
        (lambda found: found.isel(member=[0, 0, 0]), "the task gave 3 members; expected 1"),
        (lambda found: found.transpose("exponent", "member"), "expected member as the first"),
        (lambda found: found.assign(status=found.value), "'status'"),
        (lambda found: found.rename(exponent="y"), "'power' of dimensions"),
        (lambda found: found.assign({"a/b": found.value}), "'a/b'"),
        (lambda found: found.assign(value=found.value.astype(str)), "expected numbers or booleans"),
        (lambda found: found.assign(value=found.value.astype("g")), "expected numbers or booleans"),
        (lambda found: found.assign(value=found.value.assign_attrs(a={1j})), "attributes of text"),
        (lambda found: 3, "gave int; expected an xarray.Dataset"),
    ],
)  # fmt: skip
def test_chunks_with_other_variables_than_the_first_fail(
    stub_spec, tmp_path, monkeypatch, change, message
):
    kept = sweep_stub.stub

    def changed(batch, fixed, seed):
        result = kept(batch, fixed, seed)
        return change(result) if 5 in batch["x"] else result

    monkeypatch.setattr(sweep_stub, "stub", changed)
    status = run_sweep(stub_spec(), tmp_path / "out")
    assert [one.index["x"] for one in status.failures] == [5, 5]
    assert message in status.failures[0].message


def test_a_resume_needs_the_same_specification_and_versions(
    stub_spec, spec_file, tmp_path, monkeypatch
):
    spec, out = stub_spec(), tmp_path / "out"
    run_sweep(spec, out, resume=True)
    before = tree(out)
    with pytest.raises(FileExistsError, match="a sweep is there; continue it"):
        run_sweep(spec, out)
    other = Spec.load(spec_file(head="chunk = 5", name="other.toml"))
    with pytest.raises(ValueError, match=r"other.toml: not the .*: chunk: 4 there, 5 here"):
        run_sweep(other, out, resume=True)
    with monkeypatch.context() as patch:
        patch.setattr("jaxcell.sweep.storage.digests.__version__", "9.9")
        with pytest.raises(ValueError, match=r"jaxcell_version: \S+ there, 9\.9 here"):
            run_sweep(spec, out, resume=True)
    with monkeypatch.context() as patch:
        patch.setattr("jaxcell.sweep.run.jax_is_wide", lambda: False)
        with pytest.raises(ValueError, match="jax_enable_x64: 1 there, 0 here"):
            run_sweep(spec, out, resume=True)
    assert run_sweep(spec, out, resume=True).complete
    assert tree(out) == before


def test_a_second_run_at_once_is_refused(stub_spec, tmp_path):
    spec, out = stub_spec(), tmp_path / "out"
    seen = []

    def meddle(progress):
        if progress.done == 2:
            seen.append(sweep_status(out))
            with pytest.raises(BlockingIOError, match=rf"out: process {os.getpid()} on \S+ writes"):
                run_sweep(spec, out, resume=True)

    assert run_sweep(spec, out, progress=meddle).running is None
    assert seen[0].done == 2
    assert seen[0].running.startswith(f"process {os.getpid()} ")
    with locked(out / "lock"), pytest.raises(BlockingIOError):
        run_sweep(spec, out, resume=True)


@contextlib.contextmanager
def files_limited():
    """Give a function after which the system refuses to write more than some bytes to a file."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_full_disk_ends_a_run_that_can_be_resumed(stub_spec, tmp_path, whole):
    spec, out = stub_spec(name="whole.toml"), tmp_path / "out"

    def fill(progress):
        if progress.done == 3:
            limit((out / "sweep.journal").stat().st_size + 50)

    message = "File too large; chunks that ended are kept"
    with files_limited() as limit, pytest.raises(OSError, match=message) as caught:
        run_sweep(spec, out, progress=fill)
    assert caught.value.errno == errno.EFBIG
    assert str(caught.value.filename) == str(out)
    status = sweep_status(out)
    assert (status.done, status.failures, status.running) == (3, (), None)
    assert run_sweep(spec, out, resume=True).complete
    assert tree(out) == whole


def test_a_disk_that_is_full_when_the_result_is_made(stub_spec, tmp_path, whole):
    spec, out = stub_spec(name="whole.toml"), tmp_path / "out"

    def fill(progress):
        if progress.done == 6:
            limit(100)

    with files_limited() as limit, pytest.raises(OSError, match="chunks that ended are kept"):
        run_sweep(spec, out, progress=fill)
    assert sweep_status(out).complete
    assert not (out / "sweep.zarr").exists()
    with open_sweep(out) as dataset, open_sweep(tmp_path / "whole") as expected:
        xr.testing.assert_identical(dataset.load(), expected.load())
    assert run_sweep(spec, out, resume=True).complete
    assert tree(out) == whole


def test_unfinished_files_are_removed_and_an_interrupted_sweep_can_be_read(
    stub_spec, tmp_path, whole
):
    spec, out = stub_spec(name="whole.toml"), tmp_path / "out"

    def stop(progress):
        if progress.done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sweep(spec, out, progress=stop)
    with open_sweep(out) as dataset:
        assert dataset.status.values.tolist() == [[1] * 8 + [0] * 2, [0] * 10]
        assert dataset["count"].values.tolist() == [[*range(8), -1, -1], [-1] * 10]
        assert np.isnan(dataset.value.values[dataset.status.values == 0]).all()
    (out / ".sweep-01234567.zarr").mkdir()
    (out / ".spec-01234567.toml").touch()
    assert run_sweep(spec, out, resume=True).complete
    assert tree(out) == whole
    names = ["lock", "spec.toml", "sweep.journal", "sweep.zarr"]
    assert sorted(path.name for path in out.iterdir()) == names


def test_runs_that_are_killed_at_any_moment(stub_spec, tmp_path):
    sweep = {"file": str(stub_spec().path), "base": str(tmp_path), "kills": 20}
    (counts,) = kill_apart(sweep)
    assert counts["kills"] >= 20
    assert counts["partial"] > 0


def test_a_result_is_written_by_files_of_a_given_size(stub_spec, tmp_path):
    """So only one file of each variable is in memory."""
    run_sweep(stub_spec("fail = 3"), tmp_path / "out")
    with SweepStore(tmp_path / "out") as store:
        write_result(store, tmp_path / "small.zarr", file_bytes=1)
    files = [
        path for path in (tmp_path / "small.zarr" / "value" / "c").rglob("*") if path.is_file()
    ]
    assert len(files) == 6
    with open_sweep(tmp_path / "out") as dataset, xr.open_zarr(tmp_path / "small.zarr") as small:
        xr.testing.assert_identical(dataset.load(), small.load())


def test_the_result_has_its_provenance(stub_spec, tmp_path):
    run_sweep(stub_spec(), tmp_path / "out")
    with open_sweep(tmp_path / "out") as dataset:
        assert dataset.attrs["task"] == "sweep_stub:stub"
        assert dataset.attrs["seed"] == 3
        assert dataset.attrs["git_revision"] == "a revision"
        assert json.loads(dataset.attrs["spec"])["chunk"] == 4
        assert dataset.status.attrs["flag_meanings"] == "to_do done failed"


def test_unknown_tasks_are_refused(spec_file, tmp_path):
    for task, message in {
        "nothing": "expected one of .*groups.*got 'nothing'",
        "no_module:f": "No module named 'no_module'",
        "sweep_stub:none": "has no attribute 'none'",
        "sweep_stub:np": "expected a function, got module",
        ":f": "task: :f: ",
    }.items():
        path = spec_file()
        path.write_text(path.read_text().replace("sweep_stub:stub", task))
        with pytest.raises(ValueError, match=rf"spec\.toml: task: .*{message}|{message}"):
            run_sweep(Spec.load(path), tmp_path / "out")
        assert not (tmp_path / "out").exists()


def test_other_folders_are_refused_as_sweeps(tmp_path):
    for function in (sweep_status, open_sweep):
        with pytest.raises(ValueError, match="expected the folder of a sweep"):
            function(tmp_path)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('[fixed]\nmap = "m.json"\nangle = 3\n[grid]\nbounce = [1]', "angle: expected a parameter"),
        ("[grid]\nbounce = [1]", "map: Groups needs this parameter"),
        ('[fixed]\nmap = "m.json"\n[grid]\nbounce = ["west"]', "bounce: expected float, got str"),
    ],
)
def test_wrong_parameters_of_a_study_are_refused_before_it_runs(lines, message, tmp_path):
    (tmp_path / "spec.toml").write_text(f'task = "groups"\n{lines}\n')
    with pytest.raises(ValueError, match=f"spec.toml: {message}"):
        run_sweep(Spec.load(tmp_path / "spec.toml"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["broken", "missing"])
@pytest.mark.parametrize("table", ["grid", "list"])
def test_a_bad_map_among_good_ones_is_refused_once(kind, table, tmp_path):
    (tmp_path / "broken.json").write_text("{")
    bad = tmp_path / f"{kind}.json"
    (tmp_path / "spec.toml").write_text(
        f'task = "groups"\n[{table}]\nmap = ["@lab_a", "@lab_b", "{bad}"]\nbounce = [45, 90, 135]\n'
    )
    with pytest.raises(ValueError, match=rf"spec.toml: {bad}: ") as caught:
        run_sweep(Spec.load(tmp_path / "spec.toml"), tmp_path / "out")
    assert str(caught.value).count(str(bad)) == 1
    assert not (tmp_path / "out").exists()


def test_a_parameter_that_does_not_fit_a_later_map_fails_alone(tmp_path):
    (tmp_path / "spec.toml").write_text(
        'task = "groups"\n[list]\nmap = ["@lab_a", "@lab_b"]\npiece = ["all", "900,900"]\n'
        "bounce = [45, 45]\n"
    )
    (failure,) = run_sweep(Spec.load(tmp_path / "spec.toml"), tmp_path / "out").failures
    assert failure.of_parameters
    assert failure.message.startswith("ValueError: piece: ")


def test_a_task_may_raise_any_error_for_a_member(stub_spec, tmp_path, monkeypatch):
    kept = sweep_stub.stub

    def picky(batch, fixed, seed):
        if 3 in batch["x"]:
            raise ValueError("results: none at 3")
        return kept(batch, fixed, seed)

    monkeypatch.setattr(sweep_stub, "stub", picky)
    failures = run_sweep(stub_spec(), tmp_path / "out").failures
    assert [one.parameters["x"] for one in failures] == [3, 3]


def test_the_error_of_a_missing_file_names_the_machine(stub_spec, tmp_path, monkeypatch):
    def lost(batch, fixed, seed):
        raise FileNotFoundError("/maps/a.json: there is no such file")

    monkeypatch.setattr(sweep_stub, "stub", lost)
    first = run_sweep(stub_spec(), tmp_path / "out").failures[0]
    where = f"(on {socket.gethostname()})"
    assert first.message == f"FileNotFoundError: /maps/a.json: there is no such file {where}"
    assert "in lost" in first.trace
