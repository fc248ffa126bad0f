"""Times the least average commute time (MAECT) beside two solvers of cone programs.

Run `python experiments/benchmarks/bench_commute.py`; it takes about 90 s. `--large` adds a
graph of 2,000 vertices and 8,000 edges, which takes about 20 s more and 1 GB.

The graphs are 8-connected grids with a fifth of the cells blocked. The largest, 15 x 15 with 37
blocked cells, has the size of those for which Alam 2018, Table 4.5, reports 677 to 779 s in Matlab.
The emphasis is on 6 vertices, with share 0.8. Ours stops at a relative duality gap of 1e-6; the
others, at their own tolerances. What counts is how far their weights are from the optimum, which
ours, at a gap of 1e-9, gives. They solve the semidefinite program as it is usually written, and its
dual with second-order cones, of which the weights are the multipliers.

A second table has many small problems: one after the other, and in one batch of arrays.
"""

import argparse
import itertools
import os
import statistics
import time
from collections.abc import Callable
from typing import Any

import cvxpy
import jax
import numpy as np
import scipy
import scipy.sparse.csgraph
import scipy.spatial

from jaxcell.optimize.commute_sweep import minimum_commute_sweep
from jaxcell.optimize.conductance import minimum_commute
from jaxcell.optimize.graph import Graph


# The largest grid that each of the others finishes in less than a minute.
LARGEST = {
    ("trace of the inverse", "CLARABEL"): 6,
    ("trace of the inverse", "SCS"): 4,
    ("second-order cones", "CLARABEL"): 15,
    ("second-order cones", "SCS"): 15,
}


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


def differences(graph: Graph) -> np.ndarray:
    """The difference of the ends of each edge, as a column."""
    number = np.arange(len(graph.edges))
    matrix = np.zeros((graph.vertices, number.size))
    matrix[graph.edges[:, 0], number] = 1
    matrix[graph.edges[:, 1], number] = -1
    return matrix


def by_program(graph: Graph, program: str, solver: str) -> np.ndarray:
    """The weights by cvxpy."""
    n, columns = graph.vertices, differences(graph)
    if program == "trace of the inverse":
        w = cvxpy.Variable(len(graph.edges), nonneg=True)
        laplacian = columns @ cvxpy.diag(w) @ columns.T
        objective = cvxpy.tr_inv(laplacian + np.ones((n, n)) / n)
        cvxpy.Problem(cvxpy.Minimize(objective), [cvxpy.sum(w) == 1]).solve(solver=solver)
        found = w.value
    else:
        # For a square V, in coordinates of the vectors with sum 0, the trace of the inverse is at
        # least (tr V)^2 if |V' b| <= 1 for the difference b of the ends of each edge.
        coordinates = np.linalg.svd(np.ones((1, n)))[2][1:]
        V = cvxpy.Variable((n - 1, n - 1))
        limit = cvxpy.sum(cvxpy.square(V.T @ (coordinates @ columns)), axis=0) <= 1
        cvxpy.Problem(cvxpy.Maximize(cvxpy.trace(V)), [limit]).solve(solver=solver)
        found = limit.dual_value
    weights = np.maximum(found, 0)
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
    for (program, solver), largest in LARGEST.items():
        if side <= largest:
            seconds, weights = timed(
                lambda program=program, solver=solver: by_program(graph, program, solver)
            )
            above = commute_time(graph, weights) / optimum - 1
            row(graph, f"cvxpy, {solver}, {program}", [seconds], above, "")


def emphases() -> tuple[Graph, dict[str, Any]]:
    """All pairs and triples of the vertices of the small example of Boyd et al. (2006)."""
    tails = [0, 1, 2, 0, 1, 1, 5, 4, 6, 7, 5, 6, 1]
    heads = [1, 2, 3, 4, 7, 3, 4, 6, 2, 3, 6, 7, 6]
    xy = [[1, 3], [2, 2.5], [3, 3], [3, 2], [1, 2], [1, 1], [2, 1.5], [3, 1]]
    some = [list(c) for k in (2, 3) for c in itertools.combinations(range(8), k)]
    return Graph(np.array([tails, heads]).T, xy=xy), {"emphasis": some}


def subsets() -> tuple[Graph, dict[str, Any]]:
    """Random subsets of the edges of a grid."""
    graph = grid(5, 5)
    allowed = np.random.default_rng(0).random((200, len(graph.edges))) < 0.85
    return graph, {"allowed": allowed}


def one_by_one(graph: Graph, problems: dict[str, Any]) -> np.ndarray:
    times = [minimum_commute(graph, some).commute_time for some in problems.get("emphasis", [])]
    for allowed in problems.get("allowed", []):
        part = Graph(graph.edges[allowed], graph.vertices)
        times.append(minimum_commute(part).commute_time if connected(part) else np.inf)
    return np.array(times)


def in_one_batch(graph: Graph, problems: dict[str, Any]) -> np.ndarray:
    return np.asarray(minimum_commute_sweep(graph, **problems).commute_time)


def sweep(name: str, graph: Graph, problems: dict[str, Any], repeats: int) -> None:
    (count,) = (len(value) for value in problems.values())
    other = one_by_one(graph, problems)
    for program in (one_by_one, in_one_batch):

        def run(program: Callable[..., np.ndarray] = program) -> np.ndarray:
            return program(graph, problems)

        first, here = timed(run)
        seconds = [timed(run)[0] for _ in range(repeats)]
        solved = np.isfinite(other)
        if (solved != np.isfinite(here)).any():
            raise RuntimeError(f"{name}: {program.__name__} differs on which have an answer")
        differ = np.abs(here[solved] / other[solved] - 1).max()
        print(
            f"| {count} {name} | {graph.vertices} | {len(graph.edges)} | "
            f"{program.__name__.replace('_', ' ')} | {first:.3f} | {min(seconds):.3f} | "
            f"{statistics.median(seconds):.3f} | {differ:.1e} |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, help="timed runs of ours")
    parser.add_argument("--large", action="store_true", help="add 2,000 vertices, 8,000 edges")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
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
    print("\n| problems | vertices | edges | program | first, s | min, s | median, s | differ by |")
    print("|---|--:|--:|---|--:|--:|--:|--:|")
    sweep("pairs and triples emphasised", *emphases(), arguments.repeats)
    sweep("subsets of edges", *subsets(), arguments.repeats)


if __name__ == "__main__":
    main()
