"""Exact probabilities of capture: the probability that robots on a graph reach a target in time."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Array, Float, Int

from ...base.precision import require_x64
from ...optimize import Graph
from ..team.times import move_times, names_of


def walk_capture_probabilities(
    graph: Graph, matrix: Any, attack_time: Any, travel_times: Any = None
) -> Float[np.ndarray, "starts targets"]:
    """Compute the probability that a robot reaches a target within the attack time.

    The attack begins as the robot leaves its start. If the target is the start, the robot must
    return to it; a robot that stays returns after a time of 1.

    **Arguments:**

    - `graph`, `matrix`: the graph, and the transition matrix of the robot, an array `[states,
        states]`. Its states are the vertices, or for a robot with memory the pairs of a state of
        the memory and a vertex, where the vertex varies fastest.
    - `attack_time`: duration of an attack, a whole number, or array `[vertices]` of them.
    - `travel_times`: array `[edges]`, travel time of each edge, whole numbers; by default 1.

    **Returns:** array `[states, vertices]`: rows are starts, columns are targets.

    A random walk on a line of three vertices, against attacks of two steps:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]])
        >>> matrix = [[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]]
        >>> patrol.walks.walk_capture_probabilities(graph, matrix, 2).tolist()
        [[0.5, 1.0, 0.5], [0.5, 1.0, 0.5], [0.5, 1.0, 0.5]]
    """
    delays, attack = whole_numbers(graph, attack_time, travel_times)
    given = np.array(matrix, np.float64)
    memory = max(1, given.shape[0] // graph.vertices)
    delays = np.tile(delays, (memory, memory))
    if given.shape != delays.shape:
        raise ValueError(
            f"matrix: expected {[graph.vertices] * 2}, or a multiple for a robot with memory, got "
            f"{list(given.shape)}"
        )
    if not (given >= 0).all() or np.abs(given.sum(axis=1) - 1).max() > 1e-9:
        raise ValueError("matrix: expected rows of numbers of at least 0 that sum to 1")
    wrong = np.argwhere((given > 0) & (delays == 0))
    if wrong.size:
        raise ValueError(f"matrix{wrong[0].tolist()} is positive, but not an edge of the graph")
    require_x64("walk_capture_probabilities")
    return np.asarray(first_passage(given, *on_device(delays, attack)))


def captured_by_any(
    probability: Float[np.ndarray, "robots starts targets"],
) -> Float[np.ndarray, "targets"]:
    """Compute the probability that any robot arrives in time, each from its worst start."""
    return 1 - (1 - probability.min(axis=1)).prod(axis=0)


@jax.jit
def first_passage(
    P: Float[Array, "states states"],
    seen: Float[Array, "states targets"],
    delays: Int[Array, "states states"],
    attack: Int[Array, "targets"],
    longest: Float[Array, "delays"],
    horizon: Float[Array, "times"],
) -> Float[Array, "states targets"]:
    """Compute the probability that a robot from each state reaches each target in its attack time.

    The probability at time `k` is `F_k(i, j) = sum_l p_il ([t_il = k, l at j] + [l not at j] F_(k -
    t_il)(l, j))`, with `t` the `delays`; state `l` is at target `j` if `seen[l, j]` is 1. JAX
    compiles for the lengths of `longest` and `horizon`, the largest delay and attack time.
    """
    each = jnp.arange(1, longest.size + 1, dtype=delays.dtype)
    moves = jnp.where(delays[None] == each[:, None, None], P[None], 0.0)

    def step(state, time):  # type: ignore[no-untyped-def]
        later, captured = state
        first = jnp.einsum("dil,dlj->ij", moves, later)
        captured = captured + jnp.where((time <= attack)[None, :], first, 0.0)
        return (jnp.concatenate([((1 - seen) * first)[None], later[:-1]]), captured), None

    # With no time left, a robot that is at the target has arrived.
    later = jnp.zeros((longest.size, *seen.shape), P.dtype).at[0].set(seen)
    times = jnp.arange(1, horizon.size + 1, dtype=delays.dtype)
    return jax.lax.scan(step, (later, jnp.zeros(seen.shape, P.dtype)), times)[0][1]


def states_at(states: int, vertices: int) -> Float[np.ndarray, "states vertices"]:
    """Return the matrix that is 1 where a state is at a vertex; the vertex varies fastest."""
    return np.tile(np.eye(vertices), (states // vertices, 1))


def whole_numbers(
    graph: Graph, attack_time: Any, travel_times: Any
) -> tuple[Int[np.ndarray, "vertices vertices"], Int[np.ndarray, "vertices"]]:
    """Check that times are whole; return those of moves (0 if no edge) and of attacks."""
    attack = _whole("attack_time", attack_time, graph.vertices, "vertex")
    given = 1 if travel_times is None else travel_times
    times = _whole("travel_times", given, len(graph.edges), "edge")
    return move_times(graph, times).astype(np.int32), attack


def check_reach(
    delays: Int[np.ndarray, "vertices vertices"],
    attack: Int[np.ndarray, "vertices"],
    names: Sequence[str] | None = None,
    unit: float = 1.0,
    *,
    stay: bool = False,
) -> None:
    """Raise an error if an attack ends before robots from all vertices can reach its target.

    A robot at the target must return to it; if robots may `stay`, this takes a time of 1.
    """
    needed = scipy.sparse.csgraph.shortest_path(delays.astype(float))
    same = np.eye(len(delays))
    away = 2 * np.where((delays > 0) & (same == 0), delays, np.inf).min(axis=1)
    np.fill_diagonal(needed, 1.0 if stay else away)
    # Of equal lacks of time, the first between two vertices is named.
    start, end = np.unravel_index(np.argmax(needed - attack - 0.5 * same), needed.shape)
    if needed[start, end] > attack[end]:
        first, last = (names_of(len(delays), names)[vertex] for vertex in (start, end))
        raise ValueError(
            f"attack_time: a robot needs {needed[start, end] * unit:g} from vertex {first} to "
            f"vertex {last}, where an attack takes {attack[end] * unit:g}; expected that at least"
        )


def on_device(
    delays: Int[np.ndarray, "states states"], attack: Int[np.ndarray, "targets"]
) -> tuple[Array, Array, Array, Array, Array]:
    """Return all arguments of [`first_passage`][] except the transition matrix."""
    slots = np.zeros(delays.max()), np.zeros(attack.max())
    return jax.device_put((states_at(len(delays), attack.size), delays, attack, *slots))


def _whole(name: str, given: Any, count: int, what: str) -> Int[np.ndarray, "count"]:
    numbers = np.asarray(given)
    if numbers.shape not in ((), (count,)) or not np.issubdtype(numbers.dtype, np.integer):
        raise ValueError(
            f"{name}: expected a whole number, or {count}, one per {what}, got an array of "
            f"{numbers.dtype} with shape {list(numbers.shape)}"
        )
    numbers = np.broadcast_to(numbers, count)
    if numbers.min() < 1:
        wrong = int(np.argmin(numbers))
        raise ValueError(f"{name}: expected at least 1, got {numbers[wrong]} for {what} {wrong}")
    return numbers.astype(np.int32)
