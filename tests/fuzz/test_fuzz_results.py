"""Damaged recordings and sweeps."""

import functools
import shutil

import pytest
import rerun as rr
from hypothesis import given, strategies as st
from mutations import answers, cases, damaged, limits, place, reads_or_refuses, tree

from jaxcell.cli import main
from jaxcell.cli.described import describe
from jaxcell.sweep import Spec, open_sweep, run_sweep, sweep_status, verify_sweep


SPEC = b'task = "sweep_stub:stub"\nchunk = 2\n[grid]\nx = [1, 2, 3]\n[fixed]\nfail = 3\n'


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "whole.rrd"
    with rr.RecordingStream("fuzz") as stream:
        stream.save(path)
        for step in range(3):
            stream.set_time("step", sequence=step)
            stream.log("robot", rr.Points2D([[step, 0.5]]))
    return path.read_bytes()


@cases()
@given(data=st.data())
def test_damaged_recordings_are_read_or_refused(tmp_path, recording, data):
    reads_or_refuses(describe, place(tmp_path, *data.draw(damaged({"run.rrd": recording}))))


def test_undamaged_recording_is_read(tmp_path, recording):
    assert "step" in describe(place(tmp_path, "run.rrd", recording))["timelines"]


def run(out, **options):
    spec = Spec.load(place(out.parent, "spec.toml", SPEC))
    run_sweep(spec, out, **options)


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """A sweep of two chunks, of which one failed."""
    out = tmp_path_factory.mktemp("sweep") / "out"
    run(out)
    return out


@cases(60)
@given(data=st.data())
def test_damaged_sweeps_are_used_or_refused(tmp_path, sweep, data):
    out = tmp_path / "out"
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(sweep, out)
    names = [name for name in tree(out) if (out / name).is_file() and name != "lock"]
    name = data.draw(st.sampled_from(names))
    if data.draw(st.integers(0, 9)) == 0:
        (out / name).unlink()
    else:
        place(out, *data.draw(damaged({name: (out / name).read_bytes()})))
    resume = functools.partial(run, resume=True)
    for use in (sweep_status, describe, open_sweep, resume, verify_sweep):
        try:
            with limits():
                use(out)
        except (ValueError, OSError) as error:
            assert "out" in str(error), repr(error)
            assert len(str(error)) < 1500


@pytest.mark.parametrize("options", [[], ["--select", "x=1"]])
def test_a_sweep_with_damaged_values_is_not_shown(tmp_path, sweep, capsys, options):
    shutil.copytree(sweep, tmp_path / "out")
    (tmp_path / "out/sweep.zarr/value/c/0").write_bytes(b"no zstd")
    before = tree(tmp_path)
    assert answers(main, capsys, "sweep", "view", tmp_path / "out", *options) == 2
    assert tree(tmp_path) == before


def test_undamaged_sweep_is_read(sweep):
    assert (sweep_status(sweep).done, len(sweep_status(sweep).failures)) == (1, 1)
    assert open_sweep(sweep).value.notnull().sum() == 2
