"""Times the least average commute time (MAECT) beside two solvers of semidefinite programs.

Run `python experiments/benchmarks/bench_commute.py`; it takes about 15 s. `--large` adds a
graph of 2,000 vertices and 8,000 edges, which takes about 20 s more and 1 GB.

The graphs are 8-connected grids with a fifth of the cells blocked. The largest, 15 x 15 with 37
blocked cells, has the size of those for which Alam 2018, Table 4.5, reports 677 to 779 s in Matlab.
The emphasis is on 6 vertices, with share 0.8. Ours stops at a relative duality gap of 1e-6; the
others, at their own tolerances. What counts is how far their weights are from the optimum, which
ours, at a gap of 1e-9, gives.
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from typing import Any

import cvxpy
import numpy as np
import scipy
import scipy.sparse.csgraph
import scipy.spatial

from jaxcell.optimize.conductance import minimum_commute
from jaxcell.optimize.graph import Graph


# The largest grid that each of the others finishes in a few seconds.
LARGEST = {"CLARABEL": 6, "SCS": 4}


def grid(side: int, blocked: int) -> Graph:
    """The first connected grid of a fixed sequence of random ones."""
    for seed in range(1000):
        free = np.ones(side * side, bool)
        free[np.random.default_rng(seed).choice(side * side, blocked, replace=False)] = False
        number = np.full((side + 1, side + 2), -1)
        number[:side, 1:-1] = np.where(free, np.cumsum(free) - 1, -1).reshape(side, side)
        here = number[:side, 1:-1]
        ends = []
        for up, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            there = number[up : up + side, 1 + right : 1 + right + side]
            both = (here >= 0) & (there >= 0)
            ends.append(np.stack([here[both], there[both]], axis=1))
        graph = Graph(np.concatenate(ends), xy=np.argwhere(here >= 0)[:, ::-1])
        if connected(graph):
            return graph
    raise RuntimeError("no connected grid was found")


def connected(graph: Graph) -> bool:
    matrix = graph.matrix(np.ones(len(graph.edges)))
    return scipy.sparse.csgraph.connected_components(matrix)[0] == 1


def neighbours(vertices: int, edges: int) -> Graph:
    """Random points of the unit square, joined to near ones."""
    xy = np.random.default_rng(0).random((vertices, 2))
    pairs = scipy.spatial.Delaunay(xy).simplices[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    tree = scipy.spatial.cKDTree(xy)
    more = np.sort(tree.query_pairs(0.05, output_type="ndarray"), axis=1)
    more = more[np.argsort(np.hypot(*(xy[more[:, 0]] - xy[more[:, 1]]).T))]
    both = np.concatenate([pairs, more])
    _, first = np.unique(both, axis=0, return_index=True)
    return Graph(both[np.sort(first)][:edges], xy=xy)


def by_program(graph: Graph, solver: str) -> np.ndarray:
    """The weights by cvxpy: the trace of the inverse as its own atom."""
    n, q = graph.vertices, len(graph.edges)
    incidence = np.zeros((n, q))
    incidence[graph.edges[:, 0], np.arange(q)] = 1
    incidence[graph.edges[:, 1], np.arange(q)] = -1
    w = cvxpy.Variable(q, nonneg=True)
    laplacian = incidence @ cvxpy.diag(w) @ incidence.T
    objective = cvxpy.tr_inv(laplacian + np.ones((n, n)) / n)
    cvxpy.Problem(cvxpy.Minimize(objective), [cvxpy.sum(w) == 1]).solve(solver=solver)
    weights = np.maximum(w.value, 0)
    return weights / weights.sum()


def commute_time(graph: Graph, weights: np.ndarray) -> float:
    matrix = graph.matrix(weights).toarray()
    eigenvalues = np.linalg.eigvalsh(np.diag(matrix.sum(axis=0)) - matrix)
    return 4 * float(np.sum(1 / eigenvalues[1:])) / (graph.vertices - 1)


def timed(program: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    result = program()
    return time.perf_counter() - began, result


def row(graph: Graph, program: str, seconds: list[float], above: float, steps: str) -> None:
    print(
        f"| {graph.vertices:,} | {len(graph.edges):,} | {program} | {min(seconds):.3f} | "
        f"{statistics.median(seconds):.3f} | {above:.1e} | {steps} |",
        flush=True,
    )


def side_by_side(side: int, blocked: int, repeats: int) -> None:
    graph = grid(side, blocked)
    emphasis = np.linspace(0, graph.vertices - 1, 6).astype(int).tolist()
    for name, through in (("jaxcell", None), ("jaxcell, emphasis", emphasis)):
        optimum = minimum_commute(graph, through, tolerance=1e-9).commute_time
        runs = [
            timed(lambda through=through: minimum_commute(graph, through, tolerance=1e-6))
            for _ in range(repeats)
        ]
        found = runs[0][1]
        above = found.commute_time / optimum - 1
        row(graph, name, [t for t, _ in runs], above, str(found.certificate.iterations))
    optimum = minimum_commute(graph, tolerance=1e-9).commute_time
    for solver, largest in LARGEST.items():
        if side <= largest:
            seconds, weights = timed(lambda solver=solver: by_program(graph, solver))
            above = commute_time(graph, weights) / optimum - 1
            row(graph, f"cvxpy, {solver}", [seconds], above, "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, help="timed runs of ours")
    parser.add_argument("--large", action="store_true", help="add 2,000 vertices, 8,000 edges")
    arguments = parser.parse_args()
    versions = f"numpy {np.__version__}, scipy {scipy.__version__}, cvxpy {cvxpy.__version__}"
    print(f"{versions}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    print("| vertices | edges | program | min, s | median, s | above the optimum | steps |")
    print("|--:|--:|---|--:|--:|--:|--:|")
    for side, blocked in ((4, 3), (6, 7), (15, 37)):
        side_by_side(side, blocked, arguments.repeats)
    if arguments.large:
        graph = neighbours(2000, 8000)
        seconds, found = timed(lambda: minimum_commute(graph, tolerance=1e-6))
        gap = found.certificate.residual
        row(
            graph,
            "jaxcell (gap for the optimum)",
            [seconds],
            gap,
            str(found.certificate.iterations),
        )


if __name__ == "__main__":
    main()
