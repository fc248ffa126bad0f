"""Only members that are missing or failed are computed, and only they are written."""

import functools
import itertools

import numpy as np
from sweep_kills import damage_chunk, tree

from jaxcell.sweep import open_sweep, run_sweep, sweep_status, verify_sweep
from jaxcell.sweep.workers.progress import Count, read_down, written_down


def values(calls):
    """The values of `x` of each call of the task."""
    return [batch["x"] for batch in calls]


def test_a_resume_computes_the_members_that_failed(stub_spec, tmp_path, whole, task):
    calls, bad = task
    spec, out = stub_spec(name="whole.toml"), tmp_path / "out"
    bad |= {1, 5, 6}
    assert len(run_sweep(spec, out).failures) == 6
    calls.clear()
    bad.discard(5)
    status = run_sweep(spec, out, resume=True)
    # Four chunks have failures: of x 0 to 3 and of x 4 to 7.
    assert values(calls) == [[1], [5, 6], [5], [6]] * 2
    assert [one.parameters["x"] for one in status.failures] == [1, 6, 1, 6]
    bad.clear()
    calls.clear()
    assert run_sweep(spec, out, resume=True).complete
    assert values(calls) == [[1], [6]] * 2
    assert tree(out) == whole


def test_a_run_that_stopped_at_failures_is_resumed_with_the_missing_members(
    stub_spec, tmp_path, whole, task
):
    calls, bad = task
    spec, out = stub_spec(name="whole.toml"), tmp_path / "out"
    bad |= {2}
    assert len(run_sweep(spec, out, max_failures=0).failures) == 1
    assert values(calls) == [[0, 1, 2, 3], [0, 1], [2, 3], [2]]
    with open_sweep(out) as dataset:
        assert dataset.status.values[0].tolist() == [1, 1, 2, 0] + [0] * 6
        assert dataset["count"].values[0, :4].tolist() == [0, 1, -1, -1]
    bad.clear()
    calls.clear()
    assert run_sweep(spec, out, resume=True).complete
    assert values(calls)[0] == [2, 3]
    assert len(calls) == 6
    assert tree(out) == whole


def test_members_that_fail_after_growth_do_not_change_older_members(stub_spec, tmp_path, task):
    calls, bad = task
    small = stub_spec(text="[grid]\nx = [1, 3]")
    large = stub_spec(text="[grid]\nx = [1, 2, 3, 4]", name="large.toml")
    run_sweep(large, tmp_path / "whole")
    run_sweep(small, tmp_path / "out")
    calls.clear()
    bad |= {4}
    status = run_sweep(large, tmp_path / "out", resume=True)
    assert values(calls) == [[2, 4], [2], [4]]
    assert [one.parameters for one in status.failures] == [{"x": 4}]
    with open_sweep(tmp_path / "out") as dataset, open_sweep(tmp_path / "whole") as expected:
        assert dataset.status.values.tolist() == [1, 1, 1, 2]
        kept = dataset.x != 4
        assert dataset.where(kept, drop=True).equals(expected.where(kept, drop=True))
        assert np.isnan(dataset.value.sel(x=4))
    bad.clear()
    assert run_sweep(large, tmp_path / "out", resume=True).complete
    assert values(calls)[3:] == [[4]]
    assert tree(tmp_path / "out") == tree(tmp_path / "whole")


def test_rates_are_of_the_members_that_were_computed(stub_spec, tmp_path, task, monkeypatch):
    spec, seen = stub_spec(), []
    task[1].add(5)
    run_sweep(spec, tmp_path / "out")
    clock = itertools.count().__next__
    monkeypatch.setattr("jaxcell.sweep.run.Count", functools.partial(Count, clock=clock))
    run_sweep(spec, tmp_path / "out", resume=True, progress=seen.append)
    assert [(one.done, one.failed) for one in seen] == [(4, 0), (5, 1), (6, 2)]
    # The clock is read once at the beginning, and once for each.
    assert [one.rate for one in seen] == [0, 1 / 2, 2 / 3]


def test_the_time_left_is_extrapolated_from_chunks_that_ended(tmp_path):
    now = 100.0

    def clock():
        return now

    count = Count(chunks=10, done=4, clock=clock)
    now = 106.0
    for members in (5, 3):
        count.add(members)
    found = count.progress(())
    assert (found.done, found.rate, found.left) == (6, 8 / 6, 12)
    with written_down(tmp_path, clock) as write:
        write(found)
        assert read_down(tmp_path, clock) == (8 / 6, 12, "")
        now = 111.0
        assert read_down(tmp_path, clock) == (8 / 6, 7, "")
        now = 1000.0
        assert read_down(tmp_path, clock) == (8 / 6, 0, "")
    assert read_down(tmp_path, clock) == (None, None, "")


def test_a_damaged_chunk_with_a_member_that_fails_is_mended(stub_spec, tmp_path, task):
    _, bad = task
    bad |= {5}
    out = tmp_path / "out"
    run_sweep(stub_spec(), out)
    sound = tree(out)
    damage_chunk(out, 1)
    found = verify_sweep(out, mend=True)
    assert (found.damaged, found.recomputed, found.whole) == (("chunk 1",), 1, True)
    assert tree(out) == sound
    assert len(sweep_status(out).failures) == 2
    # A chunk that was done is not mended if a member fails now.
    bad |= {0}
    damage_chunk(out, 0)
    assert not verify_sweep(out, mend=True).whole
    assert len(sweep_status(out).failures) == 3


def test_metadata_is_mended_if_every_chunk_has_a_member_that_fails(stub_spec, tmp_path, task):
    task[1].add(5)
    out = tmp_path / "out"
    run_sweep(stub_spec(text="[list]\nx = [5, 1, 2, 3, 5, 4]"), out)
    sound = tree(out)
    (out / "sweep.zarr" / "value" / "zarr.json").unlink()
    found = verify_sweep(out, mend=True)
    assert (found.damaged, found.whole) == (("sweep.zarr/value/zarr.json",), True)
    assert tree(out) == sound
