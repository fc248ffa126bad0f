import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..base.certificate import Certificate
from ..base.connected import vertices_apart
from ..base.precision import require_x64
from .graph import Graph
from .resistance import Design, Emphasis, follow
from .tour import on_walk, shortest_tour


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class CommuteSweep:
    """The weights with the least commute time, for many problems on one graph."""

    weights: Float[Array, "*batch edges"]
    "The weight of each edge; they are not negative and sum to 1, or are NaN."
    commute_time: Float[Array, "*batch"]
    "The expected number of steps from a vertex to another and back, mean over pairs of vertices."
    gap: Float[Array, "*batch"]
    "The relative duality gap: no weights have a time below `(1 - gap) commute_time`."
    iterations: Int[Array, "*batch"]
    "Number of steps."


def minimum_commute_sweep(
    graph: Graph,
    *,
    allowed: Any = None,
    emphasis: Sequence[Sequence[int]] | None = None,
    share: Any = 0.8,
    tolerance: float = 1e-8,
    throw: bool = True,
) -> CommuteSweep:
    """Solve [`minimum_commute`][jaxcell.optimize.minimum_commute] for many problems in one batch.

    A batch takes a fourth of the time of the problems one by one: see the rows `least commute times
    of ..., in one batch` of the benchmarks.

    A problem is a set of edges, an emphasis and a share. Arguments with several problems must have
    equally many; an argument with one problem is the same for all.

    **Arguments:**

    - `graph`: the graph.
    - `allowed`: boolean array `[problems, edges]`, the edges that may have weight; all by default.
    - `emphasis`: for each problem, two or more vertices to visit more often. Their closed tour is
        the shortest along the allowed edges.
    - `share`: the least sum of the weights on the edges of that tour, 0 or more and less than 1;
        array `[problems]`, or one number.
    - `tolerance`: tolerance of the relative gaps.
    - `throw`: whether to raise when an answer is not good enough.

    **Returns:** [`CommuteSweep`][] with the axis of the problems. If the allowed edges do not
    connect all vertices, the time is `inf`, the gap 0, and the weights are NaN.

    **Raises:** `ValueError` for wrong arguments; `RuntimeError` if a gap does not close.

    A triangle, with all edges and without the last:

        >>> import numpy as np
        >>> from jaxcell import optimize
        >>> graph = optimize.Graph([[0, 1], [1, 2], [0, 2]])
        >>> allowed = np.array([[True, True, True], [True, True, False]])
        >>> (6 * optimize.minimum_commute_sweep(graph, allowed=allowed).weights).round(3).tolist()
        [[2.0, 2.0, 2.0], [3.0, 3.0, 0.0]]
    """
    edges = len(graph.edges)
    allowed = np.ones((1, edges), bool) if allowed is None else np.asarray(allowed)
    if allowed.ndim != 2 or allowed.shape[1] != edges or allowed.dtype != np.bool_:
        raise ValueError(
            f"allowed: expected booleans [problems, {edges}], got {allowed.dtype} "
            f"{list(allowed.shape)}"
        )
    share = np.atleast_1d(np.asarray(share, np.float64))
    if share.ndim != 1 or not ((share >= 0) & (share < 1)).all():
        raise ValueError(f"share: expected numbers of 0 or more and less than 1, got {share}")
    if not tolerance > 0:
        raise ValueError(f"tolerance: expected a positive number, got {tolerance}")
    counts = {"allowed": len(allowed), "share": len(share)}
    if emphasis is not None:
        counts["emphasis"] = len(emphasis)
    problems = max(counts.values())
    for name, count in counts.items():
        if count not in (1, problems):
            raise ValueError(f"{name}: expected one problem, or {problems}, got {count}")
    allowed = np.broadcast_to(allowed, (problems, edges))
    on_tour = np.ones((problems, edges), bool)
    share = np.broadcast_to(0.0 if emphasis is None else share, problems)
    if emphasis is not None:
        for problem in range(problems):
            stops = emphasis[problem % len(emphasis)]
            on_tour[problem] = _on_tour(graph, stops, allowed[problem], problem)
    solved = _solve_all(graph.vertices, graph.edges, on_tour, allowed, share, tolerance)
    worst = int(np.argmax(np.nan_to_num(np.asarray(solved.gap), nan=np.inf)))
    certificate = Certificate(int(solved.iterations[worst]), float(solved.gap[worst]), tolerance)
    certificate.check(f"minimum_commute_sweep, problem {worst}", throw)
    return solved


def _on_tour(
    graph: Graph, stops: Sequence[int], allowed: Bool[np.ndarray, "edges"], problem: int
) -> Bool[np.ndarray, "edges"]:
    """Return the edges of a tour along the allowed edges; all of these, if they do not connect all
    vertices."""
    edges = graph.edges[allowed]
    if vertices_apart(graph.vertices, edges) is not None:
        return allowed
    ways = None if graph.ways is None else graph.ways[allowed]
    part = Graph(edges, graph.vertices, graph.xy, ways)
    try:
        tour = shortest_tour(part, stops)
    except ValueError as error:
        raise ValueError(f"emphasis[{problem}]: {error}") from None
    return on_walk(graph, tour)


@functools.partial(jax.jit, static_argnames="vertices")
def commute_weights(
    vertices: int,
    edges: Int[Array, "edges 2"],
    on_tour: Bool[Array, "edges"],
    allowed: Bool[Array, "edges"],
    share: Float[Array, ""],
    tolerance: Float[Array, ""],
) -> CommuteSweep:
    """Solve one problem of [`minimum_commute_sweep`][] on arrays only, under `jit` and `vmap`.

    The steps are those of [`minimum_commute`][jaxcell.optimize.minimum_commute], in dense linear
    algebra of fixed shapes.

    **Arguments:**

    - `vertices`: number of vertices.
    - `edges`: the two ends of each edge.
    - `on_tour`: the emphasised edges; all edges, with share 0, for no emphasis.
    - `allowed`: the edges that may have weight.
    - `share`: the least sum of the weights on the tour, less than 1.
    - `tolerance`: tolerance of the relative gap.

    **Returns:** [`CommuteSweep`][] without an axis for problems.

    **Raises:** `RuntimeError` where JAX is set to 32 bits.

    A line of three vertices, without emphasis:

        >>> import jax.numpy as jnp
        >>> from jaxcell import optimize
        >>> edges, both = jnp.array([[0, 1], [1, 2]]), jnp.array([True, True])
        >>> share, tolerance = jnp.array(0.0), jnp.array(1e-8)
        >>> best = optimize.commute_weights(3, edges, both, both, share, tolerance)
        >>> best.weights.round(3).tolist()
        [0.5, 0.5]
    """
    require_x64("commute_weights")
    number = jnp.arange(edges.shape[0])
    differences = jnp.zeros((edges.shape[0], vertices))
    differences = differences.at[number, edges[:, 0]].set(1.0).at[number, edges[:, 1]].set(-1.0)
    differences = jnp.where(allowed[:, None], differences, 0.0)
    connected = _connected(differences)
    # Without a solution all numbers are NaN, and no steps are taken.
    differences = jnp.where(connected, differences, jnp.nan)
    problem = Emphasis(on_tour & allowed, share, allowed)
    design, divide = (
        functools.partial(_design, differences),
        functools.partial(_divide, differences),
    )
    best, steps = follow(problem, design, divide, tolerance, jax.lax.while_loop)
    return CommuteSweep(
        weights=jnp.where(connected, best.numbers[:-1], jnp.nan),
        commute_time=jnp.where(connected, 4 * best.resistance / (vertices - 1), jnp.inf),
        gap=jnp.where(connected, best.gap, 0.0),
        iterations=steps,
    )


def _connected(differences: Float[Array, "edges vertices"]) -> Bool[Array, ""]:
    """Check that edges connect all vertices, by squaring the adjacency relation."""
    vertices = differences.shape[1]
    near = (jnp.abs(differences.T @ differences) + jnp.eye(vertices)) > 0
    for _ in range(max(1, (vertices - 1).bit_length())):
        near = near.astype(float) @ near.astype(float) > 0
    return jnp.all(near)


def _design(
    differences: Float[Array, "edges vertices"], numbers: Float[Array, "numbers"]
) -> Design:
    edges, vertices = differences.shape
    laplacian = differences.T @ (numbers[:edges, None] * differences)
    # A constant moves the eigenvalue 0 into the range of the other eigenvalues.
    shift = jnp.trace(laplacian) / vertices
    factor = jnp.linalg.cholesky(laplacian + shift / vertices)
    inverse = jax.scipy.linalg.cho_solve((factor, True), jnp.eye(vertices))
    columns = differences @ inverse
    return Design(jnp.trace(inverse) - 1 / shift, jnp.sum(columns**2, axis=1), columns)


def _divide(
    differences: Float[Array, "edges vertices"],
    design: Design,
    unit: Float[Array, ""],
    diagonal: Float[Array, "numbers"],
) -> Callable[[Float[Array, "numbers *sides"]], Float[Array, "numbers *sides"]]:
    """Return a function that divides by the Hessian plus a diagonal."""
    columns = design.columns
    hessian = 2 / unit * (columns @ columns.T) * (columns @ differences.T)
    beside = diagonal.size - columns.shape[0]
    factor = jnp.linalg.cholesky(jnp.diag(diagonal) + jnp.pad(hessian, (0, beside)))
    return lambda sides: jax.scipy.linalg.cho_solve((factor, True), sides)


_solve_all = jax.jit(
    jax.vmap(commute_weights, in_axes=(None, None, 0, 0, 0, None)), static_argnums=0
)
