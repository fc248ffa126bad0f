"""Damaged stores: every changed bit is found, and what is lost is computed again."""

import random
import shutil
import struct
import zlib

import numpy as np
import pytest
import sweep_stub
import xarray as xr
from helpers import run
from sweep_kills import damage_chunk, flip, records, tree

from jaxcell.cli import main
from jaxcell.sweep import Spec, open_sweep, run_sweep, sweep_status, verify_sweep
from jaxcell.sweep.storage.journal import Kind


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """The folder of a sweep of 20 chunks; some variables of a chunk have only equal values."""
    folder = tmp_path_factory.mktemp("sound")
    (folder / "spec.toml").write_text(
        'task = "sweep_stub:stub"\nseed = 3\nchunk = 5\n[grid]\ny = [0.0, 1.5]\nx = {count = 50}\n'
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxcell.sweep.storage.digests.git_revision", lambda: "a revision")
        assert run_sweep(Spec.load(folder / "spec.toml"), folder / "out").complete
    return folder / "out"


@pytest.fixture
def out(sound, tmp_path):
    return shutil.copytree(sound, tmp_path / "out")


def bits(path):
    return path.stat().st_size * 8


def assert_whole_again(out, sound):
    assert tree(out) == tree(sound)
    assert sweep_status(out).complete
    assert (out / "spec.toml").read_bytes() == (sound / "spec.toml").read_bytes()
    with open_sweep(out) as result, open_sweep(sound) as expected:
        xr.testing.assert_identical(result.load(), expected.load())
    assert verify_sweep(out, mend=True).damaged == ()


def test_a_sound_sweep_is_whole_and_no_task_runs(out, sound, monkeypatch):
    monkeypatch.setattr(sweep_stub, "stub", None)
    report = verify_sweep(out, mend=True)
    assert (report.chunks, report.damaged, report.recomputed, report.whole) == (20, (), 0, True)
    assert tree(out) == tree(sound)


def test_fifty_flipped_bits_anywhere_are_found_and_mended(sound, tmp_path):
    """One at a time, in each file with a chance that grows with its size."""
    rng = random.Random(4)
    paths = [path for path in sorted(sound.rglob("*")) if path.is_file() and bits(path)]
    chosen = rng.choices(paths, [bits(path) for path in paths], k=50)
    for path in [*chosen, *paths]:
        out = tmp_path / "out"
        shutil.copytree(sound, out)
        place = rng.randrange(bits(path))
        flip(out / path.relative_to(sound), place)
        flipped = tree(out)
        seen = verify_sweep(out)
        assert tree(out) == flipped
        report = verify_sweep(out, mend=True)
        assert report.damaged == seen.damaged != (), (path, place)
        assert report.whole
        if report.damaged != ("sweep.journal, spec",):
            assert_whole_again(out, sound)
        shutil.rmtree(out)


def test_every_flipped_bit_of_a_file_of_the_result_is_seen_when_it_is_read(out):
    path = out / "sweep.zarr" / "even" / "c" / "0" / "0"
    content = path.read_bytes()
    with open_sweep(out) as dataset:
        for place in range(0, len(content) * 8, 3):
            path.write_bytes(content)
            flip(path, place)
            with pytest.raises(ValueError, match="checksum"):
                _ = dataset["even"].values


def test_damaged_chunks_are_named_and_computed_again(out, sound):
    for number in (3, 4, 17):
        damage_chunk(out, number)
    (out / "sweep.zarr" / "x" / "c" / "0").unlink()
    (out / "spec.toml").unlink()
    report = verify_sweep(out, mend=True)
    assert report.damaged == ("chunk 3", "chunk 4", "chunk 17", "spec.toml", "sweep.zarr/x/c/0")
    assert (report.recomputed, report.whole, report.done) == (5, True, 20)
    assert_whole_again(out, sound)


def test_a_chunk_whose_number_is_damaged_is_computed_again(out, sound):
    record = records(out)[Kind.CHUNK, 7]
    flip(out / "sweep.journal", (record.start - 20) * 8)
    assert sweep_status(out).damaged == 1
    report = verify_sweep(out, mend=True)
    assert [line.split(", byte")[0] for line in report.damaged] == ["sweep.journal"]
    assert report.whole
    assert_whole_again(out, sound)


def test_a_damaged_result_is_written_again_without_the_task(out, sound, monkeypatch):
    monkeypatch.setattr(sweep_stub, "stub", None)
    shutil.rmtree(out / "sweep.zarr")
    report = verify_sweep(out, mend=True)
    assert len(report.damaged) == report.recomputed == len(tree(sound))
    assert_whole_again(out, sound)


def test_damaged_variables_are_written_again(out, sound):
    record = records(out)[Kind.FRAME, 0]
    flip(out / "sweep.journal", record.start * 8 + 3)
    with pytest.raises(ValueError, match=r"variables cannot be read; to mend it: jaxcell verify"):
        sweep_status(out)
    assert verify_sweep(out, mend=True).damaged == ("sweep.journal, frame",)
    assert_whole_again(out, sound)


def test_a_damaged_specification_is_taken_from_its_copy(out, sound):
    flip(out / "sweep.journal", records(out)[Kind.SPEC, 0].start * 8 + 3)
    with pytest.raises(ValueError, match=r"specification cannot be read; to mend it"):
        sweep_status(out)
    assert verify_sweep(out, mend=True).whole
    with open_sweep(out) as result, open_sweep(sound) as expected:
        assert "were damaged" in result.attrs["resumed_anyway"]
        xr.testing.assert_equal(result, expected)
    assert verify_sweep(out, mend=True).damaged == ()


def test_a_lost_end_of_the_journal_is_computed_again(out, sound):
    """As after a loss of power, or a copy that was stopped."""
    path = out / "sweep.journal"
    path.write_bytes(path.read_bytes()[: records(out)[Kind.CHUNK, 15].start + 5])
    assert sweep_status(out).done == 15
    assert run_sweep(Spec.load(out / "spec.toml"), out, resume=True).complete
    assert_whole_again(out, sound)


def test_a_resume_computes_damaged_chunks(out, sound):
    """A loss of power may leave a record whose content is not on the disk."""
    for number in (3, 19):
        damage_chunk(out, number)
    assert run_sweep(Spec.load(out / "spec.toml"), out, resume=True).complete
    assert tree(out) == tree(sound)


def test_a_resume_writes_lost_files_of_the_result(out, sound):
    (out / "sweep.zarr" / "value" / "c" / "0" / "0").unlink()
    assert sweep_status(out).damaged == 1
    with pytest.raises(ValueError, match=r"damaged: value/c/0/0; to mend it: jaxcell verify"):
        open_sweep(out)
    # In the same place as before: otherwise the journal changes, and the result is made again.
    spec = Spec.load(shutil.copy(out / "spec.toml", out.parent))
    assert run_sweep(spec, out, resume=True).complete
    assert_whole_again(out, sound)


def test_damage_is_not_mended_with_other_versions(out, sound, monkeypatch):
    damage_chunk(out, 3)
    with monkeypatch.context() as patch:
        patch.setattr("jaxcell.sweep.storage.digests.__version__", "9.9")
        with pytest.raises(ValueError, match=r"damaged \(chunk 3\), and made with .* 9\.9 here"):
            verify_sweep(out, mend=True)
    assert verify_sweep(out, mend=True).damaged == ("chunk 3",)
    assert_whole_again(out, sound)


def test_verify_leaves_chunks_that_were_never_done(stub_spec, tmp_path):
    spec, out = stub_spec("fail = 5"), tmp_path / "out"
    run_sweep(spec, out, chunks=[0, 1, 2])
    damage_chunk(out, 0)
    damage_chunk(out, 1)
    report = verify_sweep(out, mend=True)
    assert report.damaged == ("chunk 0", "chunk 1")
    assert report.whole
    assert (report.done, len(sweep_status(out).failures)) == (2, 1)


def test_the_command_reports_damage_and_mends_it_on_request(out, capsys, monkeypatch):
    for number in (4, 7):
        damage_chunk(out, number)
    damage = {"damaged": ["chunk 4", "chunk 7"], "unlisted": []}
    expected = {"folder": str(out), "checked": 20, **damage}
    with monkeypatch.context() as patch:
        patch.setattr(sweep_stub, "stub", None)
        status, report, _ = run(capsys, "verify", out)
    assert status == 1
    (found,) = report["results"]
    assert all("jaxcell verify --mend" in way for way in found.pop("ways"))
    assert found == {**expected, "mended": 0, "whole": False}
    status, report, _ = run(capsys, "verify --mend", out)
    assert status == 0
    (found,) = report["results"]
    found.pop("ways", None)
    assert found == {**expected, "mended": 2, "whole": True}
    assert main(["verify", str(out)]) == 0
    assert main(["verify", str(out / "none")]) == 2


def test_a_lost_first_record_is_mended_from_the_copy(out, sound):
    path, first = out / "sweep.journal", records(out)[Kind.SPEC, 0]
    path.write_bytes(path.read_bytes()[first.end :])
    with pytest.raises(ValueError, match=r"specification cannot be read; to mend it: jaxcell ver"):
        sweep_status(out)
    assert verify_sweep(out).damaged == ("sweep.journal, spec",)
    assert verify_sweep(out, mend=True).whole
    with open_sweep(out) as result, open_sweep(sound) as expected:
        xr.testing.assert_equal(result, expected)


def test_chunks_that_cannot_be_computed_again_are_reported(out, monkeypatch):
    def broken(batch, fixed, seed):
        raise RuntimeError("no")

    damage_chunk(out, 4)
    monkeypatch.setattr(sweep_stub, "stub", broken)
    report = verify_sweep(out, mend=True)
    assert (report.damaged, report.recomputed, report.whole) == (("chunk 4",), 0, False)
    # No wrong number is left.
    with open_sweep(out) as dataset:
        assert dataset.status.values[0, 20:25].tolist() == [2] * 5
        assert np.isnan(dataset.value.values[0, 20:25]).all()


def test_a_newer_journal_is_refused_and_kept(out, sound):
    """A journal of a newer version is neither damaged nor cut, whatever is asked of it."""
    fields = struct.pack("<4sBBQQI", b"\xf5Rec", 9, 0, 0, 4, zlib.crc32(b"new."))
    with (out / "sweep.journal").open("ab") as file:
        file.write(fields + struct.pack("<I", zlib.crc32(fields)) + b"new.")
    content = (out / "sweep.journal").read_bytes()
    spec = Spec.load(out / "spec.toml")
    for use in (
        sweep_status,
        open_sweep,
        verify_sweep,
        lambda out: verify_sweep(out, mend=True),
        lambda out: run_sweep(spec, out, resume=True),
    ):
        with pytest.raises(ValueError, match=r"unknown kind 9; a newer jaxcell wrote it"):
            use(out)
        assert (out / "sweep.journal").read_bytes() == content


def test_a_refused_resume_changes_nothing(out, tmp_path):
    with (out / "sweep.journal").open("ab") as file:
        file.write(b"\xf5Rec and the begin of a record")
    content = (out / "sweep.journal").read_bytes()
    (tmp_path / "other.toml").write_text('task = "sweep_stub:stub"\nseed = 4\n[grid]\nx = [1.0]\n')
    with pytest.raises(ValueError, match="not the specification"):
        run_sweep(Spec.load(tmp_path / "other.toml"), out, resume=True)
    assert (out / "sweep.journal").read_bytes() == content


def test_a_folder_with_a_short_name_is_reported_as_damaged(out, monkeypatch):
    monkeypatch.chdir(out)
    flip(out / "sweep.journal", records(out)[Kind.FRAME, 0].start * 8 + 3)
    with pytest.raises(ValueError, match=r"damaged: .*; to mend it: jaxcell verify --mend \."):
        sweep_status(".")


def test_resumes_with_a_failing_member_do_not_enlarge_the_journal(stub_spec, tmp_path, monkeypatch):
    stub = sweep_stub.stub

    def failing(batch, fixed, seed):
        if 5 in batch["x"]:
            raise RuntimeError("no")
        return stub(batch, fixed, seed)

    monkeypatch.setattr(sweep_stub, "stub", failing)
    spec, out = stub_spec(), tmp_path / "out"
    run_sweep(spec, out)
    first = (out / "sweep.journal").stat().st_size
    for _ in range(5):
        run_sweep(spec, out, resume=True)
    assert (out / "sweep.journal").stat().st_size <= 1.2 * first
    assert len(sweep_status(out).failures) == 2
