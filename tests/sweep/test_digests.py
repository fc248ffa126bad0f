"""Files and modules that members read must be unchanged when a sweep is resumed."""

import importlib
import json
import sys

import numpy as np
import pytest
from PIL import Image
from sweep_kills import damage_chunk

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
def importable(tmp_path, monkeypatch):
    """Modules are imported from the current folder, and leave nothing there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)


@pytest.fixture
def begun(importable, tmp_path, monkeypatch):
    """A sweep of three files, of which the last two chunks are still to do."""
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


def test_a_changed_file_is_refused(begun, tmp_path, capsys):
    (tmp_path / "1.txt").write_text("7")
    (tmp_path / "3.txt").unlink()
    with pytest.raises(ValueError, match="out: made with other versions or files ") as caught:
        run_sweep(begun, "out", resume=True)
    assert r"1.txt: 6b86b273ff34 there, 7902699be42c here" in str(caught.value)
    assert r"3.txt: 4e07408562be there, no such file here" in str(caught.value)
    assert "2.txt" not in str(caught.value)
    assert main(["sweep", "spec.toml", "--out", "out", "--resume"]) == 2
    assert "1.txt: 6b86b273ff34 there" in capsys.readouterr().err
    (tmp_path / "1.txt").write_text("1")
    (tmp_path / "3.txt").write_text("3")
    assert run_sweep(begun, "out", resume=True).complete
    with open_sweep("out") as dataset:
        assert dataset.value.values.tolist() == [1, 2, 3]
        assert "resumed_anyway" not in dataset.attrs


def test_a_changed_module_of_the_task_is_refused(begun, tmp_path):
    (tmp_path / "user_task.py").write_text(TASK.replace("FACTOR", "2"))
    with pytest.raises(ValueError, match=r"task user_task:task: \w{12} there, \w{12} here"):
        run_sweep(begun, "out", resume=True)


@pytest.fixture
def package(importable, tmp_path):
    """A task in a package of modules, of which one is imported within a function."""
    files = {
        "lab_pkg/__init__.py": "",
        "lab_pkg/task.py": "from . import walls\nfrom .deep.angles import *\n" + TASK,
        "lab_pkg/walls.py": "import json, numpy, jaxcell\nimport lab_beside.far\nSIDE = 1\n",
        "lab_pkg/deep/angles.py": "def angle():\n    import lab_late\n    return lab_late.ANGLE\n",
        "lab_beside/far.py": "import lab_pkg.task\n",
        "lab_late.py": "ANGLE = 1\n",
        "lab_unused.py": "ANGLE = 2\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text.replace("FACTOR", "1"))
    (tmp_path / "1.txt").write_text("1")
    (tmp_path / "2.txt").write_text("2")
    (tmp_path / "spec.toml").write_text(
        'task = "lab_pkg.task:task"\nchunk = 1\n[grid]\nname = ["1.txt", "2.txt"]\n'
    )
    importlib.invalidate_caches()
    yield Spec.load("spec.toml")
    for name in [one for one in sys.modules if one.partition(".")[0].startswith("lab_")]:
        del sys.modules[name]


def test_the_modules_that_a_task_imports_are_digested(package):
    assert set(digests(package)) == {
        "task lab_pkg.task:task",
        "1.txt",
        "2.txt",
        "module lab_beside.far (far.py)",
        "module lab_late (lab_late.py)",
        "module lab_pkg (__init__.py)",
        "module lab_pkg.deep.angles (angles.py)",
        "module lab_pkg.walls (walls.py)",
    }
    assert not any(name.startswith("lab_") for name in sys.modules), "nothing is imported for it"


@pytest.mark.parametrize(
    ("file", "module"),
    [
        ("lab_pkg/walls.py", "lab_pkg.walls"),
        ("lab_pkg/__init__.py", "lab_pkg"),
        ("lab_beside/far.py", "lab_beside.far"),
        ("lab_late.py", "lab_late"),
    ],
)
def test_an_edited_module_that_a_task_imports_is_refused(package, tmp_path, file, module):
    run_sweep(package, "out", chunks=[0])
    with open(tmp_path / file, "a") as source:
        source.write("# edited\n")
    digest = rf"or files \(module {module} \({file.rpartition('/')[2]}\): \w{{12}} there, "
    with pytest.raises(ValueError, match=digest):
        run_sweep(package, "out", resume=True)
    assert run_sweep(package, "out", resume=True, anyway=True).complete
    with open_sweep("out") as dataset:
        (message,) = json.loads(dataset.attrs["resumed_anyway"])
    assert message.startswith(f"module {module} ")


def test_an_edited_module_that_the_task_does_not_import_is_not_refused(package, tmp_path):
    run_sweep(package, "out", chunks=[0])
    (tmp_path / "lab_unused.py").write_text("ANGLE = 3\n")
    assert run_sweep(package, "out", resume=True).complete


def test_the_file_of_a_system_and_what_it_imports_are_digested(package, tmp_path):
    (tmp_path / "system.py").write_text("import lab_late\n")
    (tmp_path / "spec.toml").write_text(
        'task = "dynamics"\n[fixed]\nsystem = "system.py:mine"\n[grid]\n'
        'params = ["lab_late:T", "json:loads", "no such:module", ":"]\n'
    )
    assert set(digests(Spec.load("spec.toml"))) == {
        "system.py:mine",
        "module lab_late (lab_late.py)",
        "lab_late:T",
    }


def test_the_result_lists_changes_of_a_sweep_resumed_anyway(begun, tmp_path, capsys):
    (tmp_path / "1.txt").write_text("7")
    assert main(["sweep", "spec.toml", "--out", "out", "--anyway"]) == 2
    assert "--anyway: it has an effect only with --resume" in capsys.readouterr().err
    assert main(["sweep", "spec.toml", "--out", "out", "--resume", "--anyway"]) == 0
    (tmp_path / "2.txt").write_text("8")
    assert run_sweep(begun, "out", resume=True, anyway=True).complete
    with open_sweep("out") as dataset:
        assert dataset.value.values.tolist() == [1, 2, 3]
        message = json.loads(dataset.attrs["resumed_anyway"])
    assert [line.partition(":")[0] for line in message] == ["1.txt", "2.txt"]
    # The files are those of the last run now.
    assert run_sweep(begun, "out", resume=True).complete
    assert verify_sweep("out", mend=True).damaged == ()


def test_a_missing_task_is_refused_only_if_chunks_have_to_be_computed(begun, tmp_path, monkeypatch):
    (tmp_path / "user_task.py").unlink()
    monkeypatch.delitem(sys.modules, "user_task")
    importlib.invalidate_caches()
    assert verify_sweep("out", mend=True).damaged == ()
    damage_chunk(tmp_path / "out", 0)
    with pytest.raises(ValueError, match=r"task user_task:task: .* there, no such file here"):
        verify_sweep("out", mend=True)


def test_files_that_members_read_are_digested(tmp_path, monkeypatch):
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


def test_the_image_of_a_map_may_have_any_path(tmp_path):
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
