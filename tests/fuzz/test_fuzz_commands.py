"""Command lines with impossible or random values: each ends soon, with one line for an error."""

import dataclasses
import importlib
import shutil

import pytest
from hypothesis import given, strategies as st
from mutations import DATA, answers, cases, tree

from jaxcell.cli import main
from jaxcell.cli.app import COMMANDS


FILES = {
    "map.json": DATA / "maps/lab_a.json",
    "grid.txt": DATA / "maps/maze.txt",
    "graph.json": DATA / "graphs/line.json",
    "sea.nc": DATA / "ocean/gyres.nc",
}
SPEC = 'task = "sweep_stub:stub"\nchunk = 2\n[grid]\nx = [1, 2, 3]\n'
JUNK = {
    "junk.rrd": b"RRF2\xff\0" * 9,
    "junk.jxf": b"\x93jaxcell",
    "empty.json": b"",
    "junk.toml": b"=",
}
# The arguments that commands need.
NEEDED = {
    "cover": ["map.json", "--bounce", "45", "--errors", "turn=1", "--reliability", "0.8"],
    "drift": ["sea.nc"],
    "export": ["map.json", "map.dot"],
    "groups": ["map.json", "--bounce", "45"],
    "localize": ["map.json", "--bounce", "45"],
    "navigate": ["map.json", "--bounce", "45", "--start", "0", "--goal", "1"],
    "patrol graph": ["graph.json"],
    "patrol map": ["map.json"],
    "team": ["map.json", "--bounce", "45"],
}
# Without an error, these commands exceed the time of a test; so an option gets a bad value.
LONG = set(NEEDED) - {"export"}
BAD = ["", " ", "-", "--", "nan", "-1", "x", "é", "nan,nan,nan", ",", "{}", "/", "x" * 300, "=b"]
HOSTILE = [
    *("", " ", "-", "--", "nan", "inf", "-inf", "-1", "-0", "0", "0.5", "1e300", "1e-300", "x"),
    *("9" * 400, "é", "\u202e", "a,b,c", "nan,nan,nan", "1e300,0,0", ",", ",,", "0x10", "None"),
    *("@lab_a", "@x", "@", "[]", "{}", "../x", "no/such/file.json", "/", "/dev/null", "x" * 300),
    *("a=b", "a=", "=b"),
]
GOOD = ["1", "2", "3", "45", "90", "0,0", "0.5,0.5,0", "4,4", *FILES, "spec.toml"]


def options_of(name):
    """The names of the options of a command that do not occupy the machine."""
    fields = {field.name.replace("_", "-") for field in dataclasses.fields(COMMANDS[name])}
    return sorted(fields - {"out", "port", "engine", "workers", "camera", "json", "live"})


@st.composite
def command_lines(draw):
    """A command and its arguments."""
    name = draw(st.sampled_from(sorted(set(COMMANDS) - {"demo", "maps"})))
    files = [*FILES, *JUNK, "spec.toml", "folder", "no-such-file.json", *HOSTILE]
    words = [draw(st.sampled_from(files)) for _ in range(draw(st.sampled_from([1, 1, 1, 0, 2])))]
    if name in NEEDED and draw(st.booleans()):
        words = [*NEEDED[name]]
    for option in draw(st.lists(st.sampled_from([*options_of(name), "x"]), max_size=4)):
        values = st.sampled_from([*HOSTILE, *GOOD]) | st.text(max_size=6)
        count = draw(st.sampled_from([1, 1, 1, 1, 0, 2]))
        words += [f"--{option}", *(draw(values) for _ in range(count))]
    if name in LONG:
        words += [f"--{draw(st.sampled_from(options_of(name)))}", draw(st.sampled_from(BAD))]
    return name, words


@pytest.fixture(scope="session")
def imported():
    """Imports the packages that the first command takes seconds to import."""
    for name in ("bounce", "drift", "optimize", "patrol", "record", "robot", "sweep.tasks"):
        importlib.import_module(f"jaxcell.{name}")


@pytest.fixture(autouse=True)
def folder(monkeypatch, tmp_path, imported):
    """A folder with a file of each kind; no window is opened."""
    monkeypatch.setattr("subprocess.call", lambda *args, **options: 0)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    for name, source in FILES.items():
        shutil.copy(source, tmp_path / name)
    for name, content in JUNK.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "spec.toml").write_text(SPEC)


@cases(60)
@given(command_lines())
def test_random_command_lines_are_answered(capsys, tmp_path, line):
    name, words = line
    out = tmp_path / "out"
    takes_out = any(field.name == "out" for field in dataclasses.fields(COMMANDS[name]))
    words = [*name.split(), *words, *(("--out", out) if takes_out else ())]
    status = answers(main, capsys, *words, out=tmp_path)
    if status == 2:
        assert not out.exists() or not tree(out), tree(out)
    shutil.rmtree(out, ignore_errors=True)
    out.unlink(missing_ok=True)


MAPPED = ["cover", "groups", "localize", "navigate", "team", "patrol map"]
# Numbers beyond a `Limit` are tested in `tests/study/test_every_study.py`.
IMPOSSIBLE = [
    *((name, "cell", value) for name in MAPPED for value in ("1e-9", "1e-300", "5e-324", "1e300")),
    *((name, "directions", 10**9) for name in ("cover", "groups", "localize", "navigate", "team")),
    *((name, "directions", 10**30) for name in ("cover", "groups", "localize")),
    *(("localize", "bounce", value) for value in ("inf", "1e300")),
    ("localize", "robot-radius", "1e300"),
    *(("team", "robots", value) for value in (0, -1, 10**6, 10**30)),
    ("localize", "seed", -1),
    *(("localize", "start", value) for value in ("nan,0,0", "1e300,0,0", "10" * 20, "-1")),
]


@pytest.mark.parametrize(("name", "option", "value"), IMPOSSIBLE)
def test_impossible_numbers_are_refused(capsys, tmp_path, name, option, value):
    words = [*name.split(), *NEEDED[name], f"--{option}", value, "--out", tmp_path / "out"]
    assert answers(main, capsys, *words, out=tmp_path) == 2
