"""Times the search for patrols and walks that capture most, and says what they capture.

Run `python experiments/benchmarks/bench_capture.py`; it takes about a minute, and with `--full`
about 15 for more maps, all graphs of `data/graphs` and larger grids.

Two robots that see 6 m patrol each map against attacks of 20 steps. The least probability of
capture over the cells is that of the walk with the least commute time (on maps of up to 600 cells),
and of the best patrol that was found, with the entropy of its steps. On graphs, one robot walks
against attacks of twice as many steps as are between the vertices farthest apart, on grids twice as
many as there are places on a side: by gradients alone, by linear programs alone from a tour, and by
both, as they are used; and under a charger, beside a walk that takes all edges alike and is only
led back in time. User time of the processor stands beside the seconds, which on a busy
machine say little.
"""

import os
import time
from collections.abc import Callable
from typing import Any

import jax
import networkx as nx
import numpy as np
import scipy.sparse.csgraph
from rows import Row, options, write_rows
from timing import begin, line

from experiments.shared.data import DATA
from jaxcell.optimize import Graph
from jaxcell.patrol import (
    Attack,
    capture_policies,
    capture_probabilities,
    cell_graph,
    distributed_policies,
    load_graph,
    maximin_capture,
    random_walk,
)
from jaxcell.patrol.map.capture_search import entropy_rate
from jaxcell.patrol.walks import charged_capture
from jaxcell.patrol.walks.optimal import capture
from jaxcell.patrol.walks.optimal.linearized import LinearizedCapture
from jaxcell.patrol.walks.optimal.polytope import ChainPolytope
from jaxcell.patrol.walks.optimal.sequential_lp import maximize_least_capture
from jaxcell.space import CellSpace, visible_cells
from jaxcell.space.cells import suggested
from jaxcell.space.sight import AT_CENTRE


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
GRIDS = (5, 6, 8, 20)
# Vertices on which programs alone come to an end.
PROGRAMS = 64
# Vertices of graphs with a charger.
CHARGED = 25


def timed(program: Callable[[], Any]) -> tuple[float, float, Any]:
    """The seconds of one call, those of the processor, and the result."""
    wall, user = time.perf_counter(), os.times().user
    found = program()
    return time.perf_counter() - wall, os.times().user - user, found


def graphs(full: bool) -> list[tuple[str, Graph, int]]:
    """Names, graphs, and the steps of attacks."""
    found = []
    for file in sorted((DATA / "graphs").glob("*.json")):
        graph, _ = load_graph(file)
        apart = scipy.sparse.csgraph.shortest_path(graph.matrix(np.ones(len(graph.edges))))
        found.append((file.name, graph, 2 * int(apart.max())))
    for side in GRIDS:
        grid = nx.convert_node_labels_to_integers(nx.grid_2d_graph(side, side))
        found.append((f"grid {side} x {side}", Graph(np.array(grid.edges)), 2 * side))
    return found if full else [one for one in found if one[0] in ("eight.json", "grid 5 x 5")]


def by_gradients(graph: Graph, attack: int) -> float:
    polished, capture.POLISHED = capture.POLISHED, 0
    try:
        return maximin_capture(graph, attack, throw=False).value
    finally:
        capture.POLISHED = polished


def by_programs(graph: Graph, attack: int) -> float:
    among = ChainPolytope.on(graph)

    def law(moves: np.ndarray) -> LinearizedCapture:
        return LinearizedCapture(among, moves, np.full(graph.vertices, attack))

    return maximize_least_capture(law, among, among.starts(1, 1, 0)[0], 1e-4)[1]


def on_graph(name: str, graph: Graph, attack: int) -> Row:
    programs: list[Callable[[], float] | None] = [
        # On more vertices they are all there is.
        None if graph.vertices > capture.POLISHED else lambda: by_gradients(graph, attack),
        None if graph.vertices > PROGRAMS else lambda: by_programs(graph, attack),
        lambda: maximin_capture(graph, attack, throw=False).value,
    ]
    shown: list[str] = []
    for program in programs:
        if program is None:
            shown += [""] * 3
            continue
        jax.clear_caches()
        wall, user, value = timed(program)
        shown += [f"{value:.5f}", f"{wall:.0f}", f"{user:.0f}"]
    line(name, graph.vertices, attack, *shown)
    what = f"search for the walk that captures most, {shown[-3]}"
    return Row("capture", what, f"{name}, attacks of {attack} steps", wall)


def charging(name: str, graph: Graph, attack: int) -> Row:
    """At a charger as often as it takes to go to the farthest vertex and back, and two steps; under
    attacks that take no less, since from shorter ones the charger keeps a robot away."""
    even = random_walk(graph, np.ones(len(graph.edges))).to_scipy().toarray()[None]
    beside = graph.matrix(np.ones(len(graph.edges)))
    every = 2 + 2 * int(scipy.sparse.csgraph.shortest_path(beside, indices=0).max())
    attack = max(attack, every)
    wall, user, found = timed(lambda: charged_capture(graph, even, 0, every, attack))
    shown = f"{found.led_back:.4f}", f"{found.least_capture:.4f}", f"{wall:.0f}", f"{user:.0f}"
    line(name, graph.vertices, attack, every, *shown)
    what = f"search for the walk with a charger that captures most, {found.least_capture:.3f}"
    return Row("capture", what, f"{name}, every {every} steps, attacks of {attack}", wall)


def on_map(name: str, cell: float | None) -> Row:
    cells = CellSpace.of(*suggested(DATA / "maps" / name, cell, None, None))
    graph, visible = cell_graph(cells), visible_cells(cells, REACH, part=AT_CENTRE)
    before = ""
    if cells.positions <= COMMUTED:
        walks = distributed_policies(graph, visible, ROBOTS, 0.0)
        before = f"{capture_probabilities(graph, visible, walks, Attack(ATTACK)).min():.3f}"
    wall, user, found = timed(lambda: capture_policies(graph, visible, ROBOTS, Attack(ATTACK)))
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
    full = "more maps and graphs, and grids of up to 20 x 20"
    arguments = options(__doc__, repeats=1, full=full).parse_args()
    begin("jax", "optax", "numpy")
    line("map", "cells", "commuting", "found", "entropy, nats", "wall, s", "user, s")
    line("---", *["--:"] * 6)
    rows = [on_map(*one) for one in list(CELLS.items())[: None if arguments.full else 1]]
    print()
    each = [
        f"{one}{of}" for one in ("gradients", "programs", "both") for of in ("", ", s", ", user s")
    ]
    line("graph", "vertices", "attack", *each)
    line("---", *["--:"] * 11)
    rows += [on_graph(*one) for one in graphs(arguments.full)]
    print()
    line("graph", "vertices", "attack", "every", "even, led back", "found", "wall, s", "user, s")
    line("---", *["--:"] * 7)
    small = [one for one in graphs(arguments.full) if one[1].vertices <= CHARGED]
    rows += [charging(*one) for one in small]
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
