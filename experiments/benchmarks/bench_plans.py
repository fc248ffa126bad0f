"""Time plans between all pairs of cells: beside scipy's Dijkstra, and alone on large maps.

Run `python experiments/benchmarks/bench_plans.py`; it takes about 15 s and 0.6 GB.

The maps are those of `experiments/chapter_3/all_plans.py`, with 8 directions, angles 45, 90 and
135 deg, and weights 1 and 100. jaxcell starts from a `CellSpace`, and computes costs and first
actions of all pairs, `[cells, cells]`. scipy starts from a sparse matrix that is not timed: the
roadmap over cells and the angle in use. Its predecessors define plans, so costs and predecessors
are comparable with our results. Costs must agree.
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse
from rich.console import Console
from rows import Row, options, rows_of, write_rows
from scipy.sparse.csgraph import dijkstra
from timing import begin, header, line, table, take_turns, timed

from experiments.chapter_3.all_plans import environments
from experiments.shared.data import MAPS
from jaxcell.bounce import all_plans, bounce_map
from jaxcell.space import CellSpace, Workspace


BOUNCES = np.deg2rad([45, 90, 135])
KEEP, CHANGE = 1, 100


def roadmap(cells: CellSpace) -> scipy.sparse.csr_array:
    """Make the roadmap over cells and the angle in use; the last layer precedes the first bump."""
    layers = len(BOUNCES) + 1
    z = np.arange(cells.size)
    rows, columns, weights = [], [], []
    for k, bounce in enumerate(BOUNCES):
        simple = bounce_map(cells, bounce)
        image, bumped = np.asarray(simple.image), np.asarray(simple.bumped)
        for layer in range(layers):
            if k == 0:
                rows.append(layer * cells.size + z[~bumped])
                columns.append(layer * cells.size + image[~bumped])
                weights.append(np.full(columns[-1].size, KEEP))
            rows.append(layer * cells.size + z[bumped])
            columns.append(k * cells.size + image[bumped])
            kept = layer in (k, layers - 1)
            weights.append(np.full(columns[-1].size, KEEP if kept else CHANGE))
    entries = (np.concatenate(rows), np.concatenate(columns))
    shape = (layers * cells.size,) * 2
    return scipy.sparse.csr_array((np.concatenate(weights).astype(float), entries), shape=shape)


def ours(cells: CellSpace) -> np.ndarray:
    plans = all_plans(cells, BOUNCES, KEEP, CHANGE)
    plans.actions()
    return plans.costs()


def theirs(cells: CellSpace, graph: scipy.sparse.csr_array, *, predecessors: bool) -> np.ndarray:
    layers = len(BOUNCES) + 1
    starts = (layers - 1) * cells.size + np.arange(cells.size)
    found = dijkstra(graph, indices=starts, return_predecessors=predecessors)
    costs = found[0] if predecessors else found
    return costs.reshape(cells.size, layers, cells.size).min(axis=1)


def side_by_side(repeats: int) -> list[Row]:
    """Time jaxcell and scipy on each map."""
    rows = []
    for name, cells in environments().items():
        graph = roadmap(cells)
        programs = {
            "jaxcell, costs and actions": lambda cells=cells: ours(cells),
            "scipy, costs": lambda c=cells, g=graph: theirs(c, g, predecessors=False),
            "scipy, costs and predecessors": lambda c=cells, g=graph: theirs(
                c, g, predecessors=True
            ),
        }

        def check(results: dict[str, Any], name: str = name) -> None:
            expected, *others = results.values()
            for costs in others:
                if not np.array_equal(np.where(np.isinf(costs), -1, costs), expected):
                    sys.exit(f"{name}: scipy and jaxcell disagree")

        timings = take_turns(programs, repeats, check)
        table(f"{name}, {cells.size:,} cells", timings)
        # Costs alone define no plans.
        del timings["scipy, costs"]
        what = f"plans between all pairs, {name}"
        rows += rows_of("plans", what, f"{cells.size:,} cells", timings)
    return rows


def large() -> list[Row]:
    """Time plans that are written to a store, because their costs would fill the memory."""
    print()
    header("room", "cells", "pairs", "seconds", "store, MB", "one plan, ms")
    room = Workspace.load(MAPS / "room_200x125.json")
    for side in (4, 2, 1):
        cells = CellSpace.of(room, side, 8)
        with tempfile.TemporaryDirectory() as folder, Console(stderr=True).status("") as shown:
            store = Path(folder) / "plans.zarr"
            seconds, plans = timed(
                lambda cells=cells, store=store, shown=shown: all_plans(
                    cells,
                    BOUNCES,
                    store=store,
                    progress=lambda done, total: shown.update(f"{done:,} of {total:,} entries"),
                )
            )
            size = sum(file.stat().st_size for file in store.rglob("*") if file.is_file()) / 1e6
            one, _ = timed(lambda plans=plans, cells=cells: plans.plan(0, cells.size - 1))
        squares = f"{cells.free.shape[1]} x {cells.free.shape[0]}"
        times = (f"{seconds:.1f}", f"{size:.0f}", f"{1e3 * one:.0f}")
        line(squares, f"{cells.size:,}", f"{cells.size**2:.1e}", *times)
    return [Row("plans", "plans between all pairs, in a file", f"{cells.size:,} cells", seconds)]


def main() -> None:
    arguments = options(__doc__, repeats=5).parse_args()
    begin("jax", "numpy", "scipy")
    rows = side_by_side(arguments.repeats)
    write_rows(arguments.rows, rows + large())


if __name__ == "__main__":
    main()
