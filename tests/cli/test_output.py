"""All commands write, order their output and refuse bad input alike."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import python

from jaxcell import bundled
from jaxcell.automata import Filter, subset_construction
from jaxcell.cli import main
from jaxcell.cli.app import COMMANDS
from jaxcell.cli.help import option
from jaxcell.study import parameters


LAB = str(bundled("maps/lab_a.json"))
# The words of each command that writes, without the place.
WRITING = {
    **{
        name: kind.example.partition(" --out ")[0].split()
        for name, kind in COMMANDS.items()
        if hasattr(kind, "study")
    },
    "demo": [],
    "doctor": [LAB],
    "robot replay": ["{log}"],
    "robot run": ["{filter}", "--simulate", LAB],
    "robot sketch": ["{filter}"],
    "sweep": ["{spec}"],
    "sweep view": ["{folder}"],
}
FILES = {"doctor": "a.png", "robot sketch": "a.ino", "sweep view": "a.rrd"}


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
    printed = capsys.readouterr().err
    assert printed.startswith(f"jaxcell {command}: ")
    assert str(place) in printed
    assert "Errno" not in printed
    assert printed.count("\n") == 1


def _computed(*_):
    raise AssertionError("it went on")


COVER = "--bounce 45 --errors turn=45 --reliability 0.8"
# A line for each file that a command reads, which is not there.
MISSING = [
    "angles none.json --for localize",
    f"cover none.json {COVER}",
    f"cover @lab_a {COVER} --target none.png",
    f"cover @lab_a {COVER} --target none.nc:v",
    "deploy none.nc --drop 2 --until 0.5",
    "deploy @gyres --drop 2 --until 0.5 --cover none.geojson",
    "deploy @gyres --drop 2 --until 0.5 --grid none.nc",
    "deploy @gyres --drop 2 --until 0.5 --land none.geojson",
    "drift none.nc",
    "drift 'none*.nc'",
    "drift @gyres --grid none.nc",
    "drift @gyres --land none.geojson",
    "drift @gyres --regions none.geojson",
    "drifters @drifters none.nc",
    "drifters none.npz",
    "dynamics none.py:x",
    "export none.jxf a.dot",
    "groups none.json --bounce 45",
    "doctor none.json",
    "localize none.json --bounce 45",
    "localize anywhere none.json --bounce 45",
    "localize slip none.json --bounce 45 --errors slip=2%",
    "navigate none.json --bounce 45 --start 0 --goal 1",
    "navigate anywhere none.json --bounce 45 --goal 1,1",
    "navigate slip none.json --bounce 45 --start 0 --goal 1 --errors slip=2%",
    "patrol graph none.json",
    "patrol graph @random --constraints none.json",
    "patrol graph @random --strategy capture --attack-times none.json",
    "patrol graph @random --strategy mixing --visits none.json",
    "patrol graph @random --game --values none.json",
    "patrol map none.json",
    "patrol guard none.json --attack-time 3",
    "patrol guard @random --attack-times none.txt",
    "patrol guard @random --attack-time 3 --values none.txt",
    f"patrol evaluate none.json {__file__}",
    "release none.nc --start=-117.93,33.5 --until 0.5",
    "release @gyres --start none.geojson --until 0.5",
    "release @gyres --start=-117.93,33.5 --grid none.nc --until 0.5",
    "release @gyres --start=-117.93,33.5 --land none.geojson --until 0.5",
    "release @gyres --start=-117.93,33.5 --regions none.geojson --until 0.5",
    "robot calibrate --port none",
    "robot check --port none",
    "robot replay none.jsonl",
    "robot run none.jxf --simulate @lab_a",
    "robot sketch none.jxf",
    "run none.py:Study",
    "sweep none.toml",
    "sweep @rooms --scheduler-file none.json",
    "sweep indices none",
    "sweep merge none",
    "sweep status none",
    "sweep view none",
    "team none.json --bounce 45",
    "verify none",
    "view none",
]


def test_every_file_of_a_command_is_among_the_missing():
    for name, kind in COMMANDS.items():
        lines = [line for line in MISSING if line.startswith(f"{name} ")]
        for parameter, hint in parameters(kind.study).items() if hasattr(kind, "study") else ():
            if "Path" in str(hint):
                said = option(kind, parameter)
                said = said if said.startswith("--") else name
                assert any(f"{said} none" in line or f"{said} @" in line for line in lines), said
        assert lines or hasattr(kind, "study") or name in ("demo", "docs", "maps")


def test_missing_files_are_refused_before_jax_is_loaded(tmp_path):
    program = f"""
import contextlib, io, json, shlex, sys
from jaxcell.cli import main
for line in {MISSING!r}:
    with contextlib.redirect_stderr(io.StringIO()) as printed:
        status = main(shlex.split(line))
    print(json.dumps([line, status, printed.getvalue(), "jax" in sys.modules]))
"""
    printed = python("-c", program, cwd=tmp_path)[0].splitlines()
    assert len(printed) == len(MISSING)
    for line, status, said, loaded in map(json.loads, printed):
        assert status == 2, line
        assert not loaded, line
        last = said.splitlines()[-1]
        assert last.startswith("jaxcell "), said
        assert "none" in last, said


@pytest.mark.parametrize("kind", ["a_folder", "empty"])
@pytest.mark.parametrize("line", MISSING)
def test_folders_and_empty_files_are_refused_in_one_line(tmp_path, monkeypatch, capsys, line, kind):
    monkeypatch.chdir(tmp_path)
    line = re.sub(r"\bnone\b", kind, line)
    name = re.search(rf"{kind}(\.\w+)?", line)[0]
    Path(name).touch() if kind == "empty" else Path(name).mkdir()
    assert main(shlex.split(line)) == 2
    printed = capsys.readouterr().err
    assert re.match(rf"jaxcell [^:]*(:\w+)?: .*{kind}", printed)
    assert "Errno" not in printed
    assert printed.count("\n") == 1


def test_results_are_kept_if_nothing_reads_the_answer(tmp_path):
    out = tmp_path / "groups"
    command = [sys.executable, "-m", "jaxcell", "groups", "@lab_a", "--bounce", "45", "--out", out]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        run.stdout.close()
        assert b"Error" not in run.stderr.read()
    assert run.returncode == 0
    assert json.loads((out / "summary.json").read_text())["command"] == "jaxcell groups"


def test_output_keeps_its_order_in_one_file():
    code = """
from jaxcell.cli.terminal import note, say, table
for i in range(3):
    say(f"said {i}")
    note(f"noted {i} :x: [b]")
    table(f"shown {i}", ("a column",), [(1,)])
"""
    together = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "capture_output": False}
    lines = python("-c", code, **together)[0].splitlines()
    printed = [line for line in lines if line.startswith(("said", "noted", "shown"))]
    expected = [(f"said {i}", f"noted {i} :x: [b]", f"shown {i}") for i in range(3)]
    assert [line.strip() for line in printed] == [line for lines in expected for line in lines]


MODULES = "tyro rich.console shapely numpy jax jax._src.api scipy.linalg jaxcell.record"


@pytest.mark.parametrize("module", MODULES.split())
def test_an_interrupt_during_an_import_ends_without_traceback(module):
    """As if Ctrl-C were pressed when the module is looked for."""
    program = f"""
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
stdout = os.dup(1)
class Interrupting:
    def find_spec(self, name, path, target=None):
        if name == {module!r} and self in sys.meta_path:
            sys.meta_path.remove(self)
            os.write(stdout, b"interrupted")
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
from jaxcell.cli import main
sys.exit(main(["cover", "@lab_a", "--directions", "8", *{COVER.split()!r}]))
"""
    command = [sys.executable, "-c", program]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.stdout == "interrupted"
    # Lines of work that lasts may come before.
    assert [line for line in ended.stderr.splitlines() if " ... (0:" not in line] == []
    assert ended.returncode == 130


@pytest.mark.parametrize("encoding", ["ascii", "ascii:surrogateescape", "cp437", "latin-1"])
def test_a_table_is_printed_in_any_encoding(tmp_path, encoding):
    """All of it, and the files are those of an output in UTF-8."""
    printed = {}
    for one in ("utf-8", encoding):
        words = f"-m jaxcell groups @lab_a --bounce 45 --out {one}".split()
        environment = {**os.environ, "PYTHONIOENCODING": one, "COLUMNS": "120"}
        output, _ = python(*words, cwd=tmp_path, env=environment, text=False)
        printed[one] = output.decode(one.partition(":")[0])
        assert (tmp_path / one / "groups.nc").exists()
    assert "45° " in printed["utf-8"]
    plain = printed[encoding]
    assert ("45 deg" if "ascii" in encoding else "45° ") in plain
    assert len(plain.splitlines()) == len(printed["utf-8"].splitlines())
    if "ascii" in encoding:
        table = [line.rstrip() for line in plain.splitlines() if line.startswith("|")]
        assert len({len(line) for line in table}) == 1, plain


def test_a_map_is_drawn_in_ascii():
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    printed, errors = python("-m", "jaxcell", "maps", env=environment)
    assert errors == ""
    assert printed.isascii()


def test_localize_compiles_nothing_and_imports_little():
    code = (
        "import jax, sys\n"
        "from jaxcell.cli import main\n"
        "compiled = []\n"
        "jax.monitoring.register_event_duration_secs_listener(lambda name, *_, **__:"
        " compiled.append(name) if 'backend_compile' in name else None)\n"
        "jax.jit(lambda x: x + 1)(2.5)\n"
        "assert compiled and not compiled.clear()\n"
        "for cell in ('1', '0.93'):\n"
        "    assert main(['localize', '@lab_a', '--cell', cell, '--bounce', '45']) == 0\n"
        "assert not compiled, compiled\n"
        "assert not {'scipy', 'xarray', 'pandas'} & sys.modules.keys()\n"
    )
    python("-c", code)
