"""Maps beside a specification are found by runs, digests, resumes, repairs and views alike."""

import shutil
from pathlib import Path

import pytest
from sweep_kills import damage_chunk

import jaxcell.cli.sweep.view
from jaxcell.cli import main
from jaxcell.study import Drift
from jaxcell.sweep import Spec, run_sweep, sweep_status, verify_sweep
from jaxcell.sweep.storage.digests import digests
from jaxcell.sweep.storage.store import SweepStore
from jaxcell.sweep.study_task import read_study
from jaxcell.sweep.workers.work import with_files_found


LAB = Path(__file__).parents[2] / "data" / "maps" / "lab_a.json"


@pytest.fixture
def study(tmp_path, monkeypatch):
    """A specification in one folder with its map in another, and nothing in the current one."""
    (tmp_path / "study" / "maps").mkdir(parents=True)
    (tmp_path / "study" / "specs").mkdir()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    shutil.copy(LAB, tmp_path / "study" / "maps")
    (tmp_path / "study" / "specs" / "spec.toml").write_text(
        'task = "groups"\nchunk = 1\n[fixed]\nmap = "../maps/lab_a.json"\n'
        "[grid]\nbounce = [45, 135]\n"
    )
    return tmp_path / "study"


def test_a_store_and_the_files_of_its_specification_can_be_moved_together(study, tmp_path):
    spec = Spec.load("../study/specs/spec.toml")
    run_sweep(spec, study / "runs" / "out", chunks=[])
    shutil.move(study, tmp_path / "moved")
    with SweepStore(tmp_path / "moved" / "runs" / "out") as store:
        kept = store.spec
    assert kept.fixed == spec.fixed
    resolved = with_files_found(kept)
    assert Path(resolved.fixed["map"]).samefile(tmp_path / "moved" / "maps" / "lab_a.json")
    assert set(digests(kept)) == {"../maps/lab_a.json"}


def test_maps_are_found_relative_to_the_specification(study, tmp_path, monkeypatch, capsys):
    spec, out = Spec.load("../study/specs/spec.toml"), tmp_path / "runs" / "out"
    run_sweep(spec, out, chunks=[0])
    assert main(["sweep", "../study/specs/spec.toml", "--out", str(out), "--resume"]) == 0
    for path in out.rglob("*"):
        assert not path.is_file() or str(tmp_path).encode() not in path.read_bytes(), path
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    damage_chunk(out, 1)
    (out / "sweep.zarr" / "bounce" / "c" / "0").unlink()
    assert verify_sweep(out, mend=True).whole
    assert sweep_status(out).complete
    copy = (study / "maps" / "lab_a.json").read_bytes()
    (study / "maps" / "lab_a.json").write_bytes(copy + b"\n")
    spec = Spec.load("../study/specs/spec.toml")
    message = r"with other versions or files \(\.\./maps/lab_a\.json: \w+ there"
    with pytest.raises(ValueError, match=message):
        run_sweep(spec, out, resume=True)


def test_a_member_is_viewed_from_anywhere(study, tmp_path, monkeypatch):
    monkeypatch.setattr(jaxcell.cli.sweep.view, "has_display", lambda: False)
    out = tmp_path / "runs" / "out"
    run_sweep(Spec.load("../study/specs/spec.toml"), out)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert main(["sweep", "view", str(out), "--select", "bounce=45"]) == 0
    (recording,) = (out / "members").iterdir()
    assert str(tmp_path).encode() not in recording.read_bytes()


def test_all_files_of_a_list_are_found(study):
    shutil.copy(LAB, study / "maps" / "lab_b.json")
    files = '["../maps/lab_a.json", "../maps/lab_b.json"]'
    spec = study / "specs" / "drift.toml"
    spec.write_text(f'task = "drift"\n[fixed]\nfile = {files}\n[grid]\nduration = [3600.0]\n')
    resolved = with_files_found(Spec.load(spec)).fixed["file"]
    assert [Path(file).name for file in resolved] == ["lab_a.json", "lab_b.json"]
    assert all(Path(file).is_absolute() for file in resolved)
    asked = read_study(Drift, {"file": resolved})
    assert asked.file == tuple(map(Path, resolved))
    assert read_study(Drift, {"file": resolved[0]}).file == (Path(resolved[0]),)


def test_files_are_found_relative_to_the_specification_or_the_current_folder(tmp_path, monkeypatch):
    there, here = tmp_path / "specs", tmp_path / "here"
    for path in (there / "a.json", there / "both.json", here / "both.json", here / "b.json"):
        path.parent.mkdir(exist_ok=True)
        path.touch()
    monkeypatch.chdir(here)
    maps = f'["a.json", "both.json", "../here/b.json", "b.json", "{tmp_path}/none.json"]'
    (there / "spec.toml").write_text(
        f'task = "groups"\n[fixed]\ncollision = "swept"\n[grid]\nbounce = [1]\nmap = {maps}\n'
    )
    spec = Spec.load("../specs/spec.toml")
    resolved = with_files_found(spec)
    assert resolved.parameters[1].values.tolist() == [
        *(f"{there}/{name}" for name in ("a.json", "both.json", "../here/b.json")),
        f"{here}/b.json",
        f"{tmp_path}/none.json",
    ]
    assert resolved.fixed == {"collision": "swept"}
    text = (there / "spec.toml").read_text().replace('"b.json"', '"c.json"')
    (there / "spec.toml").write_text(text)
    with pytest.raises(
        ValueError, match=rf"spec.toml: map: there is no file 'c.json' in {there} nor in {here}"
    ):
        run_sweep(Spec.load("../specs/spec.toml"), tmp_path / "out")
