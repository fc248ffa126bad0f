"""A sweep with more values of a parameter keeps its members, and has the larger result."""

import json
from collections import Counter

import numpy as np
import pytest
from sweep_kills import kill_apart, tree

from jaxcell.sweep import open_sweep, run_sweep, verify_sweep


SMALL = "[grid]\ny = [0.5, 1.5]\nx = [0, 2, 4, 6, 8, 10, 12]"
BETWEEN = "[grid]\ny = [0.5, 1.5]\nx = {count = 14}"
SAMPLES = "[random]\nsamples = {}\nx = {{integers = [0, 99]}}\ny = {{normal = [0, 1]}}"
GROWN = {
    "appended": (SMALL, "[grid]\ny = [0.5, 1.5]\nx = [0, 2, 4, 6, 8, 10, 12, 14, 16, 18]"),
    "between": (SMALL, BETWEEN),
    "before": (SMALL, "[grid]\ny = [-1.0, 0.5, 1.5]\nx = [-2, 0, 2, 4, 6, 8, 10, 12]"),
    "turned": (SMALL, "[grid]\ny = [2.5, 1.5, 0.5]\nx = [12, 10, 8, 6, 4, 2, 0]"),
    "samples": (SAMPLES.format(7), SAMPLES.format(19)),
    "lists": (
        "[list]\nx = [5, 5, 7]\ny = [1, 1, 2]",
        "[list]\nx = [7, 5, 5, 5, 7]\ny = [2, 1, 3, 1, 2]",
    ),
}


def members(batches):
    """Count the members with the same parameters."""
    return Counter((x, y) for one in batches for x, y in zip(one["x"], one["y"], strict=True))


def boxes(spec):
    return [spec.batch(spec.chunk(number)) for number in range(spec.chunk_count)]


@pytest.mark.parametrize("how", sorted(GROWN))
def test_a_sweep_grows(stub_spec, tmp_path, task, how):
    computed, _ = task
    small, large = (
        stub_spec(text=text, name=f"{name}.toml")
        for name, text in zip(("small", "large"), GROWN[how], strict=True)
    )
    run_sweep(large, tmp_path / "whole")
    run_sweep(small, tmp_path / "out")
    computed.clear()
    assert run_sweep(large, tmp_path / "out", resume=True).complete
    # The last member of a chunk may be repeated.
    assert set(members(computed)) == set(members(boxes(large)) - members(boxes(small)))
    assert tree(tmp_path / "out") == tree(tmp_path / "whole")
    assert (tmp_path / "out" / "spec.toml").read_bytes() == large.text
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["lock", "spec.toml", "sweep.journal", "sweep.zarr"]
    assert verify_sweep(tmp_path / "out", mend=True).damaged == ()
    with pytest.raises(ValueError, match=r"small\.toml: not the spec.*: \w+\.[xy]: "):
        run_sweep(small, tmp_path / "out", resume=True)


@pytest.mark.parametrize("kind", ["uniform", "loguniform", "normal", "integers", "choice"])
@pytest.mark.parametrize("ends", ["[1, 5]", "[1, 300]", "[1, 5000000000]", "[1, 70000]"])
def test_more_samples_begin_with_the_same(stub_spec, kind, ends):
    text = "[random]\nsamples = {}\nx = {{{} = {}}}"
    few = stub_spec(text=text.format(37, kind, ends)).parameters[0].values
    many = stub_spec(text=text.format(1000, kind, ends)).parameters[0].values
    np.testing.assert_array_equal(few, many[:37])


def test_growth_also_computes_chunks_that_were_not_done(stub_spec, tmp_path, task):
    computed, _ = task
    small, large = stub_spec(text=SMALL), stub_spec(text=BETWEEN, name="large.toml")
    run_sweep(large, tmp_path / "whole")
    run_sweep(small, tmp_path / "out", chunks=[1])
    computed.clear()
    run_sweep(large, tmp_path / "out", resume=True)
    missing = members(boxes(large)) - members([small.batch(small.chunk(1))])
    assert set(members(computed)) == set(missing)
    assert tree(tmp_path / "out") == tree(tmp_path / "whole")


def test_growth_does_not_keep_a_damaged_chunk(stub_spec, tmp_path):
    small, large = stub_spec(text=SMALL), stub_spec(text=BETWEEN, name="large.toml")
    run_sweep(large, tmp_path / "whole")
    run_sweep(small, tmp_path / "out")
    path = tmp_path / "out" / "sweep.journal"
    content = path.read_bytes()
    path.write_bytes(content[:-200] + b"?" + content[-199:])
    assert run_sweep(large, tmp_path / "out", resume=True).complete
    assert tree(tmp_path / "out") == tree(tmp_path / "whole")


def test_growth_keeps_the_list_of_changes(stub_spec, tmp_path, monkeypatch):
    run_sweep(stub_spec(text=SMALL), tmp_path / "out")
    large = stub_spec(text=BETWEEN, name="large.toml")
    monkeypatch.setattr("jaxcell.sweep.storage.digests.__version__", "9.9")
    with pytest.raises(ValueError, match=r"jaxcell_version: \S+ there, 9\.9 here"):
        run_sweep(large, tmp_path / "out", resume=True)
    run_sweep(large, tmp_path / "out", resume=True, anyway=True)
    with open_sweep(tmp_path / "out") as dataset:
        (message,) = json.loads(dataset.attrs["resumed_anyway"])
        assert dataset.attrs["jaxcell_version"] == "9.9"
    assert message.startswith("jaxcell_version: ")


def test_runs_that_are_killed_while_a_sweep_grows(stub_spec, tmp_path):
    small, large = stub_spec(text=SMALL), stub_spec(text=BETWEEN, name="large.toml")
    run_sweep(small, tmp_path / "small")
    (counts,) = kill_apart(
        {
            "file": str(large.path),
            "base": str(tmp_path),
            "kills": 10,
            "begun": str(tmp_path / "small"),
        }
    )
    assert counts["kills"] >= 10
