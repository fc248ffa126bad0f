"""Time walks that maximize capture beside RoSSO, and compare their capture.

Run `python experiments/benchmarks/bench_rosso.py`; it takes about 40 s, and with `--full` 2 minutes
for larger grids. `--rosso FOLDER` is the folder `robosurvstratopt` of a checkout of
github.com/conhugh/RoSSO (Hughes, John and Bullo, ICRA 2024). Without it, the table has only its
published results, and no time. `--memory 8` adds the capture of robots with up to 8 states of
memory, a tour, and an upper bound, which takes many minutes.

RoSSO runs with the optimizer of its specification of San Francisco (RMSprop, 5 random starts), on
a grid of 3 by 3, a star, a line, San Francisco as it is specified, and a complete graph with the
longer of its times of both directions, without shares. RoSSO meets shares by a penalty, and the
largest error of a share is printed. The capture of both programs is computed by
our exact law.
"""

import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import optax
from rows import Row, options, write_rows
from timing import begin, header, line

from jaxcell.optimize import Graph
from jaxcell.patrol import maximin_capture
from jaxcell.patrol.walks import memory_patrol, walk_capture_probabilities


# Times between 12 crossings and their shares of moves, the directed `weight_matrix` and the
# `stationary_distribution` of RoSSO's `SF_problem_spec.json`; the weight of its penalty.
DIRECTED_TIMES = """
1 3 3 5 4 6 3 5 7 4 6 6
3 1 5 4 2 4 4 5 5 3 5 5
3 5 1 7 6 8 3 4 9 4 8 7
6 4 7 1 5 6 4 7 5 6 6 7
4 3 6 5 1 3 5 5 6 3 4 4
6 4 8 5 3 1 6 7 3 6 2 3
2 5 3 5 6 7 1 5 7 5 7 8
3 5 2 7 6 7 3 1 9 3 7 5
8 6 9 4 6 4 6 9 1 8 5 7
4 3 4 6 3 5 5 3 7 1 5 3
6 4 8 6 4 2 6 6 4 5 1 3
6 4 6 6 3 3 6 4 5 3 2 1
"""
SHARES = [
    0.1536, 0.1039, 0.1028, 0.1005, 0.0958, 0.0958, 0.0855, 0.0739, 0.0554, 0.0497, 0.0439, 0.0392
]  # fmt: skip
PENALTY = 10.0
STARTS, ITERATIONS, WINDOW, STILL, RATE = 5, 10_000, 10, 0.0025, 0.1


class Case(NamedTuple):
    """A graph, the steps of an attack, and the best published result of RoSSO."""

    name: str
    graph: Graph
    attack_time: int
    published: float | None = None
    travel_times: np.ndarray | None = None
    stay: bool = False
    shares: list[float] | None = None


def of(graph: nx.Graph) -> Graph:
    return Graph(np.array(nx.convert_node_labels_to_integers(graph).edges))


def cases(full: bool) -> list[Case]:
    ways = np.array(DIRECTED_TIMES.split(), int).reshape(12, 12)
    complete = of(nx.complete_graph(12))
    times = np.maximum(ways, ways.T)[tuple(complete.edges.T)]
    found = [
        Case("grid 3 x 3", of(nx.grid_2d_graph(3, 3)), 4, 0.1581),
        Case("star", of(nx.star_graph(8)), 2, 0.12471),
        Case("line", of(nx.path_graph(9)), 8, 0.0),
        Case("San Francisco", complete, 10, None, ways, True, SHARES),
        Case("12 crossings, symmetric times", complete, 10, None, times, True),
    ]
    grids = [(5, 10), (6, 12), (8, 16)] if full else []
    return found + [Case(f"grid {n} x {n}", of(nx.grid_2d_graph(n, n)), t) for n, t in grids]


def captured(case: Case, matrix: np.ndarray) -> float:
    """Compute the least probability of capture of a walk."""
    given = case.graph, matrix, case.attack_time, case.travel_times
    return float(walk_capture_probabilities(*given).min())


def ours(case: Case) -> np.ndarray:
    options = {"travel_times": case.travel_times, "stay": case.stay, "throw": False}
    options["stationary"] = case.shares
    return maximin_capture(case.graph, case.attack_time, **options).matrices[0]


def theirs(case: Case) -> np.ndarray:
    """Compute the best walk of RoSSO from random starts."""
    import strat_comp

    n, attack = case.graph.vertices, case.attack_time
    adjacent = case.graph.matrix(np.ones(len(case.graph.edges))).toarray() + case.stay * np.eye(n)
    A = jnp.asarray(adjacent, jnp.float32)
    if case.travel_times is None:
        empty = jnp.full((n, n, attack), jnp.nan, jnp.float32)

        def least(Q: jax.Array) -> jax.Array:
            return strat_comp.loss_LCP(Q, A, empty, attack)
    else:
        W = case.travel_times
        if W.ndim == 1:
            W = case.graph.matrix(W).toarray() + case.stay * np.eye(n)
        longest, W = int(W.max()), jnp.asarray(W, jnp.int32)
        before = strat_comp.precompute_weighted_Stackelberg(W, longest, attack)

        def least(Q: jax.Array) -> jax.Array:
            if case.shares is None:
                return strat_comp.loss_weighted_LCP(Q, A, before, W, longest, attack)
            given = Q, A, before, W, longest, attack, tuple(case.shares), PENALTY
            return strat_comp.loss_weighted_LCP_pi(*given)

    slope = jax.jit(jax.value_and_grad(lambda Q: -least(Q)))
    walks = [
        descended(Q, slope) for Q in strat_comp.oop_init_rand_Ps(A, 1, STARTS, jax.random.key(0))
    ]
    matrices = [np.asarray(strat_comp.comp_P_param(Q, A), float) for Q in walks]
    exact = [matrix / matrix.sum(axis=1, keepdims=True) for matrix in matrices]
    return max(exact, key=lambda matrix: captured(case, matrix))


def descended(Q: jax.Array, slope: Callable[[jax.Array], tuple[jax.Array, jax.Array]]) -> jax.Array:
    """Run the optimizer of RoSSO with its stopping rule."""
    largest = float(jnp.abs(slope(Q)[1]).max())
    optimizer = optax.rmsprop(RATE / max(largest, 1e-12))
    state, before, changes = optimizer.init(Q), 1000.0, deque(maxlen=WINDOW)

    @jax.jit
    def step(Q, state):  # type: ignore[no-untyped-def]
        loss, gradient = slope(Q)
        change, state = optimizer.update(gradient, state)
        return optax.apply_updates(Q, change), state, loss

    for iteration in range(ITERATIONS):
        Q, state, loss = step(Q, state)
        now = float(loss)
        changes.append(abs((now - before) / before) if before else 0.0)
        before = now
        if iteration > WINDOW and np.mean(changes) < STILL:
            break
    return Q


def timed(find: Callable[[Case], np.ndarray], case: Case) -> tuple[float, float]:
    """Time a search, and return its seconds and its capture."""
    began = time.perf_counter()
    matrix = find(case)
    seconds = time.perf_counter() - began
    if case.shares is not None:
        wrong = float(abs(case.shares @ matrix - case.shares).max())
        print(f"{find.__name__}: the largest error of a share is {wrong:.1g}")
    return seconds, captured(case, matrix)


def row(case: Case, peer: bool) -> Row:
    seconds, found = timed(ours, case)
    peer_s, theirs_found = timed(theirs, case) if peer else (None, None)
    shown = [f"{one:.5f}" if one is not None else "" for one in (case.published, theirs_found)]
    times = [f"{one:.1f}" if one is not None else "" for one in (seconds, peer_s)]
    line(case.name, case.attack_time, f"{found:.5f}", *shown, *times)
    best = theirs_found if theirs_found is not None else case.published
    beside = "" if best is None else f" (RoSSO {best:.4f})"
    what = f"walk that captures most, {found:.4f}{beside}"
    size = f"{case.name}, attacks of {case.attack_time} steps"
    return Row("rosso", what, size, seconds, "RoSSO, 5 starts", peer_s)


def print_memory(chosen: list[Case], most: int) -> None:
    """Print the least capture by the number of states of memory, a tour, and the bound."""
    sizes = [f"memory {2**k}" for k in range(most.bit_length())]
    header("graph", "attack", *sizes, "tour", "tour, any time", "bound", "s")
    for case in [case for case in chosen if case.shares is None]:
        began = time.perf_counter()
        given = {"travel_times": case.travel_times, "stay": case.stay}
        patrol = memory_patrol(case.graph, case.attack_time, most, ours(case)[None], **given)
        values = dict(zip(patrol.walk, patrol.least_capture.tolist(), strict=True))
        shown = [f"{values[name]:.4f}" if name in values else "" for name in (*sizes, "tour")]
        shown += [f"{patrol.any_time[-1]:.4f}", f"{patrol.upper_bound:.4f}"]
        line(case.name, case.attack_time, *shown, f"{time.perf_counter() - began:.0f}")


def main() -> None:
    parser = options(__doc__, repeats=1, full="grids up to 8 x 8")
    parser.add_argument("--rosso", type=Path, metavar="FOLDER", help="folder robosurvstratopt")
    parser.add_argument("--memory", type=int, default=1, help="largest number of memory states")
    arguments = parser.parse_args()
    if arguments.rosso is not None:
        sys.path.insert(0, str(arguments.rosso))
    begin("jax", "optax", "numpy")
    header("graph", "attack", "ours", "RoSSO, published", "RoSSO here", "ours, s", "RoSSO, s")
    chosen = cases(arguments.full)
    write_rows(arguments.rows, [row(case, arguments.rosso is not None) for case in chosen])
    if arguments.memory > 1:
        print()
        print_memory(chosen, arguments.memory)


if __name__ == "__main__":
    main()
