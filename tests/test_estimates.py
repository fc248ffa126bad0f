import math
import os
import sys

import numpy as np
import pytest
from helpers import python

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
from jaxcell.space import CellSpace, Motion, Workspace, estimates, visible_cells
from jaxcell.space.extent import Extent


ENDS = {"bounce": (45.0, 90.0), "start": "0", "goal": "50"}
TURNS = {"bounce": (45.0, 90.0), "reliability": 0.8}
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


LAB_A, CAFE_MAP = "maps/lab_a.json", "maps/cafe.json"
HALL, COMPLEX = "maps/room_200x125.json", "maps/complex.json"
SURE = {"errors": ("turn=0",), "reliability": 1.0}
THREE, EIGHT = (30.0, 75.0, 315.0), (10.0, 50.0, 90.0, 130.0, 170.0, 210.0, 250.0, 290.0)
# Measured peaks of a process without a compilation cache, in bytes.
STUDIES = [
    (0.21e9, study.Groups, HALL, 0.125, 360, {"bounce": (90.0,)}),
    (0.31e9, study.Groups, CAFE_MAP, 0.01, 360, {"bounce": (90.0,)}),
    (0.40e9, study.Groups, HALL, 0.2, 360, {"bounce": (90.0,), "step": 1.0}),
    (0.21e9, study.Localize, LAB_A, 0.05, 8, {"bounce": (45.0,)}),
    (0.37e9, study.Groups, LAB_A, 0.001, 8, {"bounce": (45.0,)}),
    (0.23e9, study.Groups, LAB_A, 0.002, 8, {"bounce": (45.0,)}),
    (0.38e9, study.Groups, CAFE_MAP, 0.005, 360, {"bounce": (90.0,)}),
    (0.29e9, study.Groups, CAFE_MAP, 0.002, 8, {"bounce": (90.0,)}),
    (0.28e9, study.Groups, CAFE_MAP, 0.01, 72, {"bounce": (90.0,)}),
    (2.78e9, study.Localize, LAB_A, 0.01, 8, {"bounce": (45.0,)}),
    (0.58e9, study.Localize, CAFE_MAP, 0.05, 72, {"bounce": (90.0,)}),
    (0.29e9, study.Localize, LAB_A, 0.02, 8, {"bounce": (45.0, 90.0)}),
    (0.46e9, study.Navigate, LAB_A, 0.005, 8, ENDS),
    (0.20e9, study.Navigate, CAFE_MAP, 0.05, 72, ENDS),
    (1.28e9, study.Cover, LAB_A, 0.01, 8, {**TURNS, "errors": ("turn=45.0",)}),
    (0.44e9, study.Cover, CAFE_MAP, 0.05, 72, {**TURNS, "errors": ("turn=5.0",)}),
    (0.36e9, study.Cover, LAB_A, 0.02, 8, {**TURNS, **SURE}),
    (0.97e9, study.Cover, LAB_A, 0.05, 360, {**SURE, "bounce": THREE}),
    (1.00e9, study.Cover, LAB_A, 0.05, 360, {**TURNS, "errors": ("turn=5.0",), "bounce": (45.0,)}),
    (1.98e9, study.Cover, COMPLEX, 0.25, 360, {**TURNS, "errors": ("turn=30.0",), "bounce": THREE}),
    (0.62e9, study.Cover, LAB_A, 0.05, 36, {**TURNS, "errors": ("turn=90.0",), "bounce": (90.0,)}),
    (0.71e9, study.Cover, LAB_A, 0.03, 36, {**TURNS, "errors": ("turn=10.0",), "bounce": EIGHT}),
    (3.95e9, study.Cover, LAB_A, 0.025, 360, {**TURNS, "errors": ("turn=5.0",), "bounce": THREE}),
    (0.36e9, study.Team, LAB_A, 0.1, 8, {"bounce": (90.0,)}),
    (0.59e9, study.Team, LAB_A, 0.01, 8, {"bounce": (90.0,)}),
    (0.59e9, study.PatrolMap, LAB_A, 0.5, None, {}),
    (0.67e9, study.PatrolMap, LAB_A, 0.2, None, {}),
]


def study_of(kind, map, cell, directions, options):
    more = {} if directions is None else {"directions": directions}
    return kind(map=bundled(map), cell=cell, **more, **options)


@pytest.mark.parametrize(("peak", "kind", "map", "cell", "directions", "options"), STUDIES)
def test_estimates_of_studies_agree_with_measured_peaks(peak, kind, map, cell, directions, options):
    needed = study_of(kind, map, cell, directions, options).memory()
    assert memory.LIBRARIES + needed == pytest.approx(peak, rel=0.3)


def test_the_estimate_of_a_store_agrees_with_its_measured_peak():
    asked = study.Groups(map=bundled(LAB_A), bounce=(45.0,), cell=0.00125)
    assert memory.LIBRARIES + asked.memory(written=True) == pytest.approx(1.26e9, rel=0.3)


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of a process is read on Linux")
@pytest.mark.parametrize("row", STUDIES[:3])
def test_estimates_of_studies_agree_with_the_peak_of_a_process(row):
    asked = study_of(*row[1:])
    code = (
        "from jaxcell import study, record; from jaxcell.base.runtime import configure_jax;"
        "from pathlib import Path, PosixPath; configure_jax();"
        f"record.summary(study.{asked!r}.run());"
        "print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"
    )
    nothing_compiled = {**os.environ, "JAX_ENABLE_COMPILATION_CACHE": "false"}
    peak = int(python("-c", code, env=nothing_compiled)[0]) * 1024
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
