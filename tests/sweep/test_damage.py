"""Stores with flipped bits and files that are gone: seen, told, and mended."""

import functools
import json
import random
import shutil

import numpy as np
import pytest
import sweep_stub
import xarray as xr
from numcodecs.checksum32 import CRC32C
from sweep_kills import tree

from jaxcell.cli import main
from jaxcell.sweep import Spec, open_sweep, run_sweep, sweep_status, verify_sweep


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """The folder of a sweep of 20 chunks, and its values; some chunks are of one value alone."""
    folder = tmp_path_factory.mktemp("sound")
    (folder / "spec.toml").write_text(
        'task = "sweep_stub:stub"\nseed = 3\nchunk = 5\n[grid]\ny = [0.0, 1.5]\nx = {count = 50}\n'
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxcell.sweep.storage.digests.git_revision", lambda: "a revision")
        patch.setattr("jaxcell.sweep.boxes._FILE_BYTES", 1)
        assert run_sweep(Spec.load(folder / "spec.toml"), folder / "out").complete
    return folder / "out"


@pytest.fixture
def out(sound, tmp_path):
    return shutil.copytree(sound, tmp_path / "out")


def flip(path, rng):
    content = bytearray(path.read_bytes())
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def assert_whole_again(out, sound):
    assert tree(out) == tree(sound)
    with open_sweep(out) as found, open_sweep(sound) as expected:
        xr.testing.assert_identical(found.load(), expected.load())
    assert verify_sweep(out).damaged == ()


def test_a_sound_sweep_is_whole_and_no_task_runs(out, sound, monkeypatch):
    monkeypatch.setattr(sweep_stub, "stub", None)
    found = verify_sweep(out)
    assert (found.chunks, found.damaged, found.recomputed, found.whole) == (20, (), 0, True)
    assert tree(out) == tree(sound)


def test_all_chunks_with_flipped_bits_or_without_files_are_found_and_mended(out, sound):
    rng = random.Random(4)
    paths = [path for path in out.glob("sweep.zarr/*/c/*/**/*") if path.is_file()]
    assert len(paths) == 20 * 6
    chosen = rng.sample(paths, 60)
    for i, path in enumerate(chosen):
        if i % 3:
            flip(path, rng)
        else:
            path.unlink()
    chunks = {int(path.relative_to(out).parts[3]) * 10 + int(path.relative_to(out).parts[4])
              for path in chosen}  # fmt: skip
    found = verify_sweep(out)
    assert {int(line.split()[1].rstrip(":")) for line in found.damaged} == chunks
    assert (found.recomputed, found.whole, found.status.complete) == (len(chunks), True, True)
    assert_whole_again(out, sound)


def test_every_flipped_bit_of_a_chunk_is_seen(out):
    path = out / "sweep.zarr" / "even" / "c" / "1" / "2"
    content = path.read_bytes()
    with open_sweep(out) as dataset:
        for place in range(0, len(content) * 8, 3):
            changed = bytearray(content)
            changed[place // 8] ^= 1 << place % 8
            path.write_bytes(changed)
            with pytest.raises(ValueError, match="checksum"):
                _ = dataset["even"].values


@pytest.mark.parametrize("harm", [flip, lambda path, rng: path.unlink()])
def test_coordinates_are_mended(out, sound, harm):
    for name in ("x", "y", "exponent"):
        harm(out / "sweep.zarr" / name / "c" / "0", random.Random(6))
    found = verify_sweep(out)
    assert found.damaged == ("exponent/c/0", "x/c/0", "y/c/0")
    assert found.whole
    assert_whole_again(out, sound)


def test_metadata_is_mended(out, sound):
    root = out / "sweep.zarr"
    (root / "value" / "zarr.json").unlink()
    path = root / "power" / "zarr.json"
    path.write_text(path.read_text().replace("float64", "float32"))
    found = verify_sweep(out)
    assert found.damaged == ("power/zarr.json", "value/zarr.json")
    path = root / "zarr.json"
    path.write_text(path.read_text().replace("a revision", "b revision"))
    found = verify_sweep(out)
    assert found.damaged == ("zarr.json",)
    with open_sweep(out) as dataset:
        assert "were damaged" in dataset.attrs["resumed_anyway"]
    assert {name for name, _ in tree(out).items() ^ tree(sound).items()} == {"zarr.json"}
    assert verify_sweep(out).damaged == ()


def test_any_bit_of_metadata_is_mended(stub_spec, tmp_path):
    rng = random.Random(5)
    sound, out = tmp_path / "sound", tmp_path / "out"
    run_sweep(stub_spec(text="[grid]\nx = [1, 2]"), sound)
    shutil.copytree(sound, out)
    with open_sweep(sound) as expected:
        expected.load()
    paths = [*out.rglob("zarr.json")]
    for path in paths * 3:
        before = json.loads(path.read_bytes())
        flip(path, rng)
        try:
            same = json.loads(path.read_bytes()) == before
        except ValueError:
            same = False
        found = verify_sweep(out)
        assert found.whole
        if path.parent.name != "sweep.zarr":
            # A bit in the white space of JSON changes nothing.
            assert bool(found.damaged) != same
        with open_sweep(out) as here:
            xr.testing.assert_equal(here.load(), expected)


def test_a_file_that_is_gone_is_told(out, capsys):
    (out / "sweep.zarr" / "value" / "c" / "0" / "3").unlink()
    assert sweep_status(out).damaged == 1
    assert sweep_status(out).done == 19
    with pytest.raises(ValueError, match="1 of 20 chunks are damaged; to mend them: jaxcell sweep"):
        open_sweep(out)
    assert main(["sweep", "status", str(out), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["damaged"] == 1
    assert main(["sweep", "status", str(out)]) == 1
    assert f"sweep verify {out}" in capsys.readouterr().err


def test_damage_is_told_by_view(out, capsys):
    path = out / "sweep.zarr" / "value" / "c" / "0" / "3"
    content = path.read_bytes()
    path.unlink()
    assert main(["sweep", "view", str(out)]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "chunks are damaged" in told
    path.write_bytes(content)
    flip(out / "sweep.zarr" / "value" / "c" / "0" / "3", random.Random(1))
    assert main(["sweep", "view", str(out)]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "checksum" in told
    assert f"to mend it: jaxcell sweep verify {out}" in told


def test_a_status_that_cannot_be_read_is_damage(out, sound):
    flip(out / "sweep.zarr" / "status" / "c" / "1" / "3", random.Random(1))
    assert (sweep_status(out).damaged, sweep_status(out).done) == (1, 19)
    assert verify_sweep(out).damaged == ("chunk 13: status",)
    assert_whole_again(out, sound)


@pytest.mark.parametrize("name", ["value", "status"])
def test_what_cannot_be_decompressed_is_damage(out, sound, name):
    """Whatever its checksum."""
    path = out / "sweep.zarr" / name / "c" / "0" / "3"
    path.write_bytes(bytes(CRC32C(location="end").encode(path.read_bytes()[:-5])))
    assert verify_sweep(out).damaged == (f"chunk 3: {name}",)
    assert_whole_again(out, sound)


def test_a_resume_computes_chunks_whose_files_are_gone(out, sound):
    (out / "sweep.zarr" / "value" / "c" / "0" / "3").unlink()
    assert run_sweep(Spec.load(out / "spec.toml"), out, resume=True).complete
    assert_whole_again(out, sound)


def test_verify_leaves_what_was_never_done(stub_spec, tmp_path):
    spec, out = stub_spec("fail = 5"), tmp_path / "out"
    assert run_sweep(spec, out).done == 4
    (out / "sweep.zarr" / "value" / "c" / "0" / "0").unlink()
    found = verify_sweep(out)
    assert found.damaged == ("chunk 0: value",)
    assert found.whole
    assert (found.status.done, len(found.status.failures)) == (4, 2)


def test_the_command(out, capsys):
    for name in "47":
        flip(out / "sweep.zarr" / "count" / "c" / "0" / name, random.Random(2))
    assert main(["sweep", "verify", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "out": str(out),
        "chunks": 20,
        "damaged": ["chunk 4: count", "chunk 7: count"],
        "recomputed": 2,
        "done": 20,
        "whole": True,
    }
    assert main(["sweep", "verify", str(out)]) == 0
    assert main(["sweep", "verify", str(out / "none")]) == 2


def test_a_task_that_prints_leaves_the_output_to_what_was_found(out, capfd, monkeypatch):
    flip(out / "sweep.zarr" / "count" / "c" / "0" / "4", random.Random(2))
    monkeypatch.setattr(sweep_stub, "stub", functools.partial(chatty, sweep_stub.stub))
    assert main(["sweep", "verify", str(out), "--json"]) == 0
    told = capfd.readouterr()
    assert json.loads(told.out)["whole"]
    assert told.err.count("from Python") == 1


def chatty(task, batch, fixed, seed):
    print("from Python")
    return task(batch, fixed, seed)


def test_what_cannot_be_computed_again_is_told(out, monkeypatch):
    def broken(batch, fixed, seed):
        raise RuntimeError("no")

    flip(out / "sweep.zarr" / "count" / "c" / "0" / "4", random.Random(2))
    monkeypatch.setattr(sweep_stub, "stub", broken)
    found = verify_sweep(out)
    assert (len(found.damaged), found.recomputed, found.whole) == (1, 0, False)
    # No wrong number is left.
    with open_sweep(out) as dataset:
        assert dataset.status.values[0, 20:25].tolist() == [2] * 5
        assert np.isnan(dataset.value.values[0, 20:25]).all()


def test_a_specification_that_was_changed_is_refused(out):
    path = out / "spec.toml"
    path.write_text(path.read_text().replace("1.5", "2.5"))
    with pytest.raises(ValueError, match=r"spec.toml: not the specification that .* begun with"):
        verify_sweep(out)
