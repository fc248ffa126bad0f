import dataclasses
import functools
import itertools
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Array, Float, Int

from ....base.certificate import Certificate
from ....base.precision import require_x64
from ....base.process import one_blas_thread
from ....base.shown import Shown
from ....mapping import Chain
from ....optimize import Graph, GraphLike
from ....optimize.validation import check_count
from ...team.division import part_of_graph, walk_in_part
from ..arrival import (
    captured_by_any,
    check_reach,
    first_passage,
    on_device,
    out_of_reach,
    parts_within_reach,
    states_at,
    whole_numbers,
)
from ..steps import Steps, SymmetricSteps
from ..symmetries import MOST_SYMMETRIES, symmetries
from .ascent import ALL_TARGETS, Ascent, late_gain
from .descent import descend
from .polytope import ChainPolytope
from .sequential_lp import Captures, maximize_least_capture


# Hardness of the soft minimum of the logarithms in all descents, and then in those from the best
# chain, and the number of steps of the latter for each pressure. If the first hardness is smaller,
# all starts lead to the most symmetric chain.
_HARDNESS, _HARDER, _HARDER_STEPS = 50.0, (200.0, 800.0, 3000.0), 240
# Largest factor on the number of starts; squared number of vertices at which the factor is 1; and
# the least number of starts if the states of a memory are divided among symmetries.
_MORE, _QUICK, _SYMMETRIC = 4, 3600, 3
# Number of vertices up to which all linear programs are solved, and up to which any are solved.
EXACT, POLISHED = 30, 100
# Tolerance of the relative gain on larger graphs.
_LITTLE = 0.02
# Gradient steps from each start; the number of vertices above which they are halved; the hardness
# of the minimum at the start and at the end; and the least probability of a step.
STEPS, _LARGE, _ANNEALED, _FLOOR = 1200, 200, (1.0, 300.0), 1e-6
# The first hardness with memory: at a softer minimum all states of the memory become equal.
_WITH_MEMORY = 10.0
# Random factor on the moves to copies of a state of memory, and the least weight of a move.
_COPIED, _MOVED = (1.0, 2.0), 1e-3
# Relative tolerance of a value in 32 bits; and the largest probability of a negligible move.
_EQUAL, _RARE = 1e-5, 1e-5


_Matrices: TypeAlias = Float[np.ndarray, "robots states states"]


@dataclasses.dataclass(frozen=True, eq=False)
class MaximinCapture(Shown):
    """Chains of robots, and the least probability that they capture an adversary."""

    matrices: _Matrices
    """The transition matrix of each robot. Its states are the vertices, or for robots with memory
    the pairs of a state of the memory and a vertex, where the vertex varies fastest."""
    value: float
    """The least probability of capture over all targets and all positions of robots at the start
    that occur in the long run."""
    certificate: Certificate

    @property
    def chains(self) -> list[Chain]:
        """The Markov chain of each robot; the cells of a chain are the states."""
        return [Chain.from_scipy(scipy.sparse.csr_array(matrix)) for matrix in self.matrices]


def maximin_capture(
    graph: GraphLike,
    attack_time: Any,
    *,
    travel_times: Any = None,
    robots: int = 1,
    stay: bool = False,
    stationary: Any = None,
    memory: int = 1,
    known: Float[np.ndarray, "robots _ _"] | None = None,
    starts: int = 8,
    seed: int = 0,
    tolerance: float = 1e-4,
    throw: bool = True,
) -> MaximinCapture:
    """Find chains that maximise the least probability of capturing an all-knowing adversary.

    It runs on the host, because it compares local optima, and solves linear programs.

    The adversary attacks a vertex as a robot leaves this or another vertex, and is captured if a
    robot reaches the attacked vertex within the attack time. It knows the chains and sees the
    robots, so it attacks where and when the probability of [`walk_capture_probabilities`][] is
    least. Several robots move independently, each with its own chain, and all are at their worst
    positions at the same time. If a robot alone cannot cross the graph within the attack time, each
    robot of a team patrols a part of the graph, as [`jaxcell.patrol.team.divide_graph`][] finds it.

    The problem is not convex: the result is a local optimum, the best of several starts. Gradients
    of a soft minimum of logarithms, whose inverse temperature rises, lead near the optimum. If all
    edges and attacks take equally long, Adam follows these gradients on the logits. Linear programs
    over the nearly best attacks then reach the optimum.

    **Arguments:**

    - `graph`: a connected graph.
    - `attack_time`: duration of an attack, a whole number, or array `[vertices]` of them.
    - `travel_times`: array `[edges]`, travel time of each edge, whole numbers; by default 1. In an
        array `[vertices, vertices]` rows are starts, the diagonal is waits, and 0 is no way.
    - `robots`: number of robots.
    - `stay`: whether a robot may wait at a vertex, which takes a time of 1.
    - `stationary`: array `[vertices]`, the prescribed share of moves of each robot that begin at
        each vertex, without memory; by default they are free.
    - `memory`: number of states of the memory of a robot; 1 is a robot without memory. If the
        number of symmetries of the graph divides `memory`, and edges and attacks take equally long,
        the robot acts in the same way in symmetric positions, which makes the search faster.
    - `known`: the matrices of known walks of these robots, with at most `memory` states of memory.
        The search also starts from these walks, and the result captures at least as much.
    - `starts`: number of other starts. The first follows a short closed tour. If all edges and
        attacks take equally long, a small graph has up to four times as many starts, a graph of
        more than 60 vertices has fewer, and the number is divided by the number of robots.
    - `seed`: seed of the other starts, which are random.
    - `tolerance`: tolerance of the residual.
    - `throw`: whether to raise `RuntimeError` if the residual exceeds the tolerance.

    **Returns:** [`MaximinCapture`][]. The residual of its certificate is the largest relative gain
    of the value, to first order, by any change of the chains. On graphs of more than 30 vertices
    fewer programs are solved, and the tolerance is 0.02. On graphs of more than 100 none are
    solved; the residual is then the relative gain in the last steps: the last quarter of the steps
    of Adam or, without Adam, the steps at the highest inverse temperature. With memory, the limit
    of 100 applies to the number of vertices times the square of `memory`. The iterations are the
    gradient steps from all starts and the programs.

    On a line of three vertices, a robot needs two steps from one end to the other:

        >>> from jaxcell import patrol
        >>> patrol.maximin_capture(patrol.Graph([[0, 1], [1, 2]]), attack_time=1)
        Traceback (most recent call last):
            ...
        ValueError: attack_time: a robot needs 2 from vertex 0 to vertex 2, where an attack ...
    """
    require_x64("maximin_capture")
    for name, count in (("robots", robots), ("starts", starts), ("memory", memory)):
        check_count(name, count)
    delays, attack = whole_numbers(graph, attack_time, travel_times)
    if stationary is not None and memory > 1:
        raise ValueError("stationary: expected no memory, whose states would need shares, too")
    problem = _Problem.of(graph, delays, attack, robots, memory, stay, stationary)
    if robots > 1 and stationary is None and out_of_reach(delays, attack, stay=stay) is not None:
        options = {"starts": starts, "seed": seed, "tolerance": tolerance, "throw": throw}
        options |= {"stay": stay, "memory": memory}
        region = parts_within_reach(graph, delays, attack, robots, stay=stay)
        return _in_parts(graph, region, attack, travel_times, known, options)
    check_reach(delays, attack, stay=stay)
    copies = None if known is None else _copied(known, memory, graph.vertices, seed)
    alike = travel_times is None and stationary is None and not stay and np.ptp(attack) == 0
    search = problem.ascend if alike else problem.descend
    matrices, certificate = problem.polished(*search(starts, seed, copies), tolerance)
    certificate.check("maximin_capture", throw)
    matrices, value = problem.without_rare_moves(matrices)
    if copies is not None and (before := problem.value(copies)) > value:
        matrices, value = copies, before
    return MaximinCapture(matrices, value, certificate)


@dataclasses.dataclass(frozen=True, eq=False)
class _Problem:
    """The search for the chains of robots that must all be able to cross the graph in time."""

    states: Graph
    "The graph of all pairs of a memory state and a vertex."
    polytope: ChainPolytope
    delays: Int[np.ndarray, "states states"]
    attack: Int[np.ndarray, "targets"]
    robots: int
    memory: int

    @classmethod
    def of(
        cls,
        graph: Graph,
        delays: Int[np.ndarray, "vertices vertices"],
        attack: Int[np.ndarray, "vertices"],
        robots: int,
        memory: int,
        stay: bool,
        stationary: Any,
    ) -> "_Problem":
        states = _with_memory(graph, memory, stay)
        delays = np.tile(delays, (memory, memory))
        polytope = ChainPolytope.on(states, stationary, stay=stay, possible=delays > 0)
        return cls(states, polytope, delays, attack, robots, memory)

    @functools.cached_property
    def arguments(self) -> tuple[Any, ...]:
        """All arguments of `first_passage` except the transition matrix."""
        return on_device(self.delays, self.attack)

    def value(self, matrices: _Matrices) -> float:
        """Compute the least probability of capture by a team."""
        each = np.stack([first_passage(matrix, *self.arguments) for matrix in matrices])
        return float(captured_by_any(each).min())

    @one_blas_thread()
    def ascend(
        self, starts: int, seed: int, copies: _Matrices | None
    ) -> tuple[_Matrices, int, float]:
        """Follow the gradient with respect to the logits of steps from each start.

        One more start are the known walks `copies`.

        **Returns:** the best matrices, the number of steps, and the result of `late_gain`.
        """
        frames = _frames(self.delays, self.memory)
        # On small graphs a step is quick, and more starts improve the result more than more steps.
        quick = _QUICK * len(frames) / self.states.vertices**2
        least = 1 if len(frames) == 1 else _SYMMETRIC
        count = max(min(least, starts), int(starts * min(_MORE, quick) / self.robots))
        # If there is time for a single start, a random one leads further than the tour.
        drawn = self.polytope.starts(max(count, min(starts, 2)), self.robots, seed)[-count:]
        walks = [*self.polytope.matrix(drawn), *([] if copies is None else [copies])]
        steps: Steps | SymmetricSteps = Steps.of(self.states)
        if len(frames) > 1:
            steps = SymmetricSteps.of(self.states, frames)
        begins = [steps.logits(walk) for walk in walks]
        cells = begins[0].shape[-1]
        away = (1 - states_at(cells, self.attack.size)).astype(np.float32)
        annealed = _ANNEALED if self.memory == 1 else (_WITH_MEMORY, _ANNEALED[1])
        ascent = Ascent(steps, away, int(self.attack[0]), _FLOOR, annealed)
        count = STEPS // (1 + (cells > _LARGE))
        climbs = [ascent.climb(begin, count) for begin in begins]
        values = np.array([value for _, value, _ in climbs])
        # Values that differ by rounding count as equal; the first of these starts is taken.
        first = int(np.argmax(values >= values.max() - _EQUAL * abs(values.max())))
        best, _, course = climbs[first]
        chances = np.asarray(steps.chances(np.asarray(best, np.float64), _FLOOR))
        return steps.matrices(chances), count * len(begins), late_gain(course)

    def descend(
        self, starts: int, seed: int, copies: _Matrices | None
    ) -> tuple[_Matrices, int, float]:
        """Follow the gradient of a soft minimum of capture from each start, then harden it.

        Harder minima have a higher inverse temperature. The descents for them begin at the best
        result, and at the known walks `copies`.

        **Returns:** the best matrices, the number of steps, and the relative gain in the descent
        for the hardest minimum.
        """
        polytope = self.polytope
        begin = polytope.starts(starts, self.robots, seed)
        every, values, steps = descend(_missed, polytope, begin, (*self.arguments, _HARDNESS))
        best = [every[np.nanargmin(values)]]
        if copies is not None:
            weights = copies[:, polytope.tails, polytope.heads] + _MOVED
            best.append(np.stack([polytope.inside(robot) for robot in weights]))
        before = moves = np.stack(best)
        for hardness in _HARDER:
            before, harder = moves, (*self.arguments, hardness)
            moves, _, more = descend(_missed, polytope, moves, harder, _HARDER_STEPS)
            steps += more
        found = polytope.matrix(moves)
        values = np.array([self.value(each) for each in found])
        first = int(values.argmax())
        earlier = self.value(polytope.matrix(before[first]))
        return found[first], steps, max(0.0, float(1 - earlier / values[first]))

    def polished(
        self, matrices: _Matrices, steps: int, late: float, tolerance: float
    ) -> tuple[_Matrices, Certificate]:
        """Improve the result of a search with linear programs, unless there are too many states."""
        if self.states.vertices * self.memory > POLISHED:
            return matrices, Certificate(steps, late, _LITTLE)
        if self.states.vertices > EXACT:
            tolerance = max(tolerance, _LITTLE)
        moves, _, residual, programs = maximize_least_capture(
            lambda moves: Captures(self.polytope, moves, self.attack, self.delays),
            self.polytope,
            matrices[:, self.polytope.tails, self.polytope.heads],
            tolerance,
        )
        return self.polytope.matrix(moves), Certificate(steps + programs, residual, tolerance)

    def without_rare_moves(self, matrices: _Matrices) -> tuple[_Matrices, float]:
        """Remove negligible moves from the chains of a team, unless this reduces capture.

        In the search no step has probability 0, so a robot visits even vertices that it leaves to
        others, once in 10^6 moves. The times of such rare visits are not accurate in 64 bits.
        """
        value = self.value(matrices)
        if len(matrices) == 1 or self.polytope.stationary is not None:
            return matrices, value
        kept = np.where(matrices < _RARE, 0.0, matrices)
        kept /= kept.sum(axis=2, keepdims=True)
        without = self.value(kept)
        if without >= (1 - 10 * _RARE) * value:
            return kept, without
        return matrices, value


def _in_parts(
    graph: Graph,
    region: Int[np.ndarray, "vertices"],
    attack: Int[np.ndarray, "vertices"],
    travel_times: Any,
    known: Float[np.ndarray, "robots _ _"] | None,
    options: dict[str, Any],
) -> MaximinCapture:
    """Find chains of robots that each patrol a part of a graph."""
    walks, found = [], []
    for robot in range(int(region.max()) + 1):
        inside = np.flatnonzero(region == robot)
        part = part_of_graph(graph, inside)
        edges = np.isin(graph.edges, inside).all(axis=1)
        times = None if travel_times is None else np.asarray(travel_times)[edges]
        before = None
        if known is not None:
            states = len(known[robot]) // graph.vertices
            own = (graph.vertices * np.arange(states)[:, None] + inside).ravel()
            before = known[robot][np.ix_(own, own)][None]
            # A known walk that leaves the part is no start.
            before = before if np.allclose(before.sum(axis=2), 1) else None
        best = maximin_capture(part, attack[inside], travel_times=times, known=before, **options)
        walks.append(walk_in_part(graph, inside, best.matrices[0]))
        found.append(best)
    weakest = min(found, key=lambda part: part.value)
    steps = sum(part.certificate.iterations for part in found)
    certificate = dataclasses.replace(weakest.certificate, iterations=steps)
    return MaximinCapture(np.stack(walks), weakest.value, certificate)


def _copied(
    known: Float[np.ndarray, "robots _ _"], memory: int, vertices: int, seed: int
) -> _Matrices:
    """Add copies of states of memory to known walks until there are `memory` states.

    Moves to a state are divided among its copies at random. So capture does not change, but a
    search can make copies differ.
    """
    robots, states = known.shape[:2]
    if known.shape[1:] != (states, states) or states % vertices or states > memory * vertices:
        raise ValueError(
            f"known: expected matrices of at most {memory} times {vertices} states, got an array "
            f"with shape {list(known.shape)}"
        )
    copied = np.arange(memory) * (states // vertices) // memory
    shares = np.random.default_rng(seed).uniform(*_COPIED, (robots, memory, vertices, memory, 1))
    shares /= np.einsum("rivjx,jk->rivkx", shares, copied[:, None] == copied)
    by_state = known.reshape(robots, -1, vertices, states // vertices, vertices)
    wide = by_state[:, copied][:, :, :, copied] * shares
    return wide.reshape(robots, memory * vertices, memory * vertices)


def _with_memory(graph: Graph, memory: int, stay: bool) -> Graph:
    """Build the graph of all pairs of a memory state and a vertex; the vertex varies fastest.

    A move or a wait may change the state of the memory to any state.
    """
    pairs = np.array(list(itertools.product(range(memory), repeat=2)))
    edges = graph.edges + graph.vertices * pairs[:, None]
    if stay:
        here = np.arange(graph.vertices)[:, None]
        waits = here + graph.vertices * pairs[pairs[:, 0] < pairs[:, 1], None]
        edges = np.concatenate([edges.reshape(-1, 2), waits.reshape(-1, 2)])
    return Graph(edges.reshape(-1, 2), memory * graph.vertices)


def _frames(
    delays: Int[np.ndarray, "states states"], memory: int
) -> Int[np.ndarray, "frames vertices"]:
    """Return the symmetries of a graph if their number divides `memory`, else only the identity."""
    vertices = len(delays) // memory
    identity = np.arange(vertices)[None]
    if memory == 1 or vertices > ALL_TARGETS:
        return identity
    frames = symmetries(delays[:vertices, :vertices], [0] * vertices)
    return frames if len(frames) <= MOST_SYMMETRIES and memory % len(frames) == 0 else identity


def _missed(
    matrices: Float[Array, "robots states states"],
    seen: Float[Array, "states targets"],
    delays: Int[Array, "states states"],
    attack: Int[Array, "targets"],
    longest: Float[Array, "delays"],
    horizon: Float[Array, "times"],
    hardness: Float[Array, ""],
) -> Float[Array, ""]:
    """Compute the negative soft minimum of log-probabilities of capture over starts and targets."""
    captured = jax.vmap(lambda P: first_passage(P, seen, delays, attack, longest, horizon))(
        matrices
    )
    # The smallest positive number keeps the gradient finite where probabilities underflow.
    logs = jnp.log(captured + jnp.finfo(captured.dtype).tiny)
    worst = -jax.nn.logsumexp(-hardness * logs, axis=1) / hardness
    if matrices.shape[0] > 1:
        misses = jnp.sum(jnp.log1p(-jnp.exp(worst)), axis=0)
        worst = jnp.log(-jnp.expm1(misses))[None]
    return jax.nn.logsumexp(-hardness * worst) / hardness
