"""`jaxcell verify` finds damage and mixed runs of any command, and computes results again."""

import json
import os
import re
import shutil
from pathlib import Path

import pytest
from helpers import run

from jaxcell.automata.formats.storage import read_arrays
from jaxcell.cli import main
from jaxcell.cli.view import recordings_in


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    out = tmp_path_factory.mktemp("sound") / "lab"
    assert main(["localize", "@lab_a", "--bounce", "135", "--out", str(out)]) == 0
    return out


@pytest.fixture
def out(sound, tmp_path):
    return shutil.copytree(sound, tmp_path / "lab")


def test_a_result_is_intact_and_every_file_has_its_run(out, capsys):
    status, report, _ = run(capsys, "verify", out)
    assert status == 0
    (result,) = report["results"]
    assert result["damaged"] == []
    assert result["checked"] == len([*out.iterdir()]) - 1
    for path in out.iterdir():
        content = path.read_bytes()
        if path.suffix == ".jxf":
            content = json.dumps(read_arrays(path)[0]).encode()
        assert path.suffix == ".rrd" or result["run_id"].encode() in content, path


def test_damage_is_named_and_computed_again(out, sound, capsys):
    with (out / "localization.nc").open("r+b") as file:
        file.seek(5000)
        file.write(bytes([file.read(1)[0] ^ 1]))
    (out / "filter.jxf").unlink()
    status, report, _ = run(capsys, "verify", out)
    assert (status, report["whole"]) == (1, False)
    assert report["results"][0]["damaged"] == ["filter.jxf", "localization.nc"]
    status, report, _ = run(capsys, "verify --mend", out)
    assert (status, report["results"][0]["mended"]) == (0, 2)
    assert run(capsys, "verify", out)[0] == 0


def test_a_mixture_of_two_runs_is_refused_by_all_commands_that_read_it(out, tmp_path, capsys):
    other = tmp_path / "other"
    assert main(["localize", "@lab_a", "--bounce", "45", "--out", str(other)]) == 0
    os.replace(other / "filter.jxf", out / "filter.jxf")
    task = out / "filter.jxf"
    for words in (
        ["view", out],
        ["doctor", out],
        ["doctor", task],
        ["robot", "run", task, "--simulate", "@lab_a", "--heading", "0"],
        ["robot", "sketch", task, "--heading", "0"],
        ["export", task, tmp_path / "filter.dot"],
    ):
        capsys.readouterr()
        assert main([*map(str, words)]) == 2, words
        assert "filter.jxf: not the files that run" in capsys.readouterr().err, words
    # A file that was copied to another folder is used.
    shutil.copy(task, tmp_path / "alone.jxf")
    assert main(["doctor", str(tmp_path / "alone.jxf")]) == 0


def test_a_result_whose_input_changed_is_not_computed_again(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "map.txt").write_text("#####\n#...#\n#...#\n#####\n")
    assert main(["groups", "map.txt", "--bounce", "90", "--out", "out"]) == 0
    (tmp_path / "out" / "groups.nc").unlink()
    (tmp_path / "map.txt").write_text("#####\n#...#\n#.#.#\n#####\n")
    capsys.readouterr()
    assert main(["verify", "--mend", "out"]) == 2
    assert "its input map.txt has changed since" in capsys.readouterr().err


def test_folders_without_results_are_refused(tmp_path, capsys):
    assert main(["verify", str(tmp_path)]) == 2
    assert "expected the folder of a result, with a result.json" in capsys.readouterr().err


def test_runs_of_robots_are_checked_and_not_mixed(tmp_path, capsys):
    lab = ["localize", "@lab_a", "--bounce", "135"]
    assert main([*lab, "--out", str(tmp_path / "lab")]) == 0
    run = ["robot", "run", str(tmp_path / "lab" / "filter.jxf"), "--simulate", "@lab_a"]
    run += ["--speedup", "9999"]
    for name, start in (("one", "0"), ("two", "1")):
        words = [*run, "--start", start, "--heading", "0", "--out", str(tmp_path / name)]
        assert main(words) == 0
    capsys.readouterr()
    replay = ["robot", "replay", str(tmp_path / "one" / "run.jsonl"), "--out"]
    assert main([*replay, str(tmp_path / "two")]) == 2
    assert "two: it has the files of another run" in capsys.readouterr().err
    assert main(["verify", str(tmp_path)]) == 0
    assert main([*replay, str(tmp_path / "one")]) == 0
    assert main(["verify", str(tmp_path)]) == 0
    for name in ("run.jsonl", "run.rrd", "summary.json"):
        path = tmp_path / "one" / name
        whole = path.read_bytes()
        path.write_bytes(bytes([whole[0] ^ 1]) + whole[1:])
        assert main(["verify", str(tmp_path)]) == 1
        path.write_bytes(whole)
    assert main(["verify", str(tmp_path)]) == 0


def test_every_damage_has_a_way_on(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = "localize @lab_a --bounce 135 --out lab"
    assert main(line.split()) == 0
    Path("lab/localization.nc").unlink()
    assert main(["verify", "lab"]) == 1
    again = r"\nlab: to compute it again: .*jaxcell'? verify --mend lab\n"
    assert re.search(again, capsys.readouterr().err)
    assert main(["verify", "--mend", "lab"]) == 0
    for name in ("cover.rrd", ".hidden"):
        Path("lab", name).write_text("mine")
    capsys.readouterr()
    assert main(["verify", "lab"]) == 0
    assert "lab: not checked, because not of this result: cover.rrd\n" in capsys.readouterr().err
    assert main(["verify", "lab", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["results"][0]["unlisted"] == ["cover.rrd"]
    Path("lab/result.json").write_text("")
    assert main(["verify", "--mend", "lab"]) == 1
    said = capsys.readouterr().err
    assert "\nlab: its other files were not checked" in said
    assert "replace the result, run its command again with --out lab\n" in said
    assert main(line.split()) == 0
    assert main(["verify", "lab"]) == 0


def test_a_run_of_a_robot_is_made_again_from_its_log(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["localize", "@lab_a", "--bounce", "135", "--out", "lab"]) == 0
    robot = "robot run lab/filter.jxf --simulate @lab_a --start 0 --heading 0 --speedup 9999 --out"
    assert main([*robot.split(), "one"]) == 0
    assert json.loads(Path("one/result.json").read_text())["options"]["confirm"] == 30
    (tmp_path / "one" / "summary.json").write_text("{}")
    (tmp_path / "lab" / "groups.nc").unlink()
    capsys.readouterr()
    # Other results are mended all the same.
    assert main(["verify", "--mend", "."]) == 1
    said = capsys.readouterr().err
    assert "jaxcell robot replay one/run.jsonl --out NEW" in said
    assert main(["verify", "lab"]) == 0
    replay = ["robot", "replay", "one/run.jsonl", "--out"]
    assert main([*replay, "one"]) == 2
    assert main([*replay, "NEW"]) == 0
    assert main(["verify", "NEW"]) == 0
    with (tmp_path / "one" / "run.jsonl").open("a") as log:
        log.write("\n")
    capsys.readouterr()
    assert main(["verify", "--mend", "one"]) == 1
    assert "jaxcell robot run lab/filter.jxf" in capsys.readouterr().err


def test_files_of_other_runs_that_are_not_listed_are_refused(out, tmp_path, capsys):
    other = tmp_path / "other"
    assert main(["localize", "@lab_a", "--bounce", "45", "135", "--out", str(other)]) == 0
    shutil.copy(other / "policy.jxf", out)
    task = out / "policy.jxf"
    for words in (
        ["doctor", out],
        ["doctor", task],
        ["robot", "run", task, "--simulate", "@lab_a"],
    ):
        assert main([*map(str, words)]) == 2
        assert "policy.jxf: not the files that run" in capsys.readouterr().err
    status, report, _ = run(capsys, "verify", out)
    assert (status, report["results"][0]["damaged"]) == (1, ["policy.jxf"])
    assert report["results"][0]["ways"] == ["move the files of another run elsewhere: policy.jxf"]
    task.unlink()
    (out / "notes.json").write_text('{"mine": 1}')
    assert run(capsys, "verify", out)[0] == 0


def test_a_newer_result_is_not_called_damaged(out, capsys):
    manifest = json.loads((out / "result.json").read_text())
    (out / "result.json").write_text(json.dumps({**manifest, "version": 2}))
    assert main(["verify", str(out)]) == 2
    said = capsys.readouterr().err
    assert "a newer jaxcell wrote it" in said
    assert "--mend" not in said


def test_a_result_is_mended_from_any_folder(tmp_path, monkeypatch, capsys):
    """Results name their inputs relative to the folder in which the command ran."""
    here, other = tmp_path / "here", tmp_path / "elsewhere"
    (here / "maps").mkdir(parents=True)
    other.mkdir()
    (here / "maps" / "room.txt").write_text("...\n.#.\n...\n")
    monkeypatch.chdir(here)
    assert main(["groups", "maps/room.txt", "--bounce", "90", "--out", "runs/room"]) == 0
    capsys.readouterr()
    (here / "runs" / "room" / "groups.nc").unlink()
    monkeypatch.chdir(other)
    status, report, _ = run(capsys, "verify --mend", here / "runs" / "room")
    assert (status, report["results"][0]["mended"]) == (0, 1)
    assert (here / "runs" / "room" / "groups.nc").is_file()


def test_recordings_that_are_not_of_the_result_are_named_when_they_are_shown(out, capsys):
    shutil.copy(out / "localization.rrd", out / "other.rrd")
    assert len(recordings_in(out)) == 2
    assert capsys.readouterr().err.count("not of the result in this folder") == 1
    assert recordings_in(out / "other.rrd") == [out / "other.rrd"]
    assert not capsys.readouterr().err
