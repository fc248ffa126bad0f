import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from .hidden import Estimate, HiddenMap, credible


# How probable it is at each observation that the robot is carried off, or its map is wrong.
_LOST = 1e-4
# What a robot senses that is nowhere on the map is a coin that is tossed.
_COIN = 0.5
# An entropy is looked ahead for so many steps, or until so little has not bumped.
_MAX_STEPS, _REST = 100, 1e-3
NOWHERE = 0.99
"From this probability of being nowhere on a robot stops."
SMALL = 4
"With a credible set of no more configurations a robot is localized."


@dataclasses.dataclass(frozen=True, eq=False)
class BeliefState:
    """What a belief is after some observations."""

    weight: Float[np.ndarray, "cells"]
    "How probable each cell is."
    nowhere: float
    "How probable it is that the robot is in none of them; with it they sum to 1."
    turn: int | None = None
    "The number of the angle that the robot turns by now, after a bump."


@dataclasses.dataclass(frozen=True, eq=False)
class Belief:
    """The forward filter of a hidden map: how probable each cell is after what was observed.

    At each observation the robot may, with a small probability, have got lost: then it is nowhere
    on the map, and what it senses is a coin that is tossed. A run that the map explains worse than
    a coin does makes that probable.

    Where a robot may choose among angles, it turns at each bump by the one that leaves the least
    [`jaxcell.automata.expected_entropy`][].

    A robot in one of three cells in a row, which goes on for sure and bumps at the end:

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
    "The least probability of the configurations of an estimate together, given the map."

    def __post_init__(self) -> None:
        if not 0 < self.share <= 1:
            raise ValueError(f"share: expected more than 0 and at most 1, got {self.share:g}")

    def start(self) -> BeliefState:
        """The belief before the first observation."""
        return BeliefState(self.hidden.start, 0.0)

    def observe(self, state: BeliefState, observation: int) -> BeliefState:
        """The belief after an observation, 0 or 1, and the turn that follows a bump."""
        if not observation:
            return self._after(state, 0, None)
        turned = [self._after(state, 1 + i, i) for i in range(self.hidden.angles)]
        if len(turned) == 1:
            return turned[0]
        return min(turned, key=lambda one: expected_entropy(self.hidden, one.weight))

    def _after(self, state: BeliefState, event: int, turn: int | None) -> BeliefState:
        weight = self.hidden.after(event, state.weight)
        nowhere = _COIN * (state.nowhere + _LOST * (1 - state.nowhere))
        total = weight.sum() * (1 - _LOST) + nowhere
        return BeliefState(weight * ((1 - _LOST) / total), float(nowhere / total), turn)

    def estimate(self, state: BeliefState) -> Estimate:
        """The credible set: the fewest configurations that are so probable together."""
        return credible(self.hidden.masses(state.weight), self.share, state.nowhere)

    def smoothed(self, events: Sequence[int]) -> Float[np.ndarray, "times cells"]:
        """How probable each cell was at each time of a run, given all of the run.

        **Arguments:**

        - `events`: those of [`HiddenMap.leaving`][]: with one angle, the observations.

        **Raises:** `ValueError` if the run cannot be on the map.
        """
        forward = [self.hidden.start]
        for event in events:
            forward.append(_normal(self.hidden.after(event, forward[-1])))
        back = np.ones(self.hidden.cells)
        found = [forward[-1]]
        for event, before in zip(events[::-1], forward[-2::-1], strict=True):
            back = _normal(self.hidden.leaving(event) @ back)
            found.append(_normal(before * back))
        return np.stack(found[::-1])

    def likeliest_path(self, events: Sequence[int]) -> Int[np.ndarray, "times"]:
        """The most probable cells of a run, from the start to the end (Viterbi).

        **Arguments:**

        - `events`: as of [`Belief.smoothed`][].

        **Raises:** `ValueError` if the run cannot be on the map.
        """
        arriving = [self.hidden.leaving(event).T.tocsr() for event in range(1 + self.hidden.angles)]
        with np.errstate(divide="ignore"):
            score = np.log(self.hidden.start)
        before = []
        for event in events:
            matrix = arriving[event]
            with np.errstate(divide="ignore"):
                way = score[matrix.indices] + np.log(matrix.data)
            rows = np.flatnonzero(np.diff(matrix.indptr))
            score = np.full(self.hidden.cells, -np.inf)
            from_ = np.zeros(self.hidden.cells, np.int32)
            if rows.size:
                begin = matrix.indptr[rows]
                score[rows] = np.maximum.reduceat(way, begin)
                best = np.flatnonzero(way == np.repeat(score[rows], np.diff(matrix.indptr)[rows]))
                first = best[np.searchsorted(best, begin)]
                from_[rows] = matrix.indices[first]
            if not np.isfinite(score).any():
                raise ValueError("events: no path of the map has them")
            before.append(from_)
        path = [int(np.argmax(score))]
        for from_ in before[::-1]:
            path.append(int(from_[path[-1]]))
        return np.array(path[::-1], np.int32)


def expected_entropy(hidden: HiddenMap, weight: Float[np.ndarray, "cells"]) -> float:
    """The mean entropy of what a robot will know at its next bump, of its cell there.

    What a robot observes until then is how many steps it makes. For each number of them it is known
    how probable that is, and from which configuration the robot then bumps how probably; of these
    distributions it is the mean entropy. Steps without end, of which some are left after a hundred,
    are one more outcome.

    **Arguments:**

    - `hidden`: the map.
    - `weight`: how probable each cell is now, to a factor.

    **Returns:** the entropy in bits, 0 if nothing is probable.

    A robot in one of three cells in a row, which goes on for sure and bumps at the end. Wherever it
    is, its steps will tell; if it had to stay where it is, it would never know:

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
    found, total = 0.0, weight.sum()
    if total == 0:
        return found
    here = weight / total
    for _ in range(_MAX_STEPS):
        found += _unknown(hidden, here * hidden.bumping)
        here = hidden.after(0, here)
        if here.sum() < _REST:
            break
    return found + _unknown(hidden, here)


def _unknown(hidden: HiddenMap, weight: Float[np.ndarray, "cells"]) -> float:
    """The entropy of the configuration in an outcome, times how probable the outcome is."""
    mass = hidden.masses(weight)
    mass = mass[mass > np.finfo(np.float64).tiny]
    return float((mass * np.log2(mass.sum() / mass)).sum())


def _normal(weight: Float[np.ndarray, "cells"]) -> Float[np.ndarray, "cells"]:
    total = weight.sum()
    if total == 0:
        raise ValueError("events: no path of the map has them")
    return np.asarray(weight / total)
