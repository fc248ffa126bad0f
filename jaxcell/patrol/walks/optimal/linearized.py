import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from ..arrival import states_at
from .polytope import ChainPolytope


class LinearizedCapture:
    """The probabilities of capture near given chains, computed from sparse products in NumPy.

    Let `S_r` be the probability that a robot does not reach each target within a time `r`, from
    each start, and `P_t` the matrix of moves that take a time `t`. Then `S_r = sum_t P_t S_(r-t)`,
    where `S_(r-t)` counts as 0 at the target itself, but as 1 everywhere if the time `r - t` is
    negative. The derivative with respect to a move sums over the times at which the robot makes the
    move before it reaches the target. Only derivatives of selected attacks are computed, because
    those of all attacks with respect to all moves would be billions of numbers.

    The vertices of the polytope's graph are the targets or, for a robot with memory, its states:
    pairs of a memory state and a target, where the target varies fastest.
    """

    def __init__(
        self,
        polytope: ChainPolytope,
        moves: Float[np.ndarray, "robots moves"],
        attack: Int[np.ndarray, "targets"],
        delays: int | Int[np.ndarray, "states states"] = 1,
    ) -> None:
        n = polytope.vertices
        self._polytope = polytope
        self._attack = attack
        self._times = np.broadcast_to(delays, (n, n))[polytope.tails, polytope.heads]
        self._slowest, self._longest = int(self._times.max()), int(self._attack.max())
        self._away = 1 - states_at(n, attack.size)
        self._steps = [self._by_time(robot) for robot in moves]
        self._late = []
        self.probability = np.empty((len(moves), *self._away.shape))
        for steps, probability in zip(self._steps, self.probability, strict=True):
            # Entry `r + slowest` is the probability of a miss with a time `r` left.
            late = np.ones((self._slowest + self._longest, *self._away.shape))
            late[self._slowest] = self._away
            for left in range(1, self._longest + 1):
                missed = sum(step @ late[left - t + self._slowest] for t, step in steps)
                self._pass_on(left, missed, late, probability)
            self._late.append(late)
            np.subtract(1, probability, out=probability)

    def slopes(
        self, robot: int, starts: Int[np.ndarray, "attacks"], targets: Int[np.ndarray, "attacks"]
    ) -> Float[np.ndarray, "attacks moves"]:
        """Compute derivatives of probabilities of capture with respect to the moves of a robot."""
        n, tails, heads = len(self._away), self._polytope.tails, self._polytope.heads
        count = self._away.shape[1]
        late, left = self._late[robot], self._attack[targets][:, None]
        # The places in `late` of the probabilities of a miss after each first move.
        place = ((left - self._times + self._slowest) * n + heads) * count + targets[:, None]
        back = [(t, step.T.tocsr()) for t, step in self._steps[robot]]
        away, slopes = self._away.T[targets], np.zeros(place.shape)
        coming = [np.eye(n)[starts], *[np.zeros(away.shape)] * self._slowest]
        for time in range(self._longest):
            at = np.where(left > time, coming.pop(0), 0.0)
            slopes -= at[:, tails] * late.take(place - time * n * count, mode="clip")
            for t, step in back:
                coming[t - 1] = coming[t - 1] + away * (step @ at.T).T
            coming.append(np.zeros(away.shape))
        return slopes

    def along(
        self, robot: int, change: Float[np.ndarray, "moves"]
    ) -> Float[np.ndarray, "starts targets"]:
        """Compute the first-order change of all probabilities for a `change` of a robot's moves."""
        late, moved = self._late[robot], np.zeros_like(self._late[robot])
        change_missed = np.empty_like(self._away)
        both = list(zip(self._steps[robot], self._by_time(change), strict=True))
        for left in range(1, self._longest + 1):
            at = left + self._slowest
            missed = sum(new @ late[at - t] + step @ moved[at - t] for (t, step), (_, new) in both)
            self._pass_on(left, missed, moved, change_missed)
        return -change_missed

    def _by_time(
        self, moves: Float[np.ndarray, "moves"]
    ) -> list[tuple[int, scipy.sparse.csr_array]]:
        matrices, shape = [], (self._polytope.vertices,) * 2
        for time in np.unique(self._times).tolist():
            equal = self._times == time
            places = self._polytope.tails[equal], self._polytope.heads[equal]
            matrices.append((time, scipy.sparse.csr_array((moves[equal], places), shape)))
        return matrices

    def _pass_on(
        self,
        left: int,
        missed: Float[np.ndarray, "starts targets"],
        late: Float[np.ndarray, "times starts targets"],
        probability: Float[np.ndarray, "starts targets"],
    ) -> None:
        """Store `missed`, the probability of a miss in time `left`, in `late` for use with
        more time, and in `probability` for targets whose attack takes this time."""
        due = self._attack == left
        probability[:, due] = missed[:, due]
        if left < self._longest:
            late[left + self._slowest] = self._away * missed
