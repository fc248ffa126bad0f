"""Times the search for patrols that capture most, and says what they capture.

Run `python experiments/benchmarks/bench_capture.py`; it takes about 5 minutes.

Two robots that see 6 m patrol each map against attacks of 20 steps. The least probability of
capture over the cells is that of the walk with the least commute time (on maps of up to 600 cells),
and of the best patrol that was found, with the entropy of its steps. User time of the processor
stands beside the seconds, which on a busy machine say little.
"""

import os
import time
from pathlib import Path

import numpy as np
from rows import Row, options, write_rows
from timing import begin, line

from jaxcell.patrol import (
    capture_policies,
    capture_probabilities,
    cell_graph,
    distributed_policies,
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


def search(name: str, cell: float | None) -> Row:
    cells = CellSpace.of(*suggested(MAPS / name, cell, None, None))
    graph, visible = cell_graph(cells), visible_cells(cells, REACH)
    before = ""
    if cells.positions <= COMMUTED:
        walks = distributed_policies(graph, visible, ROBOTS, 0.0)
        before = f"{capture_probabilities(graph, visible, walks, [ATTACK]).min():.3f}"
    wall, user = time.perf_counter(), os.times().user
    found = capture_policies(graph, visible, ROBOTS, ATTACK)
    wall, user = time.perf_counter() - wall, os.times().user - user
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
    return Row("capture", "search for the patrol that captures most", name, wall)


def main() -> None:
    arguments = options(__doc__, repeats=1).parse_args()
    begin("jax", "optax", "numpy")
    line("map", "cells", "commuting", "found", "entropy, nats", "wall, s", "user, s")
    line("---", *["--:"] * 6)
    write_rows(arguments.rows, [search(*one) for one in CELLS.items()])


if __name__ == "__main__":
    main()
