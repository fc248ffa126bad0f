"""Probabilities of capture near some chains: their values, and their derivatives as needed."""

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from .polytope import ChainPolytope


class LinearizedCapture:
    """The probabilities near some chains, in sparse products on the host.

    With `S_r` the probability that a robot has not come to each target within a time `r`, from each
    start, and `P_t` the moves that take a time `t`, `S_r = sum_t P_t S_(r-t)`, where `S` counts as
    0 at the target itself, and as 1 everywhere after the attack. A move changes what a robot makes
    of it each time before it comes to the target. So few attacks take few numbers, where
    derivatives of all of them, by all moves, would take thousands of millions.

    **Arguments:**

    - `polytope`, `moves`: the chains of the robots.
    - `attack`: how long an attack takes, a whole number, or array `[vertices]`.
    - `delays`: how long moves take, a whole number, or array `[vertices, vertices]`.
    """

    def __init__(
        self,
        polytope: ChainPolytope,
        moves: Float[np.ndarray, "robots moves"],
        attack: int | Int[np.ndarray, "vertices"],
        delays: int | Int[np.ndarray, "vertices vertices"] = 1,
    ) -> None:
        n = polytope.vertices
        self._polytope = polytope
        self._attack = np.broadcast_to(attack, n)
        self._times = np.broadcast_to(delays, (n, n))[polytope.tails, polytope.heads]
        self._slowest, self._longest = int(self._times.max()), int(self._attack.max())
        self._away = 1 - np.eye(n)
        self._steps = [self._by_time(robot) for robot in moves]
        self._late = []
        self.probability = np.empty((len(moves), n, n))
        for steps, probability in zip(self._steps, self.probability, strict=True):
            # At `r + slowest`, what is missed with a time `r` left.
            late = np.ones((self._slowest + self._longest, n, n))
            late[self._slowest] = self._away
            for left in range(1, self._longest + 1):
                missed = sum(step @ late[left - t + self._slowest] for t, step in steps)
                self._pass_on(left, missed, late, probability)
            self._late.append(late)
            np.subtract(1, probability, out=probability)

    def slopes(
        self, robot: int, starts: Int[np.ndarray, "attacks"], targets: Int[np.ndarray, "attacks"]
    ) -> Float[np.ndarray, "attacks moves"]:
        """The derivatives of the probabilities of some attacks by the moves of a robot."""
        n, tails, heads = self._polytope.vertices, self._polytope.tails, self._polytope.heads
        late, left = self._late[robot], self._attack[targets][:, None]
        # Where `late` has what is missed after each move, made first.
        place = ((left - self._times + self._slowest) * n + heads) * n + targets[:, None]
        back = [(t, step.T.tocsr()) for t, step in self._steps[robot]]
        away, found = self._away[targets], np.zeros(place.shape)
        coming = [np.eye(n)[starts], *[np.zeros(away.shape)] * self._slowest]
        for time in range(self._longest):
            at = np.where(left > time, coming.pop(0), 0.0)
            found -= at[:, tails] * late.take(place - time * n**2, mode="clip")
            for t, step in back:
                coming[t - 1] = coming[t - 1] + away * (step @ at.T).T
            coming.append(np.zeros(away.shape))
        return found

    def along(
        self, robot: int, change: Float[np.ndarray, "moves"]
    ) -> Float[np.ndarray, "starts targets"]:
        """By how much all probabilities change with the moves of a robot, to first order."""
        late, moved = self._late[robot], np.zeros_like(self._late[robot])
        found = np.empty_like(self._away)
        both = list(zip(self._steps[robot], self._by_time(change), strict=True))
        for left in range(1, self._longest + 1):
            at = left + self._slowest
            missed = sum(new @ late[at - t] + step @ moved[at - t] for (t, step), (_, new) in both)
            self._pass_on(left, missed, moved, found)
        return -found

    def _by_time(
        self, moves: Float[np.ndarray, "moves"]
    ) -> list[tuple[int, scipy.sparse.csr_array]]:
        """The matrices of the moves that take each time."""
        found, shape = [], (self._polytope.vertices,) * 2
        for time in np.unique(self._times).tolist():
            some = self._times == time
            places = self._polytope.tails[some], self._polytope.heads[some]
            found.append((time, scipy.sparse.csr_array((moves[some], places), shape)))
        return found

    def _pass_on(
        self,
        left: int,
        missed: Float[np.ndarray, "starts targets"],
        late: Float[np.ndarray, "times starts targets"],
        found: Float[np.ndarray, "starts targets"],
    ) -> None:
        """Keep what is missed with a time left: for moves to come, and where all of it is left."""
        due = self._attack == left
        found[:, due] = missed[:, due]
        if left < self._longest:
            late[left + self._slowest] = self._away * missed
