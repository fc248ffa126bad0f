"""Shards: parts of a sweep by jobs of an array, and their merged result."""

import shlex
import shutil

import pytest
from helpers import run
from sweep_kills import tree

from jaxcell.cli import main
from jaxcell.sweep import Shard, Spec, merge_sweep, run_sweep


@pytest.fixture
def sharded(tmp_path):
    """Runs shards of a sweep."""

    def run(spec, *texts, **options):
        for text in texts:
            shard = Shard.read(text)
            chunks = shard.chunks(spec.chunk_count)
            run_sweep(spec, shard.folder(tmp_path / "out"), chunks=chunks, **options)
        return tmp_path / "out"

    return run


def merged(out):
    """The files of a sweep without those of its shards."""
    shutil.rmtree(out / "shards")
    return tree(out)


# Of six chunks; the last shards of seven have none.
@pytest.mark.parametrize("count", [1, 4, 7])
def test_merged_shards_have_the_bytes_of_the_sweep(stub_spec, sharded, whole, count):
    texts = [f"{number}/{count}" for number in range(count, 0, -1)]
    out = sharded(stub_spec(name="whole.toml"), *texts)
    seen = []
    assert merge_sweep(out, progress=lambda now: seen.append((now.done, now.chunks))).complete
    assert seen == [(done, 6) for done in range(7)]
    # A second time there is nothing to do.
    assert merge_sweep(out).complete
    assert merged(out) == whole


def test_members_that_failed_are_merged(stub_spec, tmp_path, sharded):
    spec = stub_spec("fail = 9")
    run_sweep(spec, tmp_path / "whole")
    found = merge_sweep(out := sharded(spec, "1/2", "2/2"))
    assert [one.parameters for one in found.failures] == [{"y": y, "x": 9} for y in (0.5, 1.5)]
    assert "RuntimeError: x is 9" in found.failures[0].trace
    assert merged(out) == tree(tmp_path / "whole")


def test_shards_that_cannot_be_merged(stub_spec, tmp_path, sharded, monkeypatch):
    def refused(message):
        with pytest.raises(ValueError, match=message):
            merge_sweep(tmp_path / "out")
        assert not (tmp_path / "out" / "sweep.journal").exists()

    refused("there are no shards to merge; jaxcell sweep SPEC --shard I/N makes one")
    spec = stub_spec()
    sharded(spec, "1/3", "3/3")
    refused(r"out: shards that are not there: 2/3$")
    run_sweep(spec, tmp_path / "out" / "shards" / "2-of-3", chunks=[1])
    refused(r"out: shards that are not done: 2/3 \(1 of 2 chunks\)$")
    sharded(stub_spec(name="other.toml", fixed="seconds = 0"), "1/2")
    refused("expected the shards 1/n to n/n, got 2 and 3 for n")
    shutil.rmtree(tmp_path / "out" / "shards" / "1-of-2")
    shutil.rmtree(tmp_path / "out" / "shards" / "2-of-3")
    sharded(stub_spec(name="other.toml", fixed="seconds = 0"), "2/3")
    refused("2-of-3: not the specification of shard 1: fixed.seconds: nothing there, 0 here")
    shutil.rmtree(tmp_path / "out" / "shards" / "2-of-3")
    with monkeypatch.context() as patch:
        patch.setattr("jaxcell.sweep.storage.digests.__version__", "9.9")
        sharded(spec, "2/3")
    refused(r"2-of-3: made with other versions or files: jaxcell_version: 9\.9 there, ")


def test_members_that_were_not_tried_are_not_done(stub_spec, tmp_path, sharded):
    spec = stub_spec("fail = 0", text="[grid]\nx = {count = 4}")
    sharded(spec, "1/1", max_failures=0)
    with pytest.raises(ValueError, match=r"not done: 1/1 \(0 of 1 chunks\)"):
        merge_sweep(tmp_path / "out")


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "1/0", "-1/3", "1/3/3", "a/b", ""])
def test_other_texts_are_refused_as_shards(text):
    with pytest.raises(ValueError, match="shard: expected i/n with i from 1 to n, got"):
        Shard.read(text)


def test_commands_run_and_merge_shards(spec_file, tmp_path, capsys):
    spec, out = spec_file(head="chunk = 4", text="[grid]\nx = {count = 10}"), tmp_path / "out"
    merge = f"sweep merge {shlex.quote(str(out))}"
    assert Spec.load(spec).chunk_count == 3
    for number in (1, 2):
        status, found, note = run(capsys, "sweep", spec, "--out", out, "--shard", f"{number}/2")
        assert (status, found["out"]) == (0, str(out / "shards" / f"{number}-of-2"))
        assert f"This shard is {3 - number} of the 3 chunks\n" in note
        assert merge in note
    assert main(["sweep", "status", str(out)]) == 2
    message = f"it has no sweep.journal, but shards, as {out}/shards/1-of-2: jaxcell {merge}"
    assert message in capsys.readouterr().err
    assert run(capsys, "sweep merge", out)[1]["done"] == 3
    assert main(["sweep", str(spec), "--shard", "3/2"]) == 2
    assert "--shard: expected i/n" in capsys.readouterr().err
