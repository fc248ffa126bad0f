"""Files that hold several chunks: as crash-safe as those of one, and few."""

import os
import random
import shutil
from pathlib import Path

import numpy as np
import pytest
import sweep_kills
import sweep_stub
import xarray as xr
from sweep_kills import kill_apart, tree

from jaxcell.sweep import open_sweep, run_sweep, sweep_status, verify_sweep
from jaxcell.sweep.boxes import stored_lengths
from jaxcell.sweep.storage.store import SweepStore
from jaxcell.sweep.workers.work import Variable, compute


@pytest.fixture
def few(monkeypatch):
    """Files of three chunks each, where there are six: a chunk of `power` has 96 bytes."""
    monkeypatch.setattr("jaxcell.sweep.boxes._FILE_BYTES", 300)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of an unbroken sweep of `stub_spec` with such files."""
    folder = tmp_path_factory.mktemp("whole")
    path = folder / "spec.toml"
    path.write_text(
        'task = "sweep_stub:stub"\nseed = 3\nchunk = 4\n\n[fixed]\n\n[grid]\ny = [0.5, 1.5]\n'
        "x = {count = 10}\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxcell.sweep.storage.digests.git_revision", lambda: "a revision")
        patch.setattr("jaxcell.sweep.boxes._FILE_BYTES", 300)
        run_sweep(sweep_kills.Spec.load(path), folder / "out")
    return folder / "out"


class StopError(Exception):
    pass


def stopped(spec, out, done):
    """A sweep that ended when so many chunks were done."""

    def stop(progress):
        if progress.done == done:
            raise StopError

    with pytest.raises(StopError):
        run_sweep(spec, out, progress=stop)


def file_of(out, name, number=0):
    """A file of an array."""
    files = sorted(path for path in (out / "sweep.zarr" / name / "c").rglob("*") if path.is_file())
    return files[number]


def spoil(path):
    path.write_bytes(b"?" + path.read_bytes()[1:])


@pytest.mark.parametrize(
    "text",
    [
        "[random]\nsamples = 1_000_000\nx = {uniform = [0, 1]}",
        "[grid]\na = {count = 1000}\nb = {count = 1000}",
        "[grid]\na = {count = 100}\nb = {count = 100}\nc = {count = 100}",
    ],
)
def test_a_million_members_are_few_files(spec_file, monkeypatch, text):
    monkeypatch.setattr("jaxcell.sweep.boxes._FILE_BYTES", 2**20)
    spec = sweep_kills.Spec.load(spec_file(text))
    assert spec.chunk_count > 10_000
    for inner, expected in ((), 10), ((10_000,), spec.chunk_count):
        values = np.broadcast_to(0.0, (64, *inner))
        lengths = stored_lengths(spec, {"v": Variable((), values, {})})
        sizes = zip(spec.dimensions.values(), lengths, strict=True)
        assert np.prod([-(-size // length) for size, length in sizes]) <= expected
        for length, chunk in zip(lengths, spec.lengths.values(), strict=True):
            assert length % chunk == 0
            # A large member is never written again with others.
            assert not inner or length == chunk


def test_the_result_is_the_same_in_any_order(stub_spec, tmp_path, monkeypatch, few, whole):
    def shuffled(take):
        jobs = list(iter(take, None))
        random.Random(1).shuffle(jobs)
        yield from ((job, compute(job)) for job in jobs)

    spec = stub_spec()
    with monkeypatch.context() as patch:
        patch.setattr("jaxcell.sweep.run.engine_named", lambda *_: shuffled)
        run_sweep(spec, tmp_path / "shuffled")
    assert tree(tmp_path / "shuffled") == tree(whole)
    arrays = ("status", "value", "noise", "count", "even", "power")
    chunks = [name for name in tree(whole) if name.split("/c/")[0] in arrays]
    assert sum("/c/" in name for name in chunks) == 2 * len(arrays)
    monkeypatch.setattr("jaxcell.sweep.boxes._FILE_BYTES", 1)
    run_sweep(spec, tmp_path / "many")
    with open_sweep(whole) as found, open_sweep(tmp_path / "many") as expected:
        xr.testing.assert_identical(found.load(), expected.load())


def test_a_run_that_stopped_is_seen_as_far_as_it_came(stub_spec, tmp_path, few, whole):
    spec, out = stub_spec(), tmp_path / "out"
    stopped(spec, out, 2)
    assert (sweep_status(out).done, sweep_status(out).damaged) == (2, 0)
    # Without ours too.
    with xr.open_zarr(out / "sweep.zarr") as dataset:
        assert dataset.status.values.tolist() == [[1] * 8 + [0] * 2, [0] * 10]
        assert dataset["count"].values.tolist() == [[*range(8), -1, -1], [-1] * 10]
        assert np.isnan(dataset.value.values[dataset.status.values == 0]).all()
    assert verify_sweep(out).damaged == ()
    # What a run that was killed leaves of the next chunk.
    for name in ("value", "status"):
        path = file_of(out, name)
        path.with_name(f".{path.name}-01234567").write_bytes(b"?")
    assert run_sweep(spec, out, resume=True).complete
    assert tree(out) == tree(whole)


def test_no_file_is_replaced_before_it_is_on_the_disk(stub_spec, tmp_path, few, monkeypatch):
    """Else a loss of power could take chunks that were done with the one that was written."""
    kept, synced, replaced = (os.fsync, os.replace), set(), []

    def sync(descriptor):
        synced.add(os.fstat(descriptor).st_ino)
        kept[0](descriptor)

    def replace(source, target):
        # The lost names of files and the speed of a run do no harm.
        if os.path.isfile(source) and Path(target).name not in ("origin.json", "progress.json"):
            replaced.append((str(target), os.stat(source).st_ino in synced))
        kept[1](source, target)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(os, "replace", replace)
    # Each chunk is written before the next is taken.
    monkeypatch.setattr("jaxcell.sweep.pending._MAX_BYTES", 0)
    run_sweep(stub_spec(), tmp_path / "out")
    # Six chunks of six arrays, what describes these, three coordinates and the whole, and the rest.
    assert len(replaced) >= 6 * 6 + 6 + 2 * 3 + 2
    assert all(safe for _, safe in replaced)
    # The states of a chunk come after its values.
    assert "status" in replaced[-1][0]


@pytest.mark.parametrize(("limit", "writes"), [(2**28, 2), (0, 6)])
def test_a_file_is_written_once_for_many_chunks(
    stub_spec, tmp_path, few, whole, monkeypatch, limit, writes
):
    """Of two files, with three chunks each: at the end, or where memory is short for each chunk."""
    kept, replaced = os.replace, []

    def replace(source, target):
        replaced.append(str(target))
        kept(source, target)

    monkeypatch.setattr(os, "replace", replace)
    monkeypatch.setattr("jaxcell.sweep.pending._SECONDS", 1e6)
    monkeypatch.setattr("jaxcell.sweep.pending._MAX_BYTES", limit)
    run_sweep(stub_spec(), tmp_path / "out")
    assert sum("sweep.zarr/value/c/" in name for name in replaced) == writes
    assert tree(tmp_path / "out") == tree(whole)


def test_members_that_failed_are_computed_again(stub_spec, tmp_path, few, whole, monkeypatch):
    spec, out = stub_spec(), tmp_path / "out"
    kept = sweep_stub.stub

    def picky(batch, fixed, seed):
        if 5 in batch["x"]:
            raise RuntimeError("no")
        return kept(batch, fixed, seed)

    with monkeypatch.context() as patch:
        patch.setattr(sweep_stub, "stub", picky)
        assert len(run_sweep(spec, out).failures) == 2
        assert verify_sweep(out).damaged == ()
    with open_sweep(out) as dataset:
        assert (dataset.status == xr.where(dataset.x == 5, 2, 1)).all()
    assert run_sweep(spec, out, resume=True).complete
    assert tree(out) == tree(whole)


@pytest.mark.parametrize(
    ("harm", "name"), [(spoil, "value"), (spoil, "status"), (Path.unlink, "status")]
)
def test_what_is_damaged_is_found_and_mended(tmp_path, few, whole, name, harm):
    out = shutil.copytree(whole, tmp_path / "out")
    harm(file_of(out, name))
    found = verify_sweep(out)
    assert found.damaged == tuple(f"chunk {number}: {name}" for number in range(3))
    assert found.whole
    assert tree(out) == tree(whole)


def test_a_file_is_written_once_for_all_chunks_of_it_that_are_damaged(
    tmp_path, few, whole, monkeypatch
):
    out = shutil.copytree(whole, tmp_path / "out")
    store = SweepStore(out, sweep_kills.Spec.load(out / "spec.toml"), {})
    kept, calls = SweepStore.put, []

    def put(store, name, box, values):
        calls.append((name, box.number))
        kept(store, name, box, values)

    monkeypatch.setattr(SweepStore, "put", put)
    store.forget([0, 1, 4])
    assert len(calls) == len({*calls}) == 2 * 6
    expected = [[0] * 8 + [1] * 2, [1] * 4 + [0] * 4 + [1] * 2]
    assert store.members().tolist() == expected
    with xr.open_zarr(out / "sweep.zarr") as dataset:
        assert (np.isnan(dataset.value) == (dataset.status == 0)).all()


def test_chunks_that_were_never_done_are_left_alone(stub_spec, tmp_path, few, whole):
    spec, out = stub_spec(), tmp_path / "out"
    stopped(spec, out, 2)
    spoil(file_of(out, "value"))
    with pytest.raises(ValueError, match="to mend it: jaxcell sweep verify"):
        run_sweep(spec, out, resume=True)
    found = verify_sweep(out)
    assert found.damaged == ("chunk 0: value", "chunk 1: value")
    assert (found.whole, found.status.done) == (True, 2)
    assert run_sweep(spec, out, resume=True).complete
    assert tree(out) == tree(whole)


def test_files_that_no_chunk_needs_any_more_are_written_anew(stub_spec, tmp_path, few, whole):
    """A repair that was killed leaves them: their chunks are to do, and they cannot be read."""
    spec, out = stub_spec(), tmp_path / "out"
    stopped(spec, out, 1)
    status = xr.open_zarr(out / "sweep.zarr").status
    status[...] = 0
    status.to_dataset().drop_vars(["x", "y"]).to_zarr(out / "sweep.zarr", mode="r+")
    file_of(out, "value").write_bytes(b"")
    assert run_sweep(spec, out, resume=True).complete
    assert tree(out) == tree(whole)


def test_a_sweep_grows(stub_spec, tmp_path, few):
    small = stub_spec(text="[grid]\ny = [0.5, 1.5]\nx = [0, 2, 4, 6, 8, 10, 12]")
    large = stub_spec(text="[grid]\ny = [0.5, 1.0, 1.5]\nx = {count = 14}", name="large.toml")
    run_sweep(large, tmp_path / "whole")
    stopped(small, tmp_path / "out", 3)
    assert run_sweep(large, tmp_path / "out", resume=True).complete
    assert tree(tmp_path / "out") == tree(tmp_path / "whole")


def test_a_sweep_of_a_file_for_each_chunk_goes_on_so(stub_spec, tmp_path, monkeypatch):
    spec, out = stub_spec(), tmp_path / "out"
    run_sweep(spec, tmp_path / "whole")
    stopped(spec, out, 2)
    monkeypatch.setattr("jaxcell.sweep.boxes._FILE_BYTES", 2**20)
    assert run_sweep(spec, out, resume=True).complete
    assert tree(out) == tree(tmp_path / "whole")


def test_runs_that_are_killed_at_any_moment(stub_spec, tmp_path):
    file = str(stub_spec().path)
    late, whole, part = kill_apart(
        {"file": file, "base": f"{tmp_path}/late", "kills": 6, "file_bytes": 2**20, "seconds": 1},
        {"file": file, "base": f"{tmp_path}/whole", "kills": 12, "file_bytes": 2**20},
        {"file": file, "base": f"{tmp_path}/part", "kills": 12, "file_bytes": 300},
    )
    assert late["kills"] >= 6
    for told in (whole, part):
        assert told["kills"] >= 12
        # Some were in the middle of it, where it is not written at the end alone.
        assert told["partial"] > 0
