"""Probabilities of capture near some chains: values and derivatives, sparse or all of them."""

import dataclasses

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from .polytope import ChainPolytope


class LinearizedCapture:
    """The probabilities near some chains, in sparse products on the host.

    With `S_k` the probability that a robot has not come to each target within `k` steps, from each
    start, `S_0` is 1 off the target and `S_k = P S_(k-1)` there. A move changes what a robot makes
    of it at each step before it comes to the target. So few attacks take few numbers, where
    derivatives of all of them, by all moves, would take thousands of millions.
    """

    def __init__(
        self, polytope: ChainPolytope, moves: Float[np.ndarray, "robots moves"], attack_time: int
    ) -> None:
        self._polytope = polytope
        self._away = 1 - np.eye(polytope.vertices)
        self._matrices = [self._matrix(robot) for robot in moves]
        self._late = [self._missed(matrix, attack_time) for matrix in self._matrices]
        late = zip(self._matrices, self._late, strict=True)
        self.probability = np.array([1 - matrix @ late[-1] for matrix, late in late])

    def slopes(
        self, robot: int, starts: Int[np.ndarray, "attacks"], targets: Int[np.ndarray, "attacks"]
    ) -> Float[np.ndarray, "attacks moves"]:
        """The derivatives of the probabilities of some attacks by the moves of a robot."""
        tails, heads = self._polytope.tails, self._polytope.heads
        at = np.eye(self._polytope.vertices)[starts]
        away, back = self._away[targets], self._matrices[robot].T.tocsr()
        found = np.zeros((starts.size, tails.size))
        for late in reversed(self._late[robot]):
            found -= at[:, tails] * late[heads][:, targets].T
            at = away * (back @ at.T).T
        return found

    def along(
        self, robot: int, change: Float[np.ndarray, "moves"]
    ) -> Float[np.ndarray, "starts targets"]:
        """By how much all probabilities change with the moves of a robot, to first order."""
        matrix, changed = self._matrices[robot], self._matrix(change)
        moved = np.zeros_like(self._away)
        first, *later = self._late[robot]
        for late in [first, *later]:
            last = changed @ late + matrix @ moved
            moved = self._away * last
        return -last

    def _matrix(self, moves: Float[np.ndarray, "moves"]) -> scipy.sparse.csr_array:
        shape = (self._polytope.vertices, self._polytope.vertices)
        places = (self._polytope.tails, self._polytope.heads)
        return scipy.sparse.csr_array((moves, places), shape)

    def _missed(
        self, matrix: scipy.sparse.csr_array, attack_time: int
    ) -> list[Float[np.ndarray, "starts targets"]]:
        late = [self._away]
        for _ in range(attack_time - 1):
            late.append(self._away * (matrix @ late[-1]))
        return late


@dataclasses.dataclass(frozen=True, eq=False)
class DenseCapture:
    """Probabilities of capture with all of their derivatives."""

    probability: Float[np.ndarray, "robots starts targets"]
    slope: Float[np.ndarray, "robots starts targets moves"]

    def slopes(
        self, robot: int, starts: Int[np.ndarray, "attacks"], targets: Int[np.ndarray, "attacks"]
    ) -> Float[np.ndarray, "attacks moves"]:
        return self.slope[robot, starts, targets]

    def along(
        self, robot: int, change: Float[np.ndarray, "moves"]
    ) -> Float[np.ndarray, "starts targets"]:
        return self.slope[robot] @ change
