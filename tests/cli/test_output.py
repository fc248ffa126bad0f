"""What all commands have in common: where they write, in which order, and how they refuse."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxcell.cli
from jaxcell import bundled
from jaxcell.automata import Filter, subset_construction
from jaxcell.cli import main
from jaxcell.cli.app import COMMANDS


LAB, GRAPH = str(bundled("maps/lab_a.json")), str(bundled("graphs/eight.json"))
# What each command that writes needs besides the place.
WRITING = {
    "cover": [LAB, "--bounces", "45", "--error", "45", "--reliability", "0.8"],
    "demo": [],
    "drift": [str(bundled("ocean/gyres.nc"))],
    "drifters": [str(bundled("ocean/drifters.nc"))],
    "dynamics": ["duffing"],
    "groups": [LAB, "--bounce", "45"],
    "localize": [LAB, "--bounce", "45"],
    "navigate": [LAB, "--bounces", "45", "--start", "0", "--goal", "1"],
    "patrol graph": [GRAPH],
    "patrol map": [LAB],
    "robot replay": ["{log}"],
    "robot run": ["{filter}", "--simulate", LAB],
    "robot sketch": ["{filter}"],
    "sweep": ["{spec}"],
    "sweep view": ["{folder}"],
    "team": [LAB, "--robots", "2", "--bounce", "45"],
}
FILES = {"robot sketch": "a.ino", "sweep view": "a.rrd"}


@pytest.fixture
def given(tmp_path):
    """Files that commands read, by their names in `WRITING`."""
    found = {name: tmp_path / name for name in ("filter", "spec", "folder", "log")}
    found["filter"] = tmp_path / "filter.jxf"
    spec = {"cell_m": 1.0, "directions": 4, "step_m": 1.0, "robot_radius_m": 0.0, "bounce_deg": 90}
    image, bumped = [0, 0, 1], [True, False, False]
    built = subset_construction(np.int32(image), np.array(bumped))
    Filter.of(built, metadata=spec).save(found["filter"])
    found["spec"].write_text('task = "sweep_stub:stub"\n[grid]\nx = [1, 2, 3]\n')
    return {name: str(path) for name, path in found.items()}


def test_every_command_that_writes_is_among_those_tested():
    assert {name for name, kind in COMMANDS.items() if hasattr(kind, "out")} == set(WRITING)


@pytest.mark.parametrize("command", [*WRITING, "export"])
@pytest.mark.parametrize("where", ["below a file", "system", "a file for a folder"])
def test_a_place_that_cannot_be_written_is_refused_first(
    tmp_path, given, monkeypatch, capsys, command, where
):
    (tmp_path / "file").touch()
    name = FILES.get(command, "a.dot" if command == "export" else "out")
    place = tmp_path / "file" / name if where == "below a file" else Path("/proc/none", name)
    if where == "a file for a folder":
        place = tmp_path / name
        if command in (*FILES, "export"):
            place.mkdir()
        else:
            place.touch()
    if command == "export":
        monkeypatch.setattr(Filter, "load", _computed)
        arguments = ["export", given["filter"], str(place)]
    else:
        monkeypatch.setattr(COMMANDS[command], "run", _computed)
        words = [word.format(**given) for word in WRITING[command]]
        arguments = [*command.split(), *words, "--out", str(place)]
    assert main(arguments) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"jaxcell {command}: ")
    assert str(place) in told
    assert "Errno" not in told
    assert told.count("\n") == 1


def _computed(*_):
    raise AssertionError("it went on")


@pytest.mark.parametrize("command", [*COMMANDS])
@pytest.mark.parametrize("read", ["nothing", "folder", "empty"])
def test_no_command_shows_numbers_of_system_errors(tmp_path, capsys, command, read):
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "empty.json").touch()
    path = str(tmp_path / f"{read}.json")
    arguments = {
        **{name: [path, *words[1:]] for name, words in WRITING.items()},
        "export": [path, str(tmp_path / "a.dot")],
        "info": [path],
        "robot calibrate": ["--port", path],
        "robot check": ["--port", path],
        "run": [path],
        "robot run": [path, "--simulate", LAB],
        "sweep indices": [path],
        "sweep merge": [path],
        "sweep status": [path],
        "sweep verify": [path],
        "sweep view": [path],
        "view": [path],
    }
    if command in ("demo", "docs", "maps"):
        pytest.skip("it reads nothing")
    assert main([*command.split(), *arguments[command]]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"jaxcell {command}: ")
    assert f"{read}.json" in told or command in ("robot calibrate", "robot check")
    assert "Errno" not in told
    assert told.count("\n") == 1


def test_output_keeps_its_order_in_one_file():
    code = """
from jaxcell.cli.terminal import note, say, table
for i in range(3):
    say(f"said {i}")
    note(f"noted {i} :x: [b]")
    table(f"shown {i}", ("a column",), [(1,)])
"""
    together = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    told = subprocess.run([sys.executable, "-c", code], check=True, **together).stdout.splitlines()
    told = [line for line in told if line.startswith(("said", "noted", "shown"))]
    expected = [(f"said {i}", f"noted {i} :x: [b]", f"shown {i}") for i in range(3)]
    assert [line.strip() for line in told] == [line for lines in expected for line in lines]


def test_what_people_read_is_printed_in_one_way():
    """Python keeps what `print` is given until the end where no terminal is."""
    for path in Path(jaxcell.cli.__file__).parent.glob("*.py"):
        tree = ast.parse(path.read_text())
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
        names = {node.func.id for node in calls if isinstance(node.func, ast.Name)}
        for call in calls:
            if not isinstance(call.func, ast.Name) or call.func.id != "print":
                continue
            text = ast.unparse(call)
            alone = text.startswith("print(json.dumps(") or "file=sys.stderr" in text
            assert alone or "flush=True" in text or not names & {"table", "note", "show"}, text
