"""Command lines with impossible values, which are refused before a long computation."""

import pytest
from mutations import DATA, answers

from jaxcell.cli import main


LAB, GRAPH, SEA = DATA / "maps/lab_a.json", DATA / "graphs/line.json", DATA / "ocean/gyres.nc"
COMMANDS = {
    "cover": [LAB, "--bounces", 45, "--error", 1, "--reliability", 0.8],
    "drift": [SEA],
    "export": [LAB, "x.dot"],
    "groups": [LAB, "--bounce", 45],
    "info": [LAB],
    "localize": [LAB, "--bounce", 45],
    "navigate": [LAB, "--bounces", 45, "--start", 0, "--goal", 1],
    "patrol graph": [GRAPH],
    "patrol map": [LAB],
    "robot check": ["--port", "no-such-port"],
    "robot replay": [LAB],
    "robot run": [LAB, "--simulate", LAB],
    "robot sketch": [LAB],
    "sweep": [LAB],
    "sweep indices": [LAB],
    "sweep merge": [LAB],
    "sweep status": [LAB],
    "sweep verify": [LAB],
    "team": [LAB, "--bounces", 45],
    "view": [LAB],
}


@pytest.fixture(autouse=True)
def _own_folder(monkeypatch, tmp_path, imported):
    monkeypatch.chdir(tmp_path)


MAPPED = ["cover", "groups", "localize", "navigate", "team", "patrol map"]


@pytest.mark.parametrize("name", MAPPED)
@pytest.mark.parametrize("cell", ["nan", "inf", "-1", "0", "1e-9", "1e-300", "5e-324", "1e300"])
def test_impossible_cells_are_refused(capsys, tmp_path, name, cell):
    args = [*name.split(), *COMMANDS[name], "--cell", cell, "--out", tmp_path / "out"]
    assert answers(main, capsys, *args, out=tmp_path) == 2


HUGE = [
    *((name, "directions", 10**9) for name in ("cover", "groups", "localize", "navigate", "team")),
    *((name, "directions", 10**30) for name in ("cover", "groups", "localize")),
    *((name, "directions", value) for name in ("groups", "localize") for value in (0, -1)),
    *(("localize", "bounce", value) for value in ("nan", "inf", "1e300")),
    *(("localize", "step", value) for value in ("nan", "inf", "-1")),
    *(("localize", "robot-radius", value) for value in ("nan", "inf", "-1", "1e300")),
    *(("team", "robots", value) for value in (0, -1, 10**6, 10**30)),
    *(("localize", "seed", value) for value in (-1,)),
    *(("localize", "start", value) for value in ("nan,0,0", "1e300,0,0", "10" * 20, "-1")),
    *(("patrol map", "robots", value) for value in (0, -1)),
    *(("patrol map", "range", value) for value in ("nan", "-1", "inf")),
    *(("patrol map", "runs", value) for value in (0, -1, 10**12)),
    *(("patrol graph", "robots", value) for value in (0, -1)),
    *(("drift", "rho", value) for value in ("nan", "-1", "2")),
    *(("drift", "duration", value) for value in ("nan", "inf", "0")),
    *(("drift", "discount", value) for value in ("nan", "1", "0")),
]


@pytest.mark.parametrize(("name", "option", "value"), HUGE)
def test_impossible_numbers_are_refused(capsys, tmp_path, name, option, value):
    args = [*name.split(), *COMMANDS[name], f"--{option}", value, "--out", tmp_path / "out"]
    assert answers(main, capsys, *args, out=tmp_path) == 2
