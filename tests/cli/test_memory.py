import os
import re
from pathlib import Path
from unittest.mock import Mock

import pytest
import xarray as xr
from helpers import run

from jaxcell import bundled
from jaxcell.base import memory
from jaxcell.cli import main
from jaxcell.space import CellSpace
from jaxcell.study import map_study


LAB = bundled("maps/lab_a.json")
COMMANDS = {
    "groups": ["--bounce", 45],
    "localize": ["--bounce", 45],
    "navigate": ["--bounce", 45, "--start", 0, "--goal", 1],
    "cover": ["--bounce", 45, "--errors", "turn=1", "--reliability", 0.8],
    "team": ["--bounce", 45],
    "patrol map": [],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_that_need_too_much_memory_are_refused_before_cells_are_cut(
    capsys, monkeypatch, name
):
    # The programs of some take more than that when they are compiled.
    free = 10**9 if name in ("patrol map", "team") else 10**8
    monkeypatch.setattr(memory, "free", lambda: free)
    monkeypatch.setattr(CellSpace, "of", None)
    cell = 0.001 if name in ("groups", "patrol map", "team") else 0.004
    args = [*name.split(), LAB, *COMMANDS[name], "--cell", cell]
    assert main([str(arg) for arg in args]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    (line,) = told.err.splitlines()
    assert line.startswith(f"jaxcell {name}: ")
    assert f"{free / 1e9:.1f} GB are free" in line
    assert line.endswith(" m would fit")


def test_too_few_addresses_for_jax_are_one_line(capsys, monkeypatch):
    left = [(10**9, "ulimit -v allows 1.5 GB of addresses")]
    monkeypatch.setattr(memory, "_addresses", lambda: left)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    assert main(["groups", str(LAB), "--bounce", "45"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == (
        "jaxcell groups: JAX reserves about 1.9 GB of addresses, and 1.0 GB are left: "
        "ulimit -v allows 1.5 GB of addresses"
    )


@pytest.mark.parametrize("error", [MemoryError(), type("Full", (MemoryError,), {})("8 EiB")])
def test_a_library_without_memory_is_answered_with_a_remedy(capsys, monkeypatch, error):
    map_study._cells.cache_clear()
    monkeypatch.setattr(CellSpace, "of", Mock(side_effect=error))
    assert main(["groups", str(LAB), "--bounce", "45"]) == 2
    said = capsys.readouterr().err
    assert re.search(r"the memory is too little( \(8 EiB\))?; fewer or larger cells", said)


@pytest.mark.parametrize("place", [0, 1, 4])
@pytest.mark.parametrize("option", [["--memory", "0.3G"], ["--memory=300M"]])
def test_a_limit_is_an_option_of_all_commands(capsys, monkeypatch, place, option):
    # So that it is as it was after the test.
    monkeypatch.setenv(memory.LIMIT, "")
    monkeypatch.setattr(CellSpace, "of", None)
    # As much as a process takes that ran no test before.
    monkeypatch.setattr(memory, "PROC", Path("/nowhere"))
    args = ["groups", str(LAB), "--bounce", "45", "--cell", "0.001"]
    assert main([*args[:place], *option, *args[place:]]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("jaxcell groups: groups needs about 0.2 GB of memory, and 0.")
    size = option[-1].split("=")[-1]
    assert f": --memory or JAXCELL_MEMORY allows {size}, of which Python and its" in line
    assert line.endswith(" m would fit")
    assert os.environ[memory.LIMIT] == option[-1].split("=")[-1]


def test_a_limit_that_is_no_size_is_refused(capsys, monkeypatch):
    monkeypatch.setenv(memory.LIMIT, "")
    assert main(["groups", str(LAB), "--bounce", "45", "--memory", "much"]) == 2
    said = "jaxcell groups: --memory: expected a size such as 8G or 500M, got 'much'\n"
    assert capsys.readouterr().err == said


def test_numbers_may_fit_where_files_do_not(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "free", lambda: 5 * 10**8)
    monkeypatch.setattr(CellSpace, "of", None)
    args = ["groups", str(LAB), "--bounce", "45", "--cell", "0.001", "--out", str(tmp_path)]
    assert main(args) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("jaxcell groups: groups in files needs about ")
    assert line.endswith(" m would fit; without files, about 0.2 GB would do")


def test_a_sea_and_a_graph_that_do_not_fit_are_refused(capsys, monkeypatch):
    monkeypatch.setattr(memory, "NEGLIGIBLE", 0)
    monkeypatch.setattr(memory, "free", lambda: 300_000)
    assert main(["drift", str(bundled("ocean/gyres.nc")), "--depths", "0"]) == 2
    assert "cells of water needs about" in capsys.readouterr().err
    monkeypatch.setattr(memory, "free", lambda: 60_000)
    assert main(["patrol", "graph", str(bundled("graphs/random.json"))]) == 2
    assert "a walk on 50 vertices and 200 edges needs about" in capsys.readouterr().err


def test_much_memory_is_reported_on_standard_error_only(capsys, monkeypatch):
    monkeypatch.setattr("jaxcell.cli.study_command.MUCH", 1e4)
    _, found, note = run(capsys, "groups", LAB, "--bounce 45")
    assert found["positions"] == 19
    assert note == "groups needs about 0 MB of memory\n"


def test_many_cells_are_written_a_direction_at_a_time(capsys, monkeypatch, tmp_path):
    args = ["groups", str(LAB), "--bounce", "45", "--out"]
    assert main([*args, str(tmp_path / "few")]) == 0
    monkeypatch.setattr("jaxcell.study.bounce.groups.MAX_AT_ONCE", 100)
    assert main([*args, str(tmp_path / "many")]) == 0
    names = {one.name for one in (tmp_path / "many").iterdir()}
    assert names == {"groups.zarr", "result.json", "summary.json"}
    few = xr.open_dataset(tmp_path / "few" / "groups.nc")
    many = xr.open_zarr(tmp_path / "many" / "groups.zarr")
    xr.testing.assert_equal(many.drop_vars("image").load(), few)
    assert many.attrs["spec"] == few.attrs["spec"]
    assert "cells" in many.attrs["spec"]
    capsys.readouterr()
    _, described, _ = run(capsys, "doctor", tmp_path / "many" / "groups.zarr")
    assert described["what"] == "a result of jaxcell: Periodic groups of a bouncing robot"
    assert described["dimensions"]["position"] == 19
    image = "(bounce, direction, position): cell that it is mapped to"
    assert described["variables"]["image"] == image
    _, described, _ = run(capsys, "doctor", tmp_path / "many")
    assert described["files"] == ["groups.zarr", "summary.json"]


def test_a_filter_that_needs_too_much_memory_names_the_command_groups(capsys, monkeypatch):
    monkeypatch.setattr(memory, "free", lambda: 5 * 10**8)
    assert main(["localize", str(LAB), "--bounce", "45", "--cell", "0.004"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "GB are free; `jaxcell groups` writes the groups one direction at a time, or a" in line
