from typing import Any

import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Float, Int

from ....optimize import GraphLike
from ..arrival import whole_numbers
from .pursuit import Pursuit


# Number of places of the robot at the start of an attack that are tried, remote places first.
_BEGINS = 6
# Largest number of variables of the linear program for the probabilities of attacks.
_MOST = 500_000
CUTS = 1500
"""Largest number of Benders cuts in each test whether a probability of capture can be kept."""
# Largest number of moves times the longest attack for which cuts are made, and the largest product
# of this number and the number of cuts, without symmetries.
_PROMISES, _WORK = 1500, 240_000
# Largest number of promises at a vertex for which all vertices are targets of the cuts.
_ALL = 9


def capture_bound(
    graph: GraphLike,
    attack_time: Any,
    *,
    travel_times: Any = None,
    robots: int = 1,
    stay: bool = False,
    captured: float = 0.0,
    tests: int = 0,
) -> float:
    """Compute an upper bound on the least probability of capture by robots with any memory.

    An adversary waits until the robot is at some vertex, and then attacks a random vertex. The best
    answer of the robot is the walk that visits, within the attack time, vertices with the largest
    total probability of attack. A linear program finds the probabilities of attack for which this
    total is least; on large graphs they are equal. Dynamic programming then computes the total, so
    that the tolerance of the program does not matter. The bound is the least total over several
    vertices at which the robot may be. For several independent robots, it is the sum of the totals.

    With `tests`, nested Benders cuts lower this bound for a single robot. In this method the
    adversary sees the robot all the time, and attacks any vertex or, beyond a few vertices, one of
    the two that are farthest apart. A test takes seconds; large graphs are not tested.

    **Arguments:**

    - `graph`, `attack_time`, `travel_times`, `robots`, `stay`: as in
        [`maximin_capture`][jaxcell.patrol.maximin_capture].
    - `captured`: the least capture of a known walk; the bound cannot be lower.
    - `tests`: number of tests; each halves the range above `captured` in which the bound may be.

    **Returns:** the bound, at most 1.

    In three steps from a leaf of a star, a robot visits only one of the three leaves:

        >>> from jaxcell import patrol
        >>> star = patrol.Graph([[0, 1], [0, 2], [0, 3]])
        >>> round(patrol.walks.capture_bound(star, 3), 6)
        0.333333
    """
    delays, attack = whole_numbers(graph, attack_time, travel_times)
    if not stay:
        delays = delays * (1 - np.eye(graph.vertices, dtype=np.int32))
    visits = _Visits(delays, attack)
    apart = scipy.sparse.csgraph.shortest_path(delays.astype(float))
    begins = np.argsort(-apart.sum(axis=1), kind="stable")[:_BEGINS].tolist()
    draws = [visits.draw(begin) for begin in begins]
    if robots > 1:
        # A robot need not visit the vertex at which another robot is when the attack begins.
        draws.append(np.full(graph.vertices, 1 / graph.vertices))
        each = [max(visits.most(draw, v) for v in range(graph.vertices)) for draw in draws]
        return min(1.0, robots * min(each))
    bound = min(1.0, *map(visits.most, draws, begins))
    size = visits.tail.size * visits.end
    if tests == 0 or size > _PROMISES or bound <= captured:
        return bound
    pursuit = Pursuit(delays, attack, list(range(graph.vertices)))
    if pursuit.sizes.max() > _ALL:
        ends = [int(end) for end in np.unravel_index(apart.argmax(), apart.shape)]
        pursuit = Pursuit(delays, attack, ends)
    # Vertices that symmetries exchange share their cuts.
    models = len(set(pursuit.models.values()))
    cuts = min(CUTS, _WORK * graph.vertices // (size * models))
    return pursuit.bound(captured, bound, tests, cuts)


class _Visits:
    """The visits of a walk within the attack times, where a state is a pair of successive moves."""

    def __init__(
        self, delays: Int[np.ndarray, "vertices vertices"], attack: Int[np.ndarray, "vertices"]
    ) -> None:
        self.tail, self.head = np.nonzero(delays)
        self.lasts = delays[self.tail, self.head]
        self.attack, self.end = attack, int(attack.max())
        first, second = np.nonzero(self.head[:, None] == self.tail)
        self.first, self.second = first, second
        # A second move that waits, or returns, ends at a vertex that the pair has already visited.
        self.waits = self.head[second] == self.head[first]
        self.returns = self.head[second] == self.tail[first]

    def new_visits(self, time: int) -> Float[np.ndarray, "pairs"]:
        """Return 1 for each pair whose second move reaches a new vertex in time, and otherwise 0.

        The first move ends `time` after the attack began; visits before the attack do not count.
        """
        # The first move of a walk begins before the attack, so a return to its start counts.
        again = self.waits | (self.returns & (time > self.lasts[self.first]))
        in_time = time + self.lasts[self.second] <= self.attack[self.head[self.second]]
        return (in_time & ~again).astype(float)

    def draw(self, begin: int) -> Float[np.ndarray, "vertices"]:
        """Find the attack probabilities for which the best walk from `begin` captures least."""
        moves, targets = self.tail.size, self.attack.size
        if self.first.size * self.end > _MOST:
            return np.full(targets, 1 / targets)
        opening = np.flatnonzero(self.tail == begin)
        in_time = self.lasts[opening] <= self.attack[self.head[opening]]
        blocks = [(opening, self.lasts[opening], np.full(opening.size, -1), in_time.astype(float))]
        for time in range(1, self.end):
            pair = np.flatnonzero(time + self.lasts[self.second] <= self.end)
            after = self.second[pair]
            used = self.first[pair] * self.end + time
            blocks.append((after, time + self.lasts[after], used, self.new_visits(time)[pair]))
        move, ends, used, visits = map(np.concatenate, zip(*blocks, strict=True))
        column = np.arange(move.size)
        # A move that begins at some time needs a move that ends there at that time.
        rows = np.append(move * self.end + ends % self.end, used)
        live = np.append(ends < self.end, used >= 0)
        entries = np.append(-np.ones(move.size), np.ones(move.size))[live]
        places = rows[live], np.tile(column, 2)[live]
        flow = scipy.sparse.csr_array((entries, places), (moves * self.end, move.size))
        seen = scipy.sparse.csr_array((visits, (self.head[move], column)), (targets, move.size))
        least = np.append(np.zeros(moves * self.end), np.ones(targets))[:, None]
        program = scipy.optimize.linprog(
            np.append(np.zeros(move.size), -1.0),
            A_ub=scipy.sparse.hstack([scipy.sparse.vstack([flow, -seen]), least], format="csr"),
            b_ub=np.zeros(least.size),
            A_eq=np.append(used < 0, False)[None].astype(float),
            b_eq=[1.0],
        )
        if program.status != 0:
            return np.full(targets, 1 / targets)
        shares = np.maximum(0.0, -program.ineqlin.marginals[moves * self.end :])
        return shares / shares.sum()

    def most(self, draw: Float[np.ndarray, "vertices"], begin: int) -> float:
        """Compute the largest sum of `draw` at vertices that a walk from `begin` visits in time."""
        worth = np.zeros((self.end + 1, self.tail.size))
        for time in range(self.end - 1, 0, -1):
            later = np.minimum(time + self.lasts[self.second], self.end)
            gains = self.new_visits(time) * draw[self.head[self.second]] + worth[later, self.second]
            np.maximum.at(worth[time], self.first, gains)
        opening = np.flatnonzero((self.tail == begin) & (self.lasts <= self.end))
        at_once = self.lasts[opening] <= self.attack[self.head[opening]]
        gains = at_once * draw[self.head[opening]] + worth[self.lasts[opening], opening]
        return float(gains.max(initial=0.0))
