"""Exact probabilities of capture: the probability that robots on a graph reach a target in time."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Array, Float, Int

from ...base.certificate import Numbers
from ...base.divided import start_loop
from ...base.precision import require_x64
from ...base.wide import host_array, traced
from ...optimize import Graph, GraphLike
from ..team.division import divide_graph
from ..team.idleness import long_run
from ..team.times import check_whole, directed_times, move_times, names_of


def walk_capture_probabilities(
    graph: GraphLike, matrix: Any, attack_time: Any, travel_times: Any = None
) -> Float[Numbers, "starts targets"]:
    """Compute the probability that a robot reaches a target within the attack time.

    The attack begins as the robot leaves its start. If the target is the start, the robot must
    return to it; a robot that stays returns after a time of 1.

    **Arguments:**

    - `graph`, `matrix`: the graph, and the transition matrix of the robot, an array `[states,
        states]`. Its states are the vertices, or for a robot with memory the pairs of a state of
        the memory and a vertex, where the vertex varies fastest.
    - `attack_time`: duration of an attack, a whole number, or array `[vertices]` of them.
    - `travel_times`: array `[edges]`, travel time of each edge, whole numbers; by default 1. In an
        array `[vertices, vertices]` rows are starts, the diagonal is waits, and 0 is no way.

    **Returns:** array `[states, vertices]`: rows are starts, columns are targets. The matrix may be
    traced by `jit`, `vmap` and `grad`; then it is not checked.

    A random walk on a line of three vertices, against attacks of two steps:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]])
        >>> matrix = [[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]]
        >>> patrol.walks.walk_capture_probabilities(graph, matrix, 2).tolist()
        [[0.5, 1.0, 0.5], [0.5, 1.0, 0.5], [0.5, 1.0, 0.5]]
    """
    given, delays, attack = _checked(graph, matrix, attack_time, travel_times)
    require_x64("walk_capture_probabilities")
    return host_array(first_passage(given, *on_device(delays, attack)))


def captured_by_any(
    probability: Float[np.ndarray, "robots starts targets"],
) -> Float[np.ndarray, "targets"]:
    """Compute the probability that any robot arrives in time, each from its worst start."""
    return 1 - (1 - probability.min(axis=1)).prod(axis=0)


def watched_capture(
    graph: Graph,
    walks: Any,
    shares: Float[np.ndarray, "robots states"],
    attack_time: Any,
    travel_times: Any = None,
) -> Float[np.ndarray, "targets"]:
    """Compute the probability that any robot arrives in time, each from its worst start.

    The worst start is among the states that occur in the long run, where `shares` are positive.
    """
    attack = check_whole("attack_time", attack_time, graph.vertices, "vertex")
    watched, _ = captures_over_time(graph, walks, shares, int(attack.max()), travel_times)
    return np.asarray(watched[attack, np.arange(attack.size)])


def blind_capture(
    graph: GraphLike, walks: Any, attack_time: Any, travel_times: Any = None
) -> Float[Numbers, "targets"]:
    """Compute the probability that independent robots capture an attack at a random time.

    The adversary knows neither places nor times of the robots, which have been walking for long,
    each on its own. If the time `R` between two visits of a robot to a vertex has a mean of `E[R]`,
    the robot is there in time with the probability `E[min(R, attack_time)] / E[R]`.

    **Arguments:** as in [`walk_capture_probabilities`][], but `walks` are the transition matrices
    of all robots, an array `[robots, states, states]`. **Returns:** array `[vertices]`.

    A robot that goes to and fro on a line of three vertices is at each end in every fourth step:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]])
        >>> walk = [[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]]
        >>> patrol.walks.blind_capture(graph, [walk], 1).tolist()
        [0.25, 0.5, 0.25]
    """
    require_x64("blind_capture")
    attack = check_whole("attack_time", attack_time, graph.vertices, "vertex")
    given = long_run(walks), int(attack.max()), travel_times
    return captures_over_time(graph, walks, *given)[1][attack, np.arange(attack.size)]


def captures_over_time(
    graph: GraphLike,
    walks: Any,
    shares: Float[Numbers, "robots states"],
    longest: int,
    travel_times: Any = None,
) -> tuple[Float[Numbers, "times targets"], Float[Numbers, "times targets"]]:
    """Compute the least and the blind probability of capture for attacks of all durations at once.

    **Arguments:** as in [`blind_capture`][]; the shares of time of each robot in the long run, see
    [`jaxcell.patrol.team.long_run`][]; and the longest duration of an attack. **Returns:** the
    probability that any robot arrives in time if each starts at the worst of the states where its
    share is positive, and if the attack begins at a random time; row `t` is for attacks that take a
    time of `t`. A row does not depend on `longest`.

    A random walk round a triangle:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2], [2, 0]])
        >>> walk = [[0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]]
        >>> share = patrol.team.long_run([walk])
        >>> watched, blind = patrol.walks.captures_over_time(graph, [walk], share, 3)
        >>> watched[:, 0].round(6).tolist(), blind[:, 0].round(6).tolist()
        ([0.0, 0.0, 0.5, 0.75], [0.0, 0.333333, 0.666667, 0.833333])
    """
    missed = [np.ones((longest + 1, graph.vertices))] * 2
    for walk, share in zip(walks, shares, strict=True):
        given, delays, attack = _checked(graph, walk, longest, travel_times)
        found = _over_time(given, share, *on_device(delays, attack))
        missed = [all_ * (1 - one) for all_, one in zip(missed, found, strict=True)]
    watched, blind = (host_array(1 - each) for each in missed)
    return watched, blind


def _checked(
    graph: Graph, matrix: Any, attack_time: Any, travel_times: Any
) -> tuple[
    Float[Numbers, "states states"],
    Int[np.ndarray, "states states"],
    Int[np.ndarray, "vertices"],
]:
    """Check a walk; return its matrix, and the times of its moves and of attacks."""
    delays, attack = whole_numbers(graph, attack_time, travel_times)
    given = matrix if traced(matrix) else np.array(matrix, np.float64)
    memory = max(1, given.shape[0] // graph.vertices)
    delays = np.tile(delays, (memory, memory))
    if given.shape != delays.shape:
        raise ValueError(
            f"matrix: expected {[graph.vertices] * 2}, or a multiple for a robot with memory, got "
            f"{list(given.shape)}"
        )
    if traced(given):
        return given, delays, attack
    if not (given >= 0).all() or np.abs(given.sum(axis=1) - 1).max() > 1e-9:
        raise ValueError("matrix: expected rows of numbers of at least 0 that sum to 1")
    wrong = np.argwhere((given > 0) & (delays == 0))
    if wrong.size:
        raise ValueError(f"matrix{wrong[0].tolist()} is positive, but not an edge of the graph")
    return given, delays, attack


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
    times = jnp.arange(1, horizon.size + 1, dtype=attack.dtype)
    in_time = (attack[None, :] >= times[:, None]).astype(P.dtype)
    step, later = _first_visits(P, seen, delays, longest)

    def count(state, in_time):  # type: ignore[no-untyped-def]
        later, total = state
        first, later = step(later)
        return (later, total + in_time[None, :] * first), None

    start = start_loop((later, jnp.zeros(seen.shape, P.dtype)), P, seen, in_time)
    return jax.lax.scan(count, start, in_time)[0][1]


@jax.jit
def _over_time(
    P: Float[Array, "states states"],
    share: Float[Array, "states"],
    seen: Float[Array, "states targets"],
    delays: Int[Array, "states states"],
    attack: Int[Array, "targets"],
    longest: Float[Array, "delays"],
    horizon: Float[Array, "times"],
) -> tuple[Float[Array, "durations targets"], Float[Array, "durations targets"]]:
    """Compute the least and the blind probability of capture after times of 0, 1, 2, ..."""
    step, later = _first_visits(P, seen, delays, longest)
    # Per unit of time: the mean number of departures from each state.
    often = share / (share @ (P * delays.astype(P.dtype)).sum(axis=1))

    def extend(state, _):  # type: ignore[no-untyped-def]
        later, arrived, early = state
        first, later = step(later)
        # The mean of the smaller of the time until a visit and the duration of an attack.
        early = early + (1 - arrived)
        arrived = arrived + first
        watched = jnp.where(share[:, None] > 0, arrived, 1.0).min(axis=0)
        return (later, arrived, early), (watched, (often[:, None] * seen * early).sum(axis=0))

    none = jnp.zeros(seen.shape, P.dtype)
    start = start_loop((later, none, none), P, seen, share)
    after = jax.lax.scan(extend, start, horizon)[1]
    watched, blind = (jnp.concatenate([jnp.zeros_like(each[:1]), each]) for each in after)
    return watched, blind


def _first_visits(
    P: Float[Array, "states states"],
    seen: Float[Array, "states targets"],
    delays: Int[Array, "states states"],
    longest: Float[Array, "delays"],
) -> tuple[Any, Float[Array, "delays states targets"]]:
    """Return a function that computes first visits at the next time, and its first argument."""
    each = jnp.arange(1, longest.size + 1, dtype=delays.dtype)
    moves = jnp.where(delays[None] == each[:, None, None], P[None], 0.0)

    def step(later: Float[Array, "delays states targets"]) -> tuple[Array, Array]:
        first = jnp.einsum("dil,dlj->ij", moves, later)
        return first, jnp.concatenate([((1 - seen) * first)[None], later[:-1]])

    # With no time left, a robot that is at the target has arrived.
    return step, jnp.zeros((longest.size, *seen.shape), P.dtype).at[0].set(seen)


def states_at(states: int, vertices: int) -> Float[np.ndarray, "states vertices"]:
    """Return the matrix that is 1 where a state is at a vertex; the vertex varies fastest."""
    return np.tile(np.eye(vertices), (states // vertices, 1))


def whole_numbers(
    graph: Graph, attack_time: Any, travel_times: Any
) -> tuple[Int[np.ndarray, "vertices vertices"], Int[np.ndarray, "vertices"]]:
    """Check that times are whole; return those of moves (0 if no edge) and of attacks."""
    attack = check_whole("attack_time", attack_time, graph.vertices, "vertex")
    if np.ndim(travel_times) == 2:
        return directed_times(graph, travel_times), attack
    given = 1 if travel_times is None else travel_times
    times = check_whole("travel_times", given, len(graph.edges), "edge")
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
    if (reason := out_of_reach(delays, attack, names, unit, stay=stay)) is not None:
        raise ValueError(reason)


def out_of_reach(
    delays: Int[np.ndarray, "vertices vertices"],
    attack: Int[np.ndarray, "vertices"],
    names: Sequence[str] | None = None,
    unit: float = 1.0,
    *,
    stay: bool = False,
) -> str | None:
    """Return the reason why a robot at some vertex is too far from a target, or `None`."""
    needed = scipy.sparse.csgraph.shortest_path(delays.astype(float))
    same = np.eye(len(delays))
    away = 2 * np.where((delays > 0) & (same == 0), delays, np.inf).min(axis=1)
    np.fill_diagonal(needed, 1.0 if stay else away)
    # Of equal lacks of time, the first between two vertices is named.
    start, end = np.unravel_index(np.argmax(needed - attack - 0.5 * same), needed.shape)
    if needed[start, end] <= attack[end]:
        return None
    first, last = (names_of(len(delays), names)[vertex] for vertex in (start, end))
    return (
        f"attack_time: a robot needs {needed[start, end] * unit:g} from vertex {first} to "
        f"vertex {last}, where an attack takes {attack[end] * unit:g}; expected that at least"
    )


def parts_within_reach(
    graph: Graph,
    delays: Int[np.ndarray, "vertices vertices"],
    attack: Int[np.ndarray, "vertices"],
    robots: int,
    names: Sequence[str] | None = None,
    unit: float = 1.0,
    *,
    stay: bool = False,
) -> Int[np.ndarray, "vertices"]:
    """Divide a graph among robots, and raise an error if a robot is too slow for its part."""
    called = names_of(graph.vertices, names)
    try:
        region = divide_graph(graph, robots, names=called)
    except ValueError as error:
        slow = out_of_reach(delays, attack, called, unit, stay=stay)
        raise ValueError(f"{slow}; and robots that patrol parts are too many: {error}") from None
    for robot in range(robots):
        inside = np.flatnonzero(region == robot)
        own = [called[vertex] for vertex in inside.tolist()]
        near = delays[np.ix_(inside, inside)]
        if (reason := out_of_reach(near, attack[inside], own, unit, stay=stay)) is not None:
            raise ValueError(f"{reason}, or more robots: each of {robots} patrols a part")
    return region


def on_device(
    delays: Int[np.ndarray, "states states"], attack: Int[np.ndarray, "targets"]
) -> tuple[Array, Array, Array, Array, Array]:
    """Return all arguments of [`first_passage`][] except the transition matrix."""
    slots = np.zeros(delays.max()), np.zeros(attack.max())
    return jax.device_put((states_at(len(delays), attack.size), delays, attack, *slots))
