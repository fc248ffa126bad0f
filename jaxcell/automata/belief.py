import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ..base.shown import Shown
from .hidden import Estimate, HiddenMap, credible


# Probability, per observation, that the robot is carried away, or that its map is wrong.
_LOST = 1e-4
# Probability, per observation, that a robot off the map bumps.
_COIN = 0.5
# The expected entropy ignores bumps after this many steps, or if they are less probable than this.
_MAX_STEPS, _REST = 100, 1e-3
NOWHERE = 0.99
"A robot stops if the probability that it is lost, nowhere on the map, exceeds this value."
SMALL = 4
"A robot is localized if its credible set has at most this number of configurations."


@dataclasses.dataclass(frozen=True, eq=False)
class BeliefState(Shown):
    """A belief: the probability of each cell after some observations."""

    weight: Float[np.ndarray, "cells"]
    "The probability of each cell."
    nowhere: float
    "The probability that the robot is nowhere on the map, which is 1 minus the sum of `weight`."
    turn: int | None = None
    "After a bump, the index of the angle by which the robot turns; after a step, `None`."
    expected: float = 1.0
    "The probability of the last observation on the map, given the observations before it."


@dataclasses.dataclass(frozen=True, eq=False)
class Belief:
    """The forward filter of a hidden map: the probability of each cell given the observations.

    At each observation the robot may, with a small probability, get lost: then it is nowhere on the
    map, and its observations are tosses of a fair coin. If a coin explains the observations better
    than the map does, the robot is probably lost.

    A robot that can turn by several angles chooses, at each bump, the angle with the least
    [`jaxcell.automata.expected_entropy`][].

    A robot in one of three cells in a row, which always moves on and bumps at the end:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> moves, bumps = np.eye(3, k=1), np.diag([0.0, 0.0, 1.0])
        >>> hidden = automata.HiddenMap.of(moves, bumps, np.arange(3), np.ones(3) / 3)
        >>> belief = automata.Belief(hidden)
        >>> state = belief.observe(belief.start(), 0)
        >>> belief.estimate(state).cells.tolist()
        [1, 2]
    """

    hidden: HiddenMap
    share: float = 0.95
    "The minimum total probability of estimated configurations, given that the robot is on the map."

    def __post_init__(self) -> None:
        if not 0 < self.share <= 1:
            raise ValueError(f"share: expected more than 0 and at most 1, got {self.share:g}")

    def start(self) -> BeliefState:
        """Return the belief before the first observation."""
        return BeliefState(self.hidden.start, 0.0)

    def observe(self, state: BeliefState, observation: int) -> BeliefState:
        """Update the belief with an observation, 0 or 1, and choose the turn after a bump."""
        if not observation:
            return self._after(state, 0, None)
        turned = [self._after(state, 1 + i, i) for i in range(self.hidden.angles)]
        if len(turned) == 1:
            return turned[0]
        return min(turned, key=lambda after: expected_entropy(self.hidden, after.weight))

    def _after(self, state: BeliefState, event: int, turn: int | None) -> BeliefState:
        weight = self.hidden.after(event, state.weight)
        nowhere = _COIN * (state.nowhere + _LOST * (1 - state.nowhere))
        here, before = float(weight.sum()), float(state.weight.sum())
        total = here * (1 - _LOST) + nowhere
        weight, expected = weight * ((1 - _LOST) / total), here / before if before else 0.0
        return BeliefState(weight, float(nowhere / total), turn, expected)

    def estimate(self, state: BeliefState) -> Estimate:
        """Return the smallest set of configurations whose total probability is at least `share`."""
        return credible(self.hidden.masses(state.weight), self.share, state.nowhere)

    def smoothed(self, events: Sequence[int]) -> Float[np.ndarray, "times cells"]:
        """Compute the probability of each cell at each time, given all events of a run.

        Events are numbered as in [`HiddenMap.leaving`][]; with one angle, they are observations.

        **Raises:** `ValueError` if the run is impossible on the map.
        """
        forward = [self.hidden.start]
        for event in events:
            forward.append(_normal(self.hidden.after(event, forward[-1])))
        back = np.ones(self.hidden.cells)
        smoothed = [forward[-1]]
        for event, before in zip(events[::-1], forward[-2::-1], strict=True):
            back = _normal(self.hidden.leaving(event) @ back)
            smoothed.append(_normal(before * back))
        return np.stack(smoothed[::-1])

    def likeliest_path(self, events: Sequence[int]) -> Int[np.ndarray, "times"]:
        """Find the most probable sequence of cells in a run, with Viterbi's algorithm.

        The argument and the errors are those of [`Belief.smoothed`][].
        """
        arriving = [self.hidden.leaving(event).T.tocsr() for event in range(1 + self.hidden.angles)]
        with np.errstate(divide="ignore"):
            score = np.log(self.hidden.start)
        before = []
        for event in events:
            matrix = arriving[event]
            with np.errstate(divide="ignore"):
                scores = score[matrix.indices] + np.log(matrix.data)
            rows = np.flatnonzero(np.diff(matrix.indptr))
            score = np.full(self.hidden.cells, -np.inf)
            from_ = np.zeros(self.hidden.cells, np.int32)
            if rows.size:
                begin = matrix.indptr[rows]
                score[rows] = np.maximum.reduceat(scores, begin)
                best = np.flatnonzero(
                    scores == np.repeat(score[rows], np.diff(matrix.indptr)[rows])
                )
                first = best[np.searchsorted(best, begin)]
                from_[rows] = matrix.indices[first]
            if not np.isfinite(score).any():
                raise ValueError("events: expected a run that is possible on the map")
            before.append(from_)
        path = [int(np.argmax(score))]
        for from_ in before[::-1]:
            path.append(int(from_[path[-1]]))
        return np.array(path[::-1], np.int32)


def expected_entropy(hidden: HiddenMap, weight: Float[np.ndarray, "cells"]) -> float:
    """Compute the mean entropy of the configuration of a robot after its next bump.

    The robot observes the number of its steps until the bump. Given this number, its configuration
    has a distribution; the result is the mean entropy of these distributions. If a robot makes a
    hundred steps without a bump, this fact is all that it observes.

    **Arguments:** a hidden map, and the probability of each cell now, up to a factor. **Returns:**
    the entropy in bits, 0 if all probabilities are 0.

    A robot in one of three cells in a row always moves on and bumps at the end, so the number of
    its steps identifies its cell. A robot that always stays learns nothing:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> moves, bumps = np.eye(3, k=1), np.diag([0.0, 0.0, 1.0])
        >>> hidden = automata.HiddenMap.of(moves, bumps, np.arange(3), np.ones(3) / 3)
        >>> automata.expected_entropy(hidden, hidden.start)
        0.0
        >>> still = automata.HiddenMap.of(np.eye(3), 0 * bumps, np.arange(3), np.ones(3) / 3)
        >>> round(automata.expected_entropy(still, still.start), 3)
        1.585
    """
    entropy, total = 0.0, weight.sum()
    if total == 0:
        return entropy
    here = weight / total
    for _ in range(_MAX_STEPS):
        entropy += _weighted_entropy(hidden, here * hidden.bumping)
        here = hidden.after(0, here)
        if here.sum() < _REST:
            break
    return entropy + _weighted_entropy(hidden, here)


def _weighted_entropy(hidden: HiddenMap, weight: Float[np.ndarray, "cells"]) -> float:
    """Return the entropy of the configurations in bits, times the sum of the weights."""
    mass = hidden.masses(weight)
    mass = mass[mass > np.finfo(np.float64).tiny]
    return float((mass * np.log2(mass.sum() / mass)).sum())


def _normal(weight: Float[np.ndarray, "cells"]) -> Float[np.ndarray, "cells"]:
    total = weight.sum()
    if total == 0:
        raise ValueError("events: expected a run that is possible on the map")
    return np.asarray(weight / total)
