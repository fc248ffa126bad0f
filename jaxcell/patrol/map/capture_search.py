import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.certificate import Certificate
from ...base.precision import require_x64
from ...base.process import one_blas_thread
from ...base.quantities import Result, derived, from_part, quantity
from ...mapping import Chain
from ...markov import dense
from ...optimize import Graph, GraphLike, greedy_cover, shortest_tour
from ...optimize.validation import check_count
from ..walks.optimal.ascent import late_gain
from ..walks.steps import Steps
from .attack import Attack
from .capture import capture_by_tours, capture_probabilities
from .circulation import Circulation, CirculationAscent, Logits
from .policies import Policy
from .regions import check_team


STEPS = 300
"""Number of gradient steps for each start."""
# An even walk is no start if its capture is less than this share of the capture by tours.
_HOPELESS = 0.1
# Tolerance of the relative gain in the last quarter of the steps.
_TOLERANCE = 0.02
# Random spread of the logits at the first two starts, and at the other starts; without it, robots
# would stay equal.
_SPREAD = 0.1, 0.5

Say = Callable[[str, int, int], None]


@dataclasses.dataclass(frozen=True, eq=False)
class CaptureSearch(Result):
    """Walks of robots whose least probability of capture is a local maximum."""

    title: ClassVar[str] = "Search for the patrol that captures most"
    tables: ClassVar[Mapping[str, str]] = {"attempt": "attempts"}

    policies: tuple[Policy, ...]
    attack_time: Annotated[int, quantity("", "steps of the attack", "steps", kind="count")]
    randomness: Annotated[float, quantity("", "least share of random steps", "1", kind="share")]
    "The least share of steps in which a robot goes to a uniformly random neighbour."
    start: Annotated[str, quantity("", "robots at the start of the attack")]
    tried: Annotated[
        Float[np.ndarray, "attempts"],
        quantity("attempt", "least probability of capture", "1", kind="share"),
    ]
    value: Annotated[
        float, quantity("", "least probability of capture, a local optimum", "1", kind="share")
    ]
    tours: Annotated[
        float | None,
        quantity("", "least by closed tours with independent phases", "1", kind="share"),
    ]
    "The result of [`jaxcell.patrol.map.capture_by_tours`][]; `None` if a cover is a single cell."
    certificate: Certificate

    @derived("attempt", "start", kind="coordinate")
    def attempt(self) -> Int[np.ndarray, "attempts"]:
        return np.arange(self.tried.size)

    @derived("", "share of it that the last quarter of the steps added", "1", kind="residual")
    def late_gain(self) -> float:
        return self.certificate.residual

    iterations = from_part("certificate.iterations", "", "gradient steps", kind="count")


@dataclasses.dataclass(frozen=True, eq=False)
class Frontier(Result):
    """The trade-off between the least probability of capture and the unpredictability of steps."""

    title: ClassVar[str] = "Capture against entropy"
    tables: ClassVar[Mapping[str, str]] = {"floor": "floors"}

    floor: Annotated[
        Float[np.ndarray, "floors"],
        quantity("floor", "least share of random steps", "1", kind="coordinate"),
    ]
    least_capture: Annotated[
        Float[np.ndarray, "floors"],
        quantity("floor", "least probability of capture, a local optimum", "1", kind="share"),
    ]
    entropy: Annotated[
        Float[np.ndarray, "floors"],
        quantity("floor", "entropy of a step, mean over robots", "nats"),
    ]


def capture_policies(
    graph: GraphLike,
    visible: Bool[np.ndarray, "cells cells"],
    robots: int,
    attack: Attack,
    *,
    randomness: float = 0.0,
    starts: int = 2,
    seed: int = 0,
    say: Say | None = None,
) -> CaptureSearch:
    """Find walks of robots that maximise the least probability of capture over the cells.

    Adam changes the logits of the steps of all robots along the gradient of a soft minimum of
    [`jaxcell.patrol.capture_probabilities`][]. The searches start from tours through covers, and
    from *even* walks, which take all edges with equal probability; both are perturbed randomly.

    Each trained walk is then mixed with *excursions*, a walk that visits all cells and drifts back
    to those where the robot spends most of its time. The share of time of excursions is 1e-5 per
    cell, at most 0.1 in total, so that every cell is visited, and commute times are bounded. The
    result is a local optimum, the best of all starts.

    **Arguments:**

    - `graph`, `visible`: as in [`jaxcell.patrol.capture_probabilities`][]; the graph is connected.
    - `robots`: number of robots.
    - `attack`: the attack; only its first time counts.
    - `randomness`: the least share of steps in which a robot chooses its neighbour uniformly, from
        0 to less than 1. With 0, a patrol is nearly a tour, and predictable.
    - `starts`: number of starts: tours first, then even walks. On a large map even walks may
        capture too little to be used as starts.
    - `seed`: seed of the starts.
    - `say`: a function that is called with a description of the work, the number of completed
        steps, and their total.

    **Returns:** [`CaptureSearch`][]. The residual of its certificate is the relative gain of the
    probability in the last quarter of the steps; if it is large, more steps would gain more.

    One robot in a corridor of five cells, each of which sees its neighbours:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> attack = patrol.Attack(4)
        >>> best = patrol.capture_policies(graph, visible, 1, attack)
        >>> commuting = patrol.distributed_policies(graph, visible, 1, 0.0)
        >>> before = patrol.capture_probabilities(graph, visible, commuting, attack).min()
        >>> round(float(before), 3), round(best.value, 2)
        (0.51, 0.75)
    """
    problem = _Problem.of(graph, visible, robots, attack)
    _check_randomness(randomness)
    check_count("starts", starts)
    return problem.search(problem.begins(starts, seed), randomness, say)[0]


def capture_frontier(
    graph: GraphLike,
    visible: Bool[np.ndarray, "cells cells"],
    robots: int,
    attack: Attack,
    floors: Sequence[float],
    *,
    seed: int = 0,
    say: Say | None = None,
) -> Frontier:
    """Compute the trade-off between capture and the unpredictability of steps.

    **Arguments:** those of [`capture_policies`][], with the values of `randomness` to compare, in
    any order, as `floors`. **Returns:** [`Frontier`][], with floors in increasing order. Each
    search has two starts, a new start and the result for the next higher floor, so that capture
    never increases with the floor.

    A robot in a corridor of five cells captures less if its steps must be unpredictable:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> curve = patrol.map.capture_frontier(graph, visible, 1, patrol.Attack(4), [0.6, 0.0])
        >>> curve.floor.tolist(), bool(curve.least_capture[0] > curve.least_capture[1])
        ([0.0, 0.6], True)
    """
    if not len(floors):
        raise ValueError("floors: expected at least one, got none")
    for floor in floors:
        _check_randomness(floor)
    problem = _Problem.of(graph, visible, robots, attack)
    points: list[tuple[float, float, float]] = []
    warm, above = None, 0.0
    for floor in sorted({float(floor) for floor in floors}, reverse=True):
        begins = problem.begins(1, seed)
        if warm is not None:
            begins = [problem.under(warm, above, floor), *begins]
        best, warm = problem.search(begins, floor, say)
        above = floor
        entropy = float(np.mean([entropy_rate(graph, policy) for policy in best.policies]))
        point = floor, best.value, entropy
        # A patrol for a higher floor also meets this floor.
        points.append(max(point, (floor, *points[-1][1:]), key=lambda p: p[1]) if points else point)
    return Frontier(*np.array(points[::-1]).T)


def entropy_rate(graph: Graph, policy: Policy) -> float:
    """Compute the long-run entropy of a robot's step, in nats; 0 for a robot in one cell."""
    share = policy.share_of_time(graph)
    chance = np.asarray(policy.chain.probability)
    surprise = -np.log(np.where(chance > 0, chance, 1.0))
    return float(share @ (chance * surprise).sum(axis=0))


def _check_randomness(randomness: float) -> None:
    if not 0 <= randomness < 1:
        raise ValueError(f"randomness: expected 0 or more and less than 1, got {randomness}")


@dataclasses.dataclass(frozen=True, eq=False)
class _Problem:
    """A search problem: the steps on a graph, and the targets that some but not all cells see."""

    graph: Graph
    visible: Bool[np.ndarray, "cells cells"]
    robots: int
    attack: Attack
    "An attack with a single time."
    steps: Steps
    unseen: Float[np.ndarray, "cells targets"]

    @classmethod
    def of(
        cls, graph: Graph, visible: Bool[np.ndarray, "cells cells"], robots: int, attack: Attack
    ) -> "_Problem":
        require_x64("capture_policies")
        check_team(graph, visible, robots)
        open_ = visible.any(axis=0) & ~visible.all(axis=0)
        unseen = (~visible[:, open_]).astype(np.float32)
        return cls(graph, visible, robots, attack.first, Steps.of(graph), unseen)

    def begins(self, count: int, seed: int) -> list[Logits]:
        """Return the logits of at most `count` starts of a search, perturbed at random.

        Tours come first, then even walks, unless even walks capture so little that no gradient
        leads away from them.
        """
        random = np.random.default_rng(seed)
        shape = (self.robots, *self.steps.image.shape)
        touring, least = self.tours
        even = np.zeros(shape)
        if touring is None or least is None:
            begins = [even] * count
        else:
            begins = [touring, *[even] * (count - 1)]
            if count > 1 and self._team(self.ascent(0.0).climb(even, 0)[1])[1] <= _HOPELESS * least:
                begins = [touring]
        spreads = [*[_SPREAD[0]] * 2, *[_SPREAD[1]] * count]
        return [
            begin + spread * random.normal(size=shape)
            for begin, spread in zip(begins, spreads, strict=False)
        ]

    @functools.cached_property
    def tours(self) -> tuple[Logits | None, float | None]:
        """The logits of walks along tours through the covers, and the least capture by the tours.

        A walk has no memory: in a cell that a tour passes more than once, the walk chooses among
        all steps that the tour takes from there.
        """
        covers = [greedy_cover(self.visible, robot).chosen for robot in range(self.robots)]
        least = capture_by_tours(self.graph, self.visible, covers, self.attack)
        if least is None:
            return None, None
        cells = self.graph.vertices
        walks = np.zeros((self.robots, cells, cells))
        even = self.steps.matrices(np.asarray(self.steps.even, float))
        for walk, cover in zip(walks, covers, strict=True):
            tour = shortest_tour(self.graph, cover.tolist())
            np.add.at(walk, (tour, np.roll(tour, -1)), 1.0)
            visits = walk.sum(axis=1, keepdims=True)
            walk[:] = np.where(visits > 0, walk / np.maximum(visits, 1), even)
        return self.steps.logits(walks), least

    def ascent(self, randomness: float) -> CirculationAscent:
        time, start = int(self.attack.times[0]), self.attack.start
        return CirculationAscent(self.graph, self.steps, self.unseen, time, start, randomness)

    def under(self, logits: Logits, above: float, floor: float) -> Logits:
        """Return logits of the same walks for a randomness of `floor` instead of `above`."""
        chance = np.asarray(self.steps.chances(logits, above), np.float64)
        rest = (chance - floor * np.asarray(self.steps.even)) / (1 - floor)
        return np.log(np.maximum(rest, 1e-12))

    @one_blas_thread()
    def search(
        self, begins: Sequence[Logits], randomness: float, say: Say | None = None
    ) -> tuple[CaptureSearch, Logits]:
        """Follow the gradient from several starts, and return the best result with its logits."""
        steps = STEPS if self.unseen.shape[1] else 0
        ascent = self.ascent(randomness)
        tries = [
            ascent.climb(begin, steps, f"searching from start {number} of {len(begins)}", say)
            for number, begin in enumerate(begins, 1)
        ]
        teams, values = zip(*(self._team(walks) for _, walks, _ in tries), strict=True)
        best = int(np.argmax(values))
        logits, _, course = tries[best]
        search = CaptureSearch(
            policies=teams[best],
            attack_time=int(self.attack.times[0]),
            randomness=randomness,
            start=self.attack.start,
            tried=np.array(values),
            value=values[best],
            tours=self.tours[1],
            certificate=Certificate(steps * len(begins), late_gain(course), _TOLERANCE),
        )
        return search, logits

    def _team(self, walks: Sequence[Circulation]) -> tuple[tuple[Policy, ...], float]:
        team = tuple(self._policy(robot, walk) for robot, walk in enumerate(walks))
        caught = capture_probabilities(self.graph, self.visible, team, self.attack)[0]
        return team, float(caught[self.visible.any(axis=0)].min(initial=1.0))

    def _policy(self, robot: int, walk: Circulation) -> Policy:
        cells = self.graph.vertices
        chain = Chain(self.steps.image, jnp.asarray(walk.chance))
        flow = self.steps.matrices(walk.chance * walk.share)
        tail, head = self.graph.edges.T
        weights = flow[tail, head] + flow[head, tail]
        cover = greedy_cover(self.visible, robot)
        try:
            times = np.asarray(dense.hitting(chain.to_scipy().toarray()))
        except np.linalg.LinAlgError:
            times = np.full(1, np.nan)
        return Policy(
            cells=np.arange(cells, dtype=np.int32),
            weights=weights / weights.sum(),
            chain=chain,
            cover=cover.chosen,
            uncovered=cover.uncovered,
            contact=None,
            tour=None,
            commute_time=2 * float(times.mean()) * cells / (cells - 1),
            certificate=None,
        )
