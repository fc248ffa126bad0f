"""Times the search for patrols and walks that capture most, and says what they capture.

Run `python experiments/benchmarks/bench_capture.py`; it takes about 40 s, and with `--full` about 6
minutes for more maps and larger grids.

Two robots that see 6 m patrol each map against attacks of 20 steps. The least probability of
capture over the cells is that of the walk with the least commute time (on maps of up to 600 cells),
and of the best patrol that was found, with the entropy of its steps. On grids, one robot walks from
place to place against attacks of twice as many steps as there are places on a side. User time of
the processor stands beside the seconds, which on a busy machine say little.
"""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
from rows import Row, options, write_rows
from timing import begin, line

from jaxcell.optimize import Graph
from jaxcell.patrol import (
    capture_policies,
    capture_probabilities,
    cell_graph,
    distributed_policies,
    maximin_capture,
    measure,
)
from jaxcell.patrol.map.capture import entropy_rate
from jaxcell.space import CellSpace, visible_cells
from jaxcell.space.cells import suggested


MAPS = Path(__file__).parents[2] / "data" / "maps"
CELLS = {
    "depot.json": None,
    "cafe.json": None,
    "harbour.json": None,
    "complex.json": None,
    "office.yaml": 0.2,
    "arena.json": None,
}
REACH, ROBOTS, ATTACK = 6.0, 2, 20
COMMUTED = 600
GRIDS = (5, 8, 20)


def timed(program: Callable[[], Any]) -> tuple[float, float, Any]:
    """The seconds of one call, those of the processor, and the result."""
    wall, user = time.perf_counter(), os.times().user
    found = program()
    return time.perf_counter() - wall, os.times().user - user, found


def on_grid(side: int) -> Row:
    """One robot on a grid, against attacks of twice as many steps as a side has places."""
    graph = Graph(np.array(nx.convert_node_labels_to_integers(nx.grid_2d_graph(side, side)).edges))
    wall, user, found = timed(lambda: maximin_capture(graph, 2 * side, throw=False))
    entropy = measure(found.chains[0]).entropy_rate_nats
    name = f"grid {side} x {side}, attacks of {2 * side} steps"
    shown = f"{found.value:.4f}", f"{entropy:.2f}", f"{wall:.0f}", f"{user:.0f}"
    line(name, graph.vertices, "", *shown)
    what = f"search for the walk that captures most, {found.value:.4f}"
    return Row("capture", what, name, wall)


def on_map(name: str, cell: float | None) -> Row:
    cells = CellSpace.of(*suggested(MAPS / name, cell, None, None))
    graph, visible = cell_graph(cells), visible_cells(cells, REACH)
    before = ""
    if cells.positions <= COMMUTED:
        walks = distributed_policies(graph, visible, ROBOTS, 0.0)
        before = f"{capture_probabilities(graph, visible, walks, [ATTACK]).min():.3f}"
    wall, user, found = timed(lambda: capture_policies(graph, visible, ROBOTS, ATTACK))
    entropy = float(np.mean([entropy_rate(graph, policy) for policy in found.policies]))
    line(
        name,
        cells.positions,
        before,
        f"{found.value:.3f}",
        f"{entropy:.2f}",
        f"{wall:.0f}",
        f"{user:.0f}",
    )
    what = f"search for the patrol that captures most, {found.value:.3f}"
    return Row("capture", what, f"{name}, {cells.positions:,} cells", wall)


def main() -> None:
    full = "more maps, and grids of 8 x 8 and 20 x 20"
    arguments = options(__doc__, repeats=1, full=full).parse_args()
    begin("jax", "optax", "numpy")
    line("map", "cells", "commuting", "found", "entropy, nats", "wall, s", "user, s")
    line("---", *["--:"] * 6)
    rows = [on_map(*one) for one in list(CELLS.items())[: None if arguments.full else 1]]
    rows += [on_grid(side) for side in GRIDS[: None if arguments.full else 1]]
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
