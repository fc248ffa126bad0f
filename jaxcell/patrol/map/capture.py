import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...base.certificate import Certificate
from ...base.precision import require_x64
from ...base.quantities import Result, derived, quantity
from ...base.threads import one_blas_thread
from ...mapping import Chain
from ...markov import dense
from ...optimize import Graph, greedy_cover, minimum_commute
from ..walks.optimal.ascent import Ascent, late_gain
from ..walks.steps import Steps
from ..walks.walk import edge_shares, random_walk
from .attack import capture_probabilities, check_attack_times, check_start
from .policies import Policy
from .regions import check_visible


# Gradient steps that try a start, and those that then improve the best one.
_TRIAL, _STEPS = 150, 450
# Steps are made in blocks of so many.
_BLOCK = 25
# On more cells fewer steps are made, which take longer.
_CELLS = 500
# Of the soft minimum of the logarithms of capture at the end.
_HARDNESS = 30.0, 100.0
# Of every step: so that the robot comes to all cells, and its share of time is unique.
_LEAST = 1e-5
# On more cells the walk with the least commute time takes longer than the search that begins there.
_COMMUTE = 600
# Of the value, by the last quarter of the steps.
_TOLERANCE = 0.02
# Spread of the logits at the first start and at the others, without which robots stay equal.
_SPREAD = 0.1, 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class CaptureSearch(Result):
    """Walks of robots that make the least probability of capture great: a local optimum."""

    title: ClassVar[str] = "Search for the patrol that captures most"
    tables: ClassVar[Mapping[str, str]] = {"attempt": "attempts"}

    policies: tuple[Policy, ...]
    attack_time: Annotated[int, quantity("", "steps of the attack", "steps", kind="count")]
    randomness: Annotated[float, quantity("", "least share of chance in a step", "1", kind="share")]
    "How often, at least, a step goes to any neighbour with equal chance."
    start: Annotated[str, quantity("", "where robots are as the attack begins")]
    tried: Annotated[
        Float[np.ndarray, "attempts"],
        quantity("attempt", "least probability of capture on trial", "1", kind="share"),
    ]
    value: Annotated[
        float, quantity("", "least probability of capture, a local optimum", "1", kind="share")
    ]
    certificate: Certificate

    @derived("attempt", "start", kind="coordinate")
    def attempt(self) -> Int[np.ndarray, "attempts"]:
        return np.arange(self.tried.size)

    @derived("", "share of it that the last quarter of the steps added", "1", kind="residual")
    def late_gain(self) -> float:
        return self.certificate.residual

    @derived("", "gradient steps", kind="count")
    def iterations(self) -> int:
        return self.certificate.iterations


@dataclasses.dataclass(frozen=True, eq=False)
class Frontier(Result):
    """What is left of capture where robots must be hard to predict."""

    title: ClassVar[str] = "Capture against entropy"
    tables: ClassVar[Mapping[str, str]] = {"floor": "floors"}

    floor: Annotated[
        Float[np.ndarray, "floors"],
        quantity("floor", "least share of chance in a step", "1", kind="coordinate"),
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
    graph: Graph,
    visible: Bool[np.ndarray, "cells cells"],
    robots: int,
    attack_time: int,
    *,
    randomness: float = 0.0,
    start: str = "uniform",
    starts: int = 3,
    seed: int = 0,
) -> CaptureSearch:
    """Walks for robots that make the least probability of capture over the cells great.

    The probability is that of [`jaxcell.patrol.capture_probabilities`][], which is differentiated
    in the logits of the steps of all robots together. Adam follows the gradient of a soft minimum
    over the cells, from the walk with the least commute time (on more than 600 cells, from the walk
    that takes all edges alike), made different for each robot and start by chance. The problem is
    not convex, and the answer a local optimum, the best that several starts lead to.

    **Arguments:**

    - `graph`, `visible`: as in [`jaxcell.patrol.capture_probabilities`][]; the graph is connected.
    - `robots`: how many.
    - `attack_time`: the steps that an attack takes.
    - `randomness`: the share of its steps in which a robot goes to any neighbour with equal chance,
        at least, 0 or more and less than 1. Without it a patrol is nearly a tour, and predictable.
    - `start`: where robots are as an attack begins, as in
        [`jaxcell.patrol.capture_probabilities`][].
    - `starts`: how many starts are tried.
    - `seed`: of the starts.

    **Returns:** [`CaptureSearch`][]. The residual of its certificate is the share of the value that
    the last quarter of the steps added: a large one says that more steps would find more.

    **Raises:** `ValueError` for numbers out of range, and an array that does not match the graph;
    `RuntimeError` where JAX is set to 32 bits.

    One robot in a corridor of five cells, each of which sees its neighbours:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> found = patrol.capture_policies(graph, visible, 1, 4)
        >>> commuting = patrol.distributed_policies(graph, visible, 1, 0.0)
        >>> before = patrol.capture_probabilities(graph, visible, commuting, [4]).min()
        >>> round(float(before), 3), round(found.value, 2)
        (0.463, 0.67)
    """
    problem = _Problem.of(graph, visible, robots, attack_time, start)
    _check_randomness(randomness)
    if starts < 1:
        raise ValueError(f"starts: expected at least 1, got {starts}")
    begins = problem.begins(starts, seed)
    return problem.search(begins, randomness)[0]


def capture_frontier(
    graph: Graph,
    visible: Bool[np.ndarray, "cells cells"],
    robots: int,
    attack_time: int,
    floors: Sequence[float],
    *,
    start: str = "uniform",
    seed: int = 0,
) -> Frontier:
    """How much capture is lost where steps must be hard to predict.

    **Arguments:**

    - `floors`: the values of `randomness`, in any order.
    - the others as in [`capture_policies`][].

    **Returns:** [`Frontier`][], whose floors rise. A search begins anew and from the patrol of the
    next higher floor, which the lower one allows too, so that capture does not rise with the floor.

    **Raises:** as [`capture_policies`][]; `ValueError` for no floors.

    A robot in a corridor of five cells that may not be predictable is worse at both ends:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> found = patrol.capture_frontier(graph, visible, 1, 4, [0.6, 0.0])
        >>> found.floor.tolist(), bool(found.least_capture[0] > found.least_capture[1])
        ([0.0, 0.6], True)
    """
    if not len(floors):
        raise ValueError("floors: expected at least one, got none")
    for floor in floors:
        _check_randomness(floor)
    problem = _Problem.of(graph, visible, robots, attack_time, start)
    found, warm, above = [], None, 0.0
    for floor in sorted({float(floor) for floor in floors}, reverse=True):
        begins = problem.begins(1, seed)
        if warm is not None:
            begins = [problem.under(warm, above, floor), *begins]
        best, warm = problem.search(begins, floor)
        above = max(floor, _LEAST)
        entropy = np.mean([entropy_rate(graph, policy) for policy in best.policies])
        found.append((floor, best.value, entropy))
    return Frontier(*np.array(found[::-1]).T)


def entropy_rate(graph: Graph, policy: Policy) -> float:
    """The entropy of a robot's step in the long run, in nats; 0 for one that stays."""
    share = policy.share_of_time(graph)
    chance = np.asarray(policy.chain.probability)
    surprise = -np.log(np.where(chance > 0, chance, 1.0))
    return float(share @ (chance * surprise).sum(axis=0))


def _check_randomness(randomness: float) -> None:
    if not 0 <= randomness < 1:
        raise ValueError(f"randomness: expected 0 or more and less than 1, got {randomness}")


@dataclasses.dataclass(frozen=True, eq=False)
class _Problem:
    """What is searched: the steps on a graph, and the targets where luck decides."""

    graph: Graph
    visible: Bool[np.ndarray, "cells cells"]
    robots: int
    attack_time: int
    start: str
    steps: Steps
    unseen: Float[np.ndarray, "cells targets"]
    "1 where a target is out of view, else 0."

    @classmethod
    def of(
        cls,
        graph: Graph,
        visible: Bool[np.ndarray, "cells cells"],
        robots: int,
        attack_time: int,
        start: str,
    ) -> "_Problem":
        require_x64("capture_policies")
        check_visible(graph, visible)
        check_start(start)
        (steps,) = check_attack_times([attack_time]).tolist()
        if not 1 <= robots <= graph.vertices:
            raise ValueError(
                f"robots: expected 1 to {graph.vertices}, the number of cells, got {robots}"
            )
        open_ = visible.any(axis=1) & ~visible.all(axis=1)
        unseen = (~visible[open_]).T.astype(np.float32)
        return cls(graph, visible, robots, steps, start, Steps.of(graph), unseen)

    def begins(self, count: int, seed: int) -> list[Float[np.ndarray, "robots branches cells"]]:
        """Logits from which to search."""
        weights = np.ones(len(self.graph.edges))
        if self.graph.vertices <= _COMMUTE:
            weights = minimum_commute(self.graph).weights
        matrix = random_walk(self.graph, np.maximum(weights, 1e-9)).to_scipy().toarray()
        walk = self.steps.logits(matrix)
        random = np.random.default_rng(seed)
        shape = (self.robots, *walk.shape)
        spreads = [_SPREAD[0], *[_SPREAD[1]] * (count - 1)]
        return [walk + spread * random.normal(size=shape) for spread in spreads]

    def under(
        self, logits: Float[Array, "robots branches cells"], above: float, floor: float
    ) -> Float[np.ndarray, "robots branches cells"]:
        """Logits of the same walks under a lower floor."""
        floor = max(floor, _LEAST)
        chance = np.asarray(self.steps.chances(jax.device_put(logits), above), np.float64)
        rest = (chance - floor * np.asarray(self.steps.even)) / (1 - floor)
        return np.log(np.maximum(rest, 1e-12))

    @one_blas_thread()
    def search(
        self, begins: Sequence[Float[np.ndarray, "robots branches cells"]], randomness: float
    ) -> tuple[CaptureSearch, Float[Array, "robots branches cells"]]:
        """The best of several starts after a trial, improved; and its logits."""
        floor = max(randomness, _LEAST)
        scale = min(1.0, _CELLS / self.graph.vertices)
        trial, steps = (_BLOCK * max(1, round(scale * n / _BLOCK)) for n in (_TRIAL, _STEPS))
        if self.unseen.shape[1] == 0:
            trial = steps = 0
        ascent = Ascent(
            self.steps, self.unseen, self.unseen, self.attack_time, self.start, floor, _HARDNESS
        )
        tries = [ascent.climb(begin, np.zeros(trial)) for begin in begins]
        best, _, state, _ = max(tries, key=lambda one: one[1])
        best, _, _, course = ascent.climb(state, np.arange(steps) / max(1, steps), best)
        policies = self.policies(best, floor)
        caught = capture_probabilities(
            self.graph, self.visible, policies, [self.attack_time], self.start
        )[0]
        value = float(caught[self.visible.any(axis=1)].min(initial=1.0))
        certificate = Certificate(trial * len(begins) + steps, late_gain(course), _TOLERANCE)
        values = np.array([one[1] for one in tries])
        found = CaptureSearch(
            policies, self.attack_time, randomness, self.start, values, value, certificate
        )
        return found, best

    def policies(
        self, logits: Float[Array, "robots branches cells"], floor: float
    ) -> tuple[Policy, ...]:
        """The policy of each robot, with 64 bits."""
        cells = np.arange(self.graph.vertices, dtype=np.int32)
        exact = jax.device_put(np.asarray(logits, np.float64))
        drawn = np.asarray(self.steps.chances(exact, floor))
        policies = []
        for robot, chance in enumerate(drawn):
            chain = Chain(self.steps.image, chance / chance.sum(axis=0))
            weights = edge_shares(self.graph, chain)
            cover = greedy_cover(self.visible, robot)
            times = np.asarray(dense.hitting(chain.to_scipy().toarray()))
            with np.errstate(invalid="ignore"):
                commute = 2 * float(times.mean()) * cells.size / (cells.size - 1)
            policies.append(
                Policy(
                    cells=cells,
                    weights=weights / weights.sum(),
                    chain=chain,
                    cover=cover.chosen,
                    uncovered=cover.uncovered,
                    contact=None,
                    tour=None,
                    # Where parts hardly ever meet it is lost in rounding.
                    commute_time=commute if commute > 0 else float("inf"),
                    certificate=None,
                )
            )
        return tuple(policies)
