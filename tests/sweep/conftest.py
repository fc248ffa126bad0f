import pytest
import sweep_stub
from sweep_kills import tree

from jaxcell.sweep import Spec, run_sweep


@pytest.fixture(autouse=True)
def revision(monkeypatch):
    """The source may change while tests run."""
    monkeypatch.setattr("jaxcell.sweep.storage.digests.git_revision", lambda: "a revision")


@pytest.fixture
def spec_file(tmp_path):
    """Writes the specification of a sweep of the stub."""

    def written(text="", name="spec.toml", head="", fixed=""):
        path = tmp_path / name
        text = text or "[grid]\ny = [0.5, 1.5]\nx = {count = 10}"
        path.write_text(f'task = "sweep_stub:stub"\nseed = 3\n{head}\n[fixed]\n{fixed}\n{text}\n')
        return path

    return written


@pytest.fixture
def stub_spec(spec_file):
    """The specification of a sweep of the stub in six chunks of four, padded to a box."""

    def loaded(fixed="", **others):
        return Spec.load(spec_file(fixed=fixed, head="chunk = 4", **others))

    return loaded


@pytest.fixture
def task(monkeypatch):
    """The batches that the task was asked for, and the values of `x` with which it fails."""
    calls, bad = [], set()
    kept = sweep_stub.stub

    def picky(batch, fixed, seed):
        calls.append({name: values.tolist() for name, values in batch.items()})
        if bad & set(calls[-1]["x"]):
            raise RuntimeError("no")
        return kept(batch, fixed, seed)

    monkeypatch.setattr(sweep_stub, "stub", picky)
    return calls, bad


@pytest.fixture
def calls(tmp_path):
    """A folder in which each call of the stub leaves a file."""
    folder = tmp_path / "calls"
    folder.mkdir()
    return folder


@pytest.fixture
def whole(stub_spec, tmp_path):
    """The files that an unbroken sweep of the stub leaves."""
    run_sweep(stub_spec(name="whole.toml"), tmp_path / "whole")
    return tree(tmp_path / "whole")
