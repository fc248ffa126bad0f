"""Time the least average commute time (MAECT) beside two solvers of cone programs.

Run `python experiments/benchmarks/bench_commute.py`; it takes about half a minute. `--full` adds
graphs that take the other solvers up to a minute, and a graph of 2,000 vertices and 8,000 edges,
which takes ours about 20 s and 1 GB.

The graphs are 8-connected grids with a fifth of the cells blocked. The largest, 15 x 15 with 37
blocked cells, has the size for which Alam 2018, Table 4.5, reports 677 to 779 s in Matlab. The
emphasis is on 6 vertices, with share 0.8. Our solver stops at a relative duality gap of 1e-6, and
the others at their own tolerances. `above the optimum` compares the weights with our optimum at a
gap of 1e-9. The other solvers solve the usual semidefinite program, and its dual with second-order
cones, whose multipliers are the weights.
"""

from collections.abc import Callable
from typing import Any

import cvxpy
import numpy as np
import scipy.sparse.csgraph
import scipy.spatial
from rows import Row, options, rows_of, write_rows
from timing import Timing, begin, header, line, take_turns, timed

from jaxcell.optimize import conic
from jaxcell.optimize.commute import minimum_commute
from jaxcell.optimize.constraints import Linear
from jaxcell.optimize.graph import Graph


# The side of the largest grid of each solver, by default and with `--full`.
LARGEST = {
    ("trace of the inverse", "CLARABEL"): (4, 6),
    ("trace of the inverse", "SCS"): (4, 4),
    ("second-order cones", "CLARABEL"): (6, 15),
    ("second-order cones", "SCS"): (15, 15),
}


def grid(side: int, blocked: int) -> Graph:
    """Make the first connected grid of a fixed sequence of random grids."""
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
    """Make a graph of random points of the unit square, joined to close points."""
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
    """Make the incidence matrix `[vertices, edges]`."""
    number = np.arange(len(graph.edges))
    matrix = np.zeros((graph.vertices, number.size))
    matrix[graph.edges[:, 0], number] = 1
    matrix[graph.edges[:, 1], number] = -1
    return matrix


def by_program(graph: Graph, program: str, solver: str) -> np.ndarray:
    """Compute the weights by cvxpy."""
    n, columns = graph.vertices, differences(graph)
    if program == "trace of the inverse":
        w = cvxpy.Variable(len(graph.edges), nonneg=True)
        laplacian = columns @ cvxpy.diag(w) @ columns.T
        objective = cvxpy.tr_inv(laplacian + np.ones((n, n)) / n)
        cvxpy.Problem(cvxpy.Minimize(objective), [cvxpy.sum(w) == 1]).solve(solver=solver)
        solution = w.value
    else:
        # For a square V, in coordinates of the vectors with sum 0, the trace of the inverse is at
        # least (tr V)^2 if |V' b| <= 1 for each column b of the incidence matrix.
        coordinates = np.linalg.svd(np.ones((1, n)))[2][1:]
        V = cvxpy.Variable((n - 1, n - 1))
        limit = cvxpy.sum(cvxpy.square(V.T @ (coordinates @ columns)), axis=0) <= 1
        cvxpy.Problem(cvxpy.Maximize(cvxpy.trace(V)), [limit]).solve(solver=solver)
        solution = limit.dual_value
    weights = np.maximum(solution, 0)
    return weights / weights.sum()


def commute_time(graph: Graph, weights: np.ndarray) -> float:
    matrix = graph.matrix(weights).toarray()
    eigenvalues = np.linalg.eigvalsh(np.diag(matrix.sum(axis=0)) - matrix)
    return 4 * float(np.sum(1 / eigenvalues[1:])) / (graph.vertices - 1)


def row(graph: Graph, program: str, timing: Timing, above: float, steps: object) -> None:
    size = (f"{graph.vertices:,}", f"{len(graph.edges):,}")
    seconds = (f"{timing.least:.3f}", f"{timing.median:.3f}")
    line(*size, program, *seconds, f"{above:.1e}", steps)


def size_of(graph: Graph) -> str:
    return f"{graph.vertices:,} vertices, {len(graph.edges):,} edges"


def side_by_side(side: int, blocked: int, repeats: int, full: bool) -> list[Row]:
    """Time all solvers on a grid."""
    graph = grid(side, blocked)
    emphasis = np.linspace(0, graph.vertices - 1, 6).astype(int).tolist()
    ours = {"jaxcell": None, "jaxcell, emphasis": emphasis}
    programs: dict[str, Callable[[], Any]] = {
        name: lambda through=through: minimum_commute(graph, through, tolerance=1e-6)
        for name, through in ours.items()
    }
    for (program, solver), largest in LARGEST.items():
        if side <= largest[full]:
            programs[f"cvxpy, {solver}, {program}"] = lambda program=program, solver=solver: (
                by_program(graph, program, solver)
            )
    values: dict[str, Any] = {}
    timings = take_turns(programs, repeats, values.update, patience_s=1)
    optimum = minimum_commute(graph, tolerance=1e-9).commute_time
    for name, timing in timings.items():
        if name in ours:
            best = minimum_commute(graph, ours[name], tolerance=1e-9).commute_time
            above = values[name].commute_time / best - 1
            row(graph, name, timing, above, values[name].certificate.iterations)
        else:
            row(graph, name, timing, commute_time(graph, values[name]) / optimum - 1, "")
    del timings["jaxcell, emphasis"]
    return rows_of("commute", "walk with the least commute time", size_of(graph), timings)


def constraints(graph: Graph) -> list[Linear]:
    """Require at most three even shares on each edge, and a third of one at each vertex."""
    most, least = 3 / len(graph.edges), 1 / (3 * graph.vertices)
    caps = [Linear(f"edge {e}", row, upper=most) for e, row in enumerate(np.eye(len(graph.edges)))]
    even = enumerate(np.eye(graph.vertices))
    return caps + [Linear.on_visits(graph, f"vertex {v}", row, least) for v, row in even]


def constrained(side: int, blocked: int, repeats: int, peer: bool) -> list[Row]:
    """Time walks with constraints on a grid."""
    graph = grid(side, blocked)
    rules = constraints(graph)
    programs: dict[str, Callable[[], Any]] = {
        "jaxcell": lambda: minimum_commute(graph, constraints=rules, tolerance=1e-6)
    }
    if peer:
        name = "cvxpy, CLARABEL, second-order cones"
        programs[name] = lambda: conic.least_resistance(graph, rules)
    values: dict[str, Any] = {}
    timings = take_turns(programs, repeats, values.update, patience_s=1)
    best = minimum_commute(graph, constraints=rules, tolerance=1e-9).commute_time
    for name, timing in timings.items():
        above = commute_time(graph, values[name].weights) / best - 1
        row(graph, f"{name}, {len(rules)} constraints", timing, above, "")
    what = "walk with the least commute time, edges and vertices bounded"
    return rows_of("commute", what, size_of(graph), timings)


def alone(graph: Graph) -> Row:
    """Time our solver on a graph that is too large for the others."""
    seconds, walk = timed(lambda: minimum_commute(graph, tolerance=1e-6))
    timing, certificate = Timing.of(seconds, [seconds]), walk.certificate
    name = "jaxcell (gap for the optimum)"
    row(graph, name, timing, certificate.residual, certificate.iterations)
    return Row("commute", "walk with the least commute time", size_of(graph), seconds)


def main() -> None:
    full = "larger grids for each solver, and graphs of 2,000 and 2,800 vertices"
    arguments = options(__doc__, repeats=5, full=full).parse_args()
    begin("jax", "numpy", "scipy", "cvxpy")
    names = ("program", "min, s", "median, s", "above the optimum", "steps")
    header("vertices", "edges", *names, words=3)
    rows = []
    for side, blocked in ((4, 3), (6, 7), (15, 37)):
        rows += side_by_side(side, blocked, arguments.repeats, arguments.full)
    rows += constrained(6, 7, arguments.repeats, True)
    rows += constrained(15, 0, arguments.repeats, False)
    if arguments.full:
        rows.append(alone(neighbours(2000, 8000)))
        rows.append(alone(neighbours(2800, 10_400)))
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
