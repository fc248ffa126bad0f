import math
import os
import subprocess
import sys

import numpy as np
import pytest

from jaxcell import bundled, study
from jaxcell.automata import subset_construction
from jaxcell.base import memory
from jaxcell.bounce import (
    BounceGroups,
    Roadmap,
    all_plans,
    bounce_groups,
    bounce_map,
    coverage_policy,
    group_summary,
    moves,
)
from jaxcell.space import CellSpace, Motion, Workspace, estimates, visible_cells, visible_centres
from jaxcell.space.extent import Extent


ENDS = {"bounces": (45.0, 90.0), "start": "0", "goal": "50"}
TURNS = {"bounces": (45.0, 90.0), "reliability": 0.8}
LAB = Workspace.load(bundled("maps/lab_a.json"))
CAFE = Workspace.load(bundled("maps/cafe.json"))


@pytest.mark.parametrize(("workspace", "cell"), [(LAB, 0.1), (LAB, 0.07), (CAFE, 0.05)])
def test_extents_are_estimated_before_the_cells_exist(workspace, cell):
    before, after = Extent.about(workspace, cell, 16), Extent.of(CellSpace.of(workspace, cell, 16))
    assert (before.rows, before.columns) == (after.rows, after.columns)
    assert before.positions == pytest.approx(after.positions, rel=0.05)
    assert before.gridded == after.gridded == (cell == 0.1)
    assert before.wall_length == pytest.approx(after.wall_length)


@pytest.mark.parametrize(("directions", "step"), [(8, None), (360, None), (72, 0.3), (8, 1e9)])
def test_the_moves_on_a_grid_are_counted(directions, step):
    cells = CellSpace.of(LAB, 0.1, directions)
    assert Extent.of(cells).ways(Motion(step)) == moves(cells, motion=Motion(step)).target.shape[0]


def test_extents_of_impossible_cells_are_unknown():
    for cell in (0.0, math.nan, math.inf, 1e-12, 5e-324):
        assert Extent.about(LAB, cell, 8) is None
    assert Extent.about(LAB, 1.0, 0) is None
    assert Extent.about(LAB, 1.0, 10**9) is None


# Measured peaks of a process that runs `group_summary`, in bytes.
MEASURED = [
    ("maps/lab_a.json", 0.005, 8, None, "swept", 0.281e9),
    ("maps/room_200x125.json", 0.1, 360, None, "swept", 0.302e9),
    ("maps/room_200x125.json", 0.2, 360, 1.0, "swept", 0.398e9),
    ("maps/room_200x125.json", 0.2, 8, 2.0, "swept", 0.286e9),
    ("maps/cafe.json", 0.005, 16, None, "swept", 0.286e9),
    ("maps/cafe.json", 0.01, 72, None, "swept", 0.283e9),
]


@pytest.mark.parametrize(("name", "cell", "directions", "step", "collision", "peak"), MEASURED)
def test_estimates_of_groups_agree_with_measured_peaks(
    name, cell, directions, step, collision, peak
):
    extent = Extent.about(Workspace.load(bundled(name)), cell, directions)
    needed = memory.LIBRARIES + estimates.section(extent, Motion(step, collision))
    assert needed == pytest.approx(peak, rel=0.3)


LAB_A, CAFE_MAP = "maps/lab_a.json", "maps/cafe.json"
HALL = "maps/room_200x125.json"
# Measured peaks of a process without a compilation cache, in bytes.
STUDIES = {
    "groups, 5.2e8 cells": (study.Groups, HALL, {"bounce": (90.0,), "cell": 0.125}, 360, 0.21e9),
    "groups, 1.5e8 cells": (study.Groups, LAB_A, {"bounce": (45.0,), "cell": 0.001}, 8, 0.37e9),
    "groups, 3.8e7 cells": (study.Groups, LAB_A, {"bounce": (45.0,), "cell": 0.002}, 8, 0.23e9),
    "slanted, 2.5e8 cells": (
        study.Groups,
        CAFE_MAP,
        {"bounce": (90.0,), "cell": 0.005},
        360,
        0.38e9,
    ),
    "slanted, 1.3e8 cells": (
        study.Groups,
        CAFE_MAP,
        {"bounce": (90.0,), "cell": 0.005},
        180,
        0.34e9,
    ),
    "slanted, 6.3e7 cells": (
        study.Groups,
        CAFE_MAP,
        {"bounce": (90.0,), "cell": 0.01},
        360,
        0.31e9,
    ),
    "slanted, 3.5e7 cells": (study.Groups, CAFE_MAP, {"bounce": (90.0,), "cell": 0.002}, 8, 0.29e9),
    "slanted, 1.3e7 cells": (study.Groups, CAFE_MAP, {"bounce": (90.0,), "cell": 0.01}, 72, 0.28e9),
    "filter, 6e4 cells": (study.Localize, LAB_A, {"bounce": 45.0, "cell": 0.05}, 8, 0.21e9),
    "filter, 1.5e6 cells": (study.Localize, LAB_A, {"bounce": 45.0, "cell": 0.01}, 8, 2.78e9),
    "filter, 5e5 cells": (study.Localize, CAFE_MAP, {"bounce": 90.0, "cell": 0.05}, 72, 0.58e9),
    "choice, 4e5 cells": (
        study.Localize,
        LAB_A,
        {"bounces": (45.0, 90.0), "cell": 0.02},
        8,
        0.29e9,
    ),
    "plan, 6e6 cells": (study.Navigate, LAB_A, {**ENDS, "cell": 0.005}, 8, 0.46e9),
    "plan, 5e5 cells": (study.Navigate, CAFE_MAP, {**ENDS, "cell": 0.05}, 72, 0.20e9),
    "cover, 1.5e6 cells": (study.Cover, LAB_A, {**TURNS, "error": 45.0, "cell": 0.01}, 8, 1.28e9),
    "cover, 5e5 cells": (study.Cover, CAFE_MAP, {**TURNS, "error": 5.0, "cell": 0.05}, 72, 0.44e9),
    "cover, 4e5 cells, sure turns": (
        study.Cover,
        LAB_A,
        {"bounces": (45.0, 90.0), "error": 0.0, "reliability": 1.0, "cell": 0.02},
        8,
        0.36e9,
    ),
    "cover, 2.7e6 cells, sure turns": (
        study.Cover,
        LAB_A,
        {"bounces": (30.0, 75.0, 315.0), "error": 0.0, "reliability": 1.0, "cell": 0.05},
        360,
        0.97e9,
    ),
    "cover, 2.7e6 cells, one angle": (
        study.Cover,
        LAB_A,
        {"bounces": (45.0,), "error": 5.0, "reliability": 0.8, "cell": 0.05},
        360,
        1.00e9,
    ),
    "cover, 1e6 cells, wide errors": (
        study.Cover,
        "maps/complex.json",
        {"bounces": (30.0, 75.0, 315.0), "error": 30.0, "reliability": 0.8, "cell": 0.25},
        360,
        1.98e9,
    ),
    "cover, 3e5 cells, widest errors": (
        study.Cover,
        LAB_A,
        {"bounces": (90.0,), "error": 90.0, "reliability": 0.8, "cell": 0.05},
        36,
        0.62e9,
    ),
    "cover, 8e5 cells, eight angles": (
        study.Cover,
        LAB_A,
        {
            "bounces": (10.0, 50.0, 90.0, 130.0, 170.0, 210.0, 250.0, 290.0),
            "error": 10.0,
            "reliability": 0.8,
            "cell": 0.03,
        },
        36,
        0.71e9,
    ),
    "cover, 1.1e7 cells": (
        study.Cover,
        LAB_A,
        {"bounces": (30.0, 75.0, 315.0), "error": 5.0, "reliability": 0.8, "cell": 0.025},
        360,
        3.95e9,
    ),
    "team, 1.5e4 cells": (study.Team, LAB_A, {"bounces": (90.0,), "cell": 0.1}, 8, 0.36e9),
    "team, 1.5e6 cells": (study.Team, LAB_A, {"bounces": (90.0,), "cell": 0.01}, 8, 0.59e9),
    "patrol, 76 cells": (study.PatrolMap, LAB_A, {"cell": 0.5}, None, 0.59e9),
    "patrol, 475 cells": (study.PatrolMap, LAB_A, {"cell": 0.2}, None, 0.67e9),
}


def study_of(name):
    kind, map, options, directions, peak = STUDIES[name]
    more = {} if directions is None else {"directions": directions}
    return kind(map=bundled(map), **more, **options), peak


@pytest.mark.parametrize("name", STUDIES)
def test_estimates_of_studies_agree_with_measured_peaks(name):
    asked, peak = study_of(name)
    assert memory.LIBRARIES + asked.memory() == pytest.approx(peak, rel=0.3)


def test_the_estimate_of_a_store_agrees_with_its_measured_peak():
    asked = study.Groups(map=bundled(LAB_A), bounce=(45.0,), cell=0.00125)
    assert memory.LIBRARIES + asked.memory(written=True) == pytest.approx(1.26e9, rel=0.3)


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of a process is read on Linux")
@pytest.mark.parametrize(
    "name", ["groups, 5.2e8 cells", "slanted, 6.3e7 cells", "filter, 6e4 cells"]
)
def test_estimates_of_studies_agree_with_the_peak_of_a_process(name):
    asked, _ = study_of(name)
    code = (
        "from jaxcell import study, record; from jaxcell.base.runtime import configure_jax;"
        "from pathlib import Path, PosixPath; configure_jax();"
        f"record.summary(study.{asked!r}.run());"
        "print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"
    )
    nothing_compiled = {**os.environ, "JAX_ENABLE_COMPILATION_CACHE": "false"}
    run = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=nothing_compiled,
    )
    peak = int(run.stdout) * 1024
    assert memory.LIBRARIES + asked.memory() == pytest.approx(peak, rel=0.3)


def test_the_error_suggests_the_smallest_round_cell_that_fits(monkeypatch):
    monkeypatch.setattr(memory, "free", lambda: 10**9)
    extent = Extent.about(LAB, 1e-3, 8)

    def need(extent):
        return 150 * extent.size

    with pytest.raises(MemoryError, match=r"groups needs .* GB .*; a cell of 0.005 m would fit"):
        estimates.check(extent, need, "groups", None)
    assert need(Extent.about(LAB, 0.005, 8)) == estimates.check(
        Extent.about(LAB, 0.005, 8), need, "groups", None
    )
    assert need(Extent.about(LAB, 0.004, 8)) > 1e9
    # No cell is larger than a step, so there are fewer directions.
    with pytest.raises(MemoryError, match="use larger cells or fewer directions"):
        estimates.check(extent, need, "groups", 1e-3)


@pytest.mark.parametrize(
    "study",
    [
        lambda: CellSpace.of(LAB, 0.01, 8),
        lambda: moves(CellSpace.of(LAB, 0.2, 8)),
        lambda: group_summary(CellSpace.of(LAB, 0.5, 8), math.pi),
        lambda: bounce_groups(CellSpace.of(LAB, 0.5, 8), math.pi),
        lambda: BounceGroups.of(CellSpace.of(LAB, 0.5, 8), math.pi),
        lambda: bounce_map(CellSpace.of(LAB, 0.2, 8), math.pi),
        lambda: bounce_map(CellSpace.of(LAB, 0.5, 8), np.full(1000, math.pi)),
        lambda: Roadmap.of(CellSpace.of(LAB, 0.5, 8), [math.pi]),
        lambda: coverage_policy(CellSpace.of(LAB, 0.5, 8), [math.pi], 0.0, 1.0),
        lambda: visible_cells(CellSpace.of(LAB, 0.2, 8), 1.0),
        lambda: visible_centres(CellSpace.of(LAB, 0.2, 8), 1.0),
    ],
)
def test_functions_that_need_too_much_memory_refuse(monkeypatch, study):
    # The memory suffices for the cells, but not for a study of them.
    monkeypatch.setattr(memory, "NEGLIGIBLE", 0)
    monkeypatch.setattr(memory, "free", lambda: 20_000)
    with pytest.raises(MemoryError, match=r"needs about .* of memory"):
        study()


def test_plans_too_large_for_memory_are_written_to_a_file(monkeypatch, tmp_path):
    cells = CellSpace.of(LAB, 1.0, 8)
    roadmap = Roadmap.of(cells, [math.pi])
    room = 2 * 6 * roadmap.entry.size * roadmap.walls
    limit = memory.check

    def check(needed, *args):
        monkeypatch.setattr(memory, "NEGLIGIBLE", 0)
        monkeypatch.setattr(memory, "free", lambda: room - 1)
        limit(needed, *args)

    monkeypatch.setattr(memory, "check", check)
    with pytest.raises(MemoryError, match=r"plans from .* write them to a store"):
        all_plans(cells, [math.pi])
    monkeypatch.undo()
    all_plans(cells, [math.pi], store=tmp_path / "plans.zarr")


def test_filters_are_refused_when_their_states_exceed_the_memory(monkeypatch):
    # Each zero removes one cell, so the total size of the sets grows with the square.
    image = np.maximum(np.arange(300) - 1, 0)
    bumped = np.arange(300) == 0
    monkeypatch.setattr(memory, "NEGLIGIBLE", 0)
    monkeypatch.setattr(memory, "free", lambda: 3000)
    with pytest.raises(MemoryError, match=r"a filter of more than .* states needs"):
        subset_construction(image, bumped)
