import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Array, Float, Int

from ....base.certificate import Certificate
from ....base.precision import require_x64
from ....base.threads import one_blas_thread
from ....mapping import Chain
from ....optimize import Graph
from ..arrival import captured_by_any, first_passage, on_device, whole_numbers
from ..steps import Steps
from .ascent import Ascent, late_gain
from .descent import descend
from .linearized import LinearizedCapture
from .polytope import ChainPolytope
from .sequential_lp import maximize_least_capture


# Of the soft minimum of the logarithms. Softer, all starts lead to the most symmetric chain; what
# it lacks of the minimum is left to linear programs.
_HARDNESS = 50.0
# On few vertices so many times as many starts are tried as are asked for.
_MORE, _QUICK = 4, 3600
# Vertices for as many linear programs as it takes, and for any; gradients are then all there is.
_EXACT, _POLISHED = 30, 100
# Of the value: what counts as little to gain on larger graphs.
_LITTLE = 0.02
# Gradient steps from each start, half as many on a graph of more vertices; the hardness of the
# minimum at first and at their end; and the least probability of a step.
_STEPS, _LARGE, _ANNEALED, _FLOOR = 1200, 200, (1.0, 300.0), 1e-6
# Of a value in 32 bits; and of the moves from a vertex, what is hardly ever made.
_EQUAL, _RARE = 1e-5, 1e-5


@dataclasses.dataclass(frozen=True, eq=False)
class MaximinCapture:
    """Chains for some robots, and the least probability that they capture an adversary."""

    matrices: Float[np.ndarray, "robots vertices vertices"]
    "The transition matrix of each robot."
    value: float
    "The least probability over the target and the positions of the robots as the attack begins."
    start: int
    "The start that led to it; 0 is the default one, which is not random."
    certificate: Certificate

    @property
    def chains(self) -> list[Chain]:
        """The chain of each robot, whose cells are the vertices."""
        return [Chain.from_scipy(scipy.sparse.csr_array(matrix)) for matrix in self.matrices]


def maximin_capture(
    graph: Graph,
    attack_time: Any,
    *,
    travel_times: Any = None,
    robots: int = 1,
    stationary: Any = None,
    stay: bool = False,
    starts: int = 8,
    seed: int = 0,
    tolerance: float = 1e-4,
    throw: bool = True,
) -> MaximinCapture:
    """Chains that make the least probability of capture great, whatever the adversary knows.

    The adversary strikes at a vertex when a robot leaves another or the same one, and is captured
    if a robot comes to it within the attack time. It knows the chains and sees the robots, so it
    strikes where, and when, the probability of [`walk_capture_probabilities`][] is least. Several
    robots move independently, each with a chain of its own, and all are where they are worst at the
    same time: with `F_r` the probabilities of robot `r`, the value is `min_j (1 - prod_r (1 - min_i
    F_r[i, j]))`.

    The problem is not convex: the answer is a local optimum, the best that several starts lead to.
    Gradients of a soft minimum of logarithms lead near it, Adam's on logits where all edges and
    attacks take as long; on logarithms, because a probability that is a product of many would leave
    a gradient of almost 0. Linear programs of the attacks that are nearly the best then finish it.

    **Arguments:**

    - `graph`: a connected graph.
    - `attack_time`: how long an attack takes, a whole number, or array `[vertices]` of one for each
        target.
    - `travel_times`: array `[edges]`, how long each edge takes, whole numbers; by default 1.
    - `robots`: how many.
    - `stationary`: array `[vertices]`, the share of the moves of each robot to begin at each
        vertex, positive.
    - `stay`: whether a robot may wait at a vertex, which takes a time of 1.
    - `starts`: how many chains to start from. The first goes along a short closed tour. Where all
        edges and attacks take as long, one robot has up to four times as many on a small graph, and
        fewer on one of more than 60 vertices; several robots have fewer by their number.
    - `seed`: of the other starts, which are random.
    - `tolerance`: of the residual.
    - `throw`: whether to raise when the answer is not good enough.

    **Returns:** [`MaximinCapture`][]. The residual of its certificate is by what share of itself
    the value gets greater, to first order, at most, whatever the chains are changed to. On graphs
    of more than 30 vertices fewer programs are solved, and the tolerance is 0.02; on those of more
    than 100 there are none, and the residual is the share of the value that the last quarter of the
    gradient steps added. The iterations are the gradient steps from all starts and the programs.

    **Raises:** `ValueError` for a graph that is not connected; for times that are not whole
    numbers of at least 1, and an attack that is over before a robot can come, naming the vertices;
    for a stationary distribution that no chain on the graph has, naming the vertices at which too
    much time would be spent; for fewer than 1 robot or start; `RuntimeError` if the residual stays
    above the tolerance, or where JAX is set to 32 bits.

    From one end of a line of three a robot needs two steps to the other:

        >>> from jaxcell import patrol
        >>> patrol.maximin_capture(patrol.Graph([[0, 1], [1, 2]]), attack_time=1)
        Traceback (most recent call last):
            ...
        ValueError: attack_time: a robot at vertex 0 needs 2 to come to vertex 2, where an ...
    """
    require_x64("maximin_capture")
    for name, count in (("robots", robots), ("starts", starts)):
        if count < 1:
            raise ValueError(f"{name}: expected at least 1, got {count}")
    delays, attack = whole_numbers(graph, attack_time, travel_times)
    _check_reach(delays, attack)
    among = ChainPolytope.on(graph, stationary, stay=stay)
    arguments = on_device(delays, attack)
    plain = stationary is None and travel_times is None and not stay and np.ptp(attack) == 0
    if plain:
        # A step is quick on small graphs, and more starts find more than more steps.
        count = max(1, int(starts * min(_MORE, _QUICK / graph.vertices**2) / robots))
        # Where there is time for one alone, a random one leads further than the tour.
        begin = among.starts(max(count, min(starts, 2)), robots, seed)
        skipped = len(begin) - count
        begin = begin[skipped:]
        found, best, steps, late = _ascend(
            graph,
            int(attack[0]),
            np.array([[among.matrix(robot) for robot in start] for start in begin]),
        )
        best += skipped
        moves = found[:, among.tails, among.heads]
        if graph.vertices > _POLISHED:
            found, value = _without_rare_moves(found, arguments)
            certificate = Certificate(steps, late, _LITTLE)
            certificate.check("maximin_capture", throw)
            return MaximinCapture(found, value, best, certificate)
    else:
        begin = among.starts(starts, robots, seed)
        every, values, steps = descend(_missed, among, begin, arguments)
        best = int(np.nanargmin(values))
        moves = every[best]

    def law(moves: Float[np.ndarray, "robots moves"]) -> LinearizedCapture:
        return LinearizedCapture(among, moves, attack, delays)

    if graph.vertices > _EXACT:
        tolerance = max(tolerance, _LITTLE)
    moves, value, residual, programs = maximize_least_capture(law, among, moves, tolerance)
    certificate = Certificate(steps + programs, residual, tolerance)
    certificate.check("maximin_capture", throw)
    matrices = np.stack([among.matrix(robot) for robot in moves])
    if stationary is None:
        matrices, value = _without_rare_moves(matrices, arguments)
    return MaximinCapture(matrices, value, best, certificate)


@one_blas_thread()
def _ascend(
    graph: Graph, attack_time: int, starts: Float[np.ndarray, "starts robots vertices vertices"]
) -> tuple[Float[np.ndarray, "robots vertices vertices"], int, int, float]:
    """Follow the gradient in the logits of steps from matrices, where all edges take one step.

    **Returns:** the matrices of the robots, the start that led there, the number of steps, and the
    share of the value that the last quarter of them added.
    """
    steps = Steps.of(graph)
    away = 1 - np.eye(graph.vertices, dtype=np.float32)
    ascent = Ascent(steps, away, np.ones_like(away), attack_time, "worst", _FLOOR, _ANNEALED)
    count = _STEPS // (1 + (graph.vertices > _LARGE))
    progress = np.arange(count) / count
    found = [ascent.climb(steps.logits(start), progress) for start in starts]
    values = np.array([value for _, value, _, _ in found])
    # Values that differ by rounding count as equal, and the first of them is taken.
    first = int(np.argmax(values >= values.max() - _EQUAL * abs(values.max())))
    best, _, _, course = found[first]
    drawn = np.asarray(steps.chances(np.asarray(best, np.float64), _FLOOR))
    return steps.matrices(drawn), first, count * len(starts), late_gain(course)


def _missed(
    matrices: Float[Array, "robots vertices vertices"],
    delays: Int[Array, "vertices vertices"],
    attack: Int[Array, "vertices"],
    longest: Float[Array, "delays"],
    horizon: Float[Array, "times"],
) -> Float[Array, ""]:
    """Minus a soft minimum of the logarithm of the probability of capture."""
    captured = jax.vmap(lambda P: first_passage(P, delays, attack, longest, horizon))(matrices)
    # What is lost in underflow has no gradient, and must not have one that is not a number.
    logs = jnp.log(captured + jnp.finfo(captured.dtype).tiny)
    worst = -jax.nn.logsumexp(-_HARDNESS * logs, axis=1) / _HARDNESS
    if matrices.shape[0] > 1:
        misses = jnp.sum(jnp.log1p(-jnp.exp(worst)), axis=0)
        worst = jnp.log(-jnp.expm1(misses))[None]
    return jax.nn.logsumexp(-_HARDNESS * worst) / _HARDNESS


def _value(
    matrices: Float[np.ndarray, "robots vertices vertices"], arguments: tuple[Any, ...]
) -> float:
    each = np.stack([first_passage(one, *arguments) for one in matrices])
    return float(captured_by_any(each).min())


def _without_rare_moves(
    matrices: Float[np.ndarray, "robots vertices vertices"], arguments: tuple[Any, ...]
) -> tuple[Float[np.ndarray, "robots vertices vertices"], float]:
    """Chains of a team without moves that are hardly ever made, and what they capture at least.

    A robot that leaves a part of the graph to others comes there, once in 10^6 moves, by what is
    left of a floor; times until then are lost in rounding.
    """
    value = _value(matrices, arguments)
    if len(matrices) == 1:
        return matrices, value
    kept = np.where(matrices < _RARE, 0.0, matrices)
    kept /= kept.sum(axis=2, keepdims=True)
    without = _value(kept, arguments)
    if without >= (1 - 10 * _RARE) * value:
        return kept, without
    return matrices, value


def _check_reach(
    delays: Int[np.ndarray, "vertices vertices"], attack: Int[np.ndarray, "vertices"]
) -> None:
    apart = scipy.sparse.csgraph.shortest_path(delays.astype(np.float64))
    # A graph that is not connected is refused where the chains are made.
    if not np.isfinite(apart).all():
        return
    late = apart - attack
    start, target = np.unravel_index(np.argmax(late), late.shape)
    if late[start, target] > 0:
        raise ValueError(
            f"attack_time: a robot at vertex {start} needs {apart[start, target]:.0f} to come to "
            f"vertex {target}, where an attack takes {attack[target]}, so that nothing captures it"
        )
