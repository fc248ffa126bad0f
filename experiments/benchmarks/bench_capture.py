"""Time the search for patrols and walks that maximize capture, and print their capture.

Run `python experiments/benchmarks/bench_capture.py`; it takes about a minute, and with `--full`
about 15 minutes, for more maps, all graphs of `data/graphs` and larger grids.

Two robots that see 6 m far patrol each map against attacks of 20 steps. The first table has the
least probability of capture over the cells, for the walk with the least commute time (on maps of up
to 600 cells) and for the best patrol, and the entropy of its steps. On graphs, one robot walks
against attacks that last twice the largest distance, and on grids twice the side. The second table
compares a search by gradients, by linear programs that start from a tour, and by both. In the third
table the robot must return to a charger; it compares the best walk with a random walk that is only
led back in time. User time of the processor is shown beside the seconds, because on a busy machine
these say little.
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
from timing import begin, header, line

from experiments.shared.data import GRAPHS, MAPS
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
from jaxcell.patrol.walks.optimal import maximin
from jaxcell.patrol.walks.optimal.polytope import ChainPolytope
from jaxcell.patrol.walks.optimal.sequential_lp import Captures, maximize_least_capture
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
# The largest number of vertices for a search by programs alone, and for a charger.
PROGRAMS = 64
CHARGED = 25


def timed(program: Callable[[], Any]) -> tuple[float, float, Any]:
    """Time one call: return its seconds, the user seconds of the processor, and the result."""
    wall, user = time.perf_counter(), os.times().user
    found = program()
    return time.perf_counter() - wall, os.times().user - user, found


def graphs(full: bool) -> list[tuple[str, Graph, int]]:
    """List graphs with their names and the steps of attacks."""
    found = []
    for file in sorted(GRAPHS.glob("*.json")):
        graph, _ = load_graph(file)
        apart = scipy.sparse.csgraph.shortest_path(graph.matrix(np.ones(len(graph.edges))))
        found.append((file.name, graph, 2 * int(apart.max())))
    for side in GRIDS:
        grid = nx.convert_node_labels_to_integers(nx.grid_2d_graph(side, side))
        found.append((f"grid {side} x {side}", Graph(np.array(grid.edges)), 2 * side))
    return found if full else [one for one in found if one[0] in ("eight.json", "grid 5 x 5")]


def by_gradients(graph: Graph, attack: int) -> float:
    polished, maximin.POLISHED = maximin.POLISHED, 0
    try:
        return maximin_capture(graph, attack, throw=False).value
    finally:
        maximin.POLISHED = polished


def by_programs(graph: Graph, attack: int) -> float:
    among = ChainPolytope.on(graph)

    def law(moves: np.ndarray) -> Captures:
        return Captures(among, moves, np.full(graph.vertices, attack))

    return maximize_least_capture(law, among, among.starts(1, 1, 0)[0], 1e-4)[1]


def on_graph(name: str, graph: Graph, attack: int) -> Row:
    """Time all searches on a graph."""
    programs: list[Callable[[], float] | None] = [
        # On more vertices the usual search has gradients only.
        None if graph.vertices > maximin.POLISHED else lambda: by_gradients(graph, attack),
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
    """Time the search for a walk with a charger at vertex 0.

    The robot must return within the steps to the farthest vertex and back, plus two. Attacks last
    at least as long, because the charger prevents the capture of shorter ones.
    """
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
    """Time the search for a patrol on a map."""
    cells = CellSpace.of(*suggested(MAPS / name, cell, None, None))
    graph, visible = cell_graph(cells), visible_cells(cells, REACH, part=AT_CENTRE)
    before = ""
    if cells.positions <= COMMUTED:
        walks = distributed_policies(graph, visible, ROBOTS, 0.0)
        before = f"{capture_probabilities(graph, visible, walks, Attack(ATTACK)).min():.3f}"
    wall, user, found = timed(lambda: capture_policies(graph, visible, ROBOTS, Attack(ATTACK)))
    entropy = float(np.mean([entropy_rate(graph, policy) for policy in found.policies]))
    shown = f"{found.value:.3f}", f"{entropy:.2f}", f"{wall:.0f}", f"{user:.0f}"
    line(name, cells.positions, before, *shown)
    what = f"search for the patrol that captures most, {found.value:.3f}"
    return Row("capture", what, f"{name}, {cells.positions:,} cells", wall)


def main() -> None:
    full = "more maps and graphs, and grids of up to 20 x 20"
    arguments = options(__doc__, repeats=1, full=full).parse_args()
    begin("jax", "optax", "numpy")
    header("map", "cells", "commuting", "found", "entropy, nats", "wall, s", "user, s")
    rows = [on_map(*one) for one in list(CELLS.items())[: None if arguments.full else 1]]
    print()
    each = [
        f"{one}{of}" for one in ("gradients", "programs", "both") for of in ("", ", s", ", user s")
    ]
    header("graph", "vertices", "attack", *each)
    rows += [on_graph(*one) for one in graphs(arguments.full)]
    print()
    header("graph", "vertices", "attack", "every", "even, led back", "found", "wall, s", "user, s")
    small = [one for one in graphs(arguments.full) if one[1].vertices <= CHARGED]
    rows += [charging(*one) for one in small]
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
