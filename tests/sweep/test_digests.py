"""What members read is the same when a sweep is gone on with, or it is told what is not."""

import importlib
import json
import sys

import numpy as np
import pytest
from PIL import Image

from jaxcell.cli import main
from jaxcell.sweep import Spec, open_sweep, run_sweep, verify_sweep
from jaxcell.sweep.storage.digests import digests


TASK = """
from pathlib import Path
import numpy as np, xarray as xr
def task(batch, fixed, seed):
    number = [float(Path(name).read_text()) for name in batch["name"]]
    return xr.Dataset({"value": ("member", np.array(number) * FACTOR)})
"""


@pytest.fixture
def begun(tmp_path, monkeypatch):
    """A sweep of three files, of which the last two chunks are still to do."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "user_task.py").write_text(TASK.replace("FACTOR", "1"))
    importlib.invalidate_caches()
    for name in "123":
        (tmp_path / f"{name}.txt").write_text(name)
    (tmp_path / "spec.toml").write_text(
        'task = "user_task:task"\nchunk = 1\n[grid]\nname = ["1.txt", "2.txt", "3.txt"]\n'
    )
    monkeypatch.delitem(sys.modules, "user_task", raising=False)
    spec = Spec.load("spec.toml")
    run_sweep(spec, "out", chunks=[0])
    yield spec
    sys.modules.pop("user_task", None)


def test_a_file_that_was_changed_is_told(begun, tmp_path, capsys):
    (tmp_path / "1.txt").write_text("7")
    (tmp_path / "3.txt").unlink()
    with pytest.raises(ValueError, match="out: begun with others: ") as told:
        run_sweep(begun, "out", resume=True)
    assert r"1.txt: 6b86b273ff34 there, 7902699be42c here" in str(told.value)
    assert r"3.txt: 4e07408562be there, no such file here" in str(told.value)
    assert "2.txt" not in str(told.value)
    assert main(["sweep", "spec.toml", "--out", "out", "--resume"]) == 2
    assert "1.txt: 6b86b273ff34 there" in capsys.readouterr().err
    (tmp_path / "1.txt").write_text("1")
    (tmp_path / "3.txt").write_text("3")
    assert run_sweep(begun, "out", resume=True).complete
    with open_sweep("out") as dataset:
        assert dataset.value.values.tolist() == [1, 2, 3]
        assert "resumed_anyway" not in dataset.attrs


def test_the_module_of_a_task_that_was_changed_is_told(begun, tmp_path):
    (tmp_path / "user_task.py").write_text(TASK.replace("FACTOR", "2"))
    with pytest.raises(ValueError, match=r"task user_task:task: \w{12} there, \w{12} here"):
        run_sweep(begun, "out", resume=True)


def test_a_run_that_goes_on_anyway_says_so(begun, tmp_path, capsys):
    (tmp_path / "1.txt").write_text("7")
    assert main(["sweep", "spec.toml", "--out", "out", "--anyway"]) == 2
    assert "--anyway: expected with --resume" in capsys.readouterr().err
    assert main(["sweep", "spec.toml", "--out", "out", "--resume", "--anyway"]) == 0
    (tmp_path / "2.txt").write_text("8")
    assert run_sweep(begun, "out", resume=True, anyway=True).complete
    with open_sweep("out") as dataset:
        assert dataset.value.values.tolist() == [1, 2, 3]
        told = json.loads(dataset.attrs["resumed_anyway"])
    assert [line.partition(":")[0] for line in told] == ["1.txt", "2.txt"]
    # The files are those of the last run now.
    assert run_sweep(begun, "out", resume=True).complete
    assert verify_sweep("out").damaged == ()


def test_damage_is_not_mended_with_other_files(begun, tmp_path):
    path = tmp_path / "out" / "sweep.zarr" / "value" / "c" / "0"
    path.write_bytes(b"?" + path.read_bytes()[1:])
    (tmp_path / "1.txt").write_text("7")
    with pytest.raises(ValueError, match=r"damaged \(chunk 0: value\), and begun with others: 1.t"):
        verify_sweep("out")
    (tmp_path / "1.txt").write_text("1")
    assert verify_sweep("out").whole


def test_a_task_that_cannot_be_found_is_told_where_it_is_needed(begun, tmp_path, monkeypatch):
    (tmp_path / "user_task.py").unlink()
    monkeypatch.delitem(sys.modules, "user_task")
    importlib.invalidate_caches()
    assert verify_sweep("out").damaged == ()
    (tmp_path / "out" / "sweep.zarr" / "value" / "c" / "0").unlink()
    with pytest.raises(ValueError, match=r"task user_task:task: .* there, no such file here"):
        verify_sweep("out")


def test_files_that_are_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Image.fromarray(np.zeros((2, 2), np.uint8)).save("room.pgm")
    for name, text in {"a.yaml": "image: room.pgm", "b.json": "{}", "c.nc": "x"}.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "folder").mkdir()
    (tmp_path / "beside").mkdir()
    (tmp_path / "beside" / "spec.toml").write_text(
        'task = "groups"\n[fixed]\nfiles = ["c.nc", {one = "../b.json"}]\nword = "folder"\n'
        '[grid]\nmap = ["a.yaml", "none.json", "b.json"]\n'
    )
    found = digests(Spec.load("beside/spec.toml"))
    assert set(found) == {"a.yaml", "room.pgm", "b.json", "../b.json", "c.nc"}
    assert found["b.json"] == found["../b.json"]
    (tmp_path / "room.pgm").write_bytes(b"")
    again = digests(Spec.load("beside/spec.toml"))
    assert {name for name in found if found[name] != again[name]} == {"room.pgm"}


def test_the_image_of_a_map_may_lie_anywhere(tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "specs").mkdir()
    image = tmp_path / "images" / "room.pgm"
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(image)
    (tmp_path / "specs" / "whole.yaml").write_text(f"image: {image}")
    (tmp_path / "specs" / "near.yaml").write_text("image: ../images/room.pgm")
    (tmp_path / "specs" / "spec.toml").write_text(
        'task = "groups"\n[grid]\nmap = ["whole.yaml", "near.yaml"]\n'
    )
    found = digests(Spec.load(tmp_path / "specs" / "spec.toml"))
    assert set(found) == {"whole.yaml", "near.yaml", "../images/room.pgm", str(image)}
