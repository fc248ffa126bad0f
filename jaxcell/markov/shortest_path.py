import dataclasses
import functools
from typing import TypeAlias

import jax
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from ..base.certificate import Certificate
from ..base.precision import require_x64
from ..mapping.classes import next_cells, reaching
from ..mapping.generalized import leaving_rows
from .conditional import ALMOST_SURE, conditioned
from .decision import DecisionModel
from .hitting import PROBABILITY_TOLERANCE, TIME_TOLERANCE, cell_mask, leaving_times
from .transient import Transient


_Cells: TypeAlias = Bool[np.ndarray, "cells"]
_Values: TypeAlias = Float[np.ndarray, "cells"]
_Policy: TypeAlias = Int[np.ndarray, "cells"]
_Usable: TypeAlias = Bool[np.ndarray, "actions cells"]

# Relative gain up to which a policy is not changed.
_BETTER = 1e-11
# Actions are equally sure if their probabilities of arriving differ relatively by less than this.
_TIE = 1e-11
_MAX_ROUNDS = 1000


@dataclasses.dataclass(frozen=True, eq=False)
class ShortestPath:
    """The quickest of the policies with the highest probability of arriving at a goal."""

    probability: Float[Array, "cells"]
    "The largest probability of arriving; exactly 1 in cells from which arrival can be certain."
    time: Float[Array, "cells"]
    """The least expected number of steps among policies that are certain to arrive; `inf` if no
    policy is certain to arrive."""
    conditional_time: Float[Array, "cells"]
    """The least expected number of steps, over the paths that arrive, among policies with the
    largest probability of arriving; `inf` if no policy arrives."""
    policy: Int[Array, "cells"]
    "The action to take in each cell. This policy attains the probabilities and the times."
    certificate: Certificate
    """The certificate. Its residual is the larger of two numbers: the largest relative gain in time
    from a change of one action, and 1e4 times the largest gain in probability."""


def stochastic_shortest_path(
    model: DecisionModel, goal: npt.ArrayLike | int, *, throw: bool = True
) -> ShortestPath:
    """Find the quickest of the policies with the highest probability of arriving at a goal.

    This is the problem of Alam 2018, section 5.4.7, without a discount. Rewards have no effect.

    The cells from which some policy is certain to arrive are found exactly, on the graph of all
    steps. For the other cells, the policy is improved until its probability of arriving is the
    largest (policy iteration, Howard 1960). Then its expected time over the paths that arrive is
    reduced, with actions that preserve this probability. The policy is changed only where the
    change is strictly better; otherwise the iteration could cycle between equally good policies.

    **Arguments:** a model, and a goal: a cell, a list of cells, or a mask over the cells. Actions
    in the goal have no effect. **Returns:** probabilities, times and the policy.

    A robot on three cells in a row goes right or left, but half of its steps to the right fail:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> half = np.full((2, 3), 0.5)
        >>> right = mapping.Chain(np.array([[1, 2, 2], [0, 1, 2]]), half)
        >>> left = mapping.Chain(np.array([[0, 0, 1]]), np.ones((1, 3)))
        >>> model = markov.DecisionModel.of([right, left], np.zeros((2, 3)))
        >>> best = markov.stochastic_shortest_path(model, goal=2)
        >>> best.policy[:2].tolist(), best.time.round(6).tolist()
        ([0, 0], [4.0, 2.0, 0.0])
    """
    require_x64("stochastic_shortest_path")
    there = cell_mask(model.cells, goal)
    moves = _Moves.of(model)
    usable = moves.allowed & ~there
    can = reaching(moves.joint(usable), there)
    sure, safe = _sure(moves, usable, there)
    policy = np.argmax(moves.allowed, axis=0)
    policy = moves.nearer(policy, usable, sure)
    policy = moves.nearer(policy, safe, there)
    probability, policy, surest = _surest(moves, policy, usable, sure, can & ~sure)
    keeps = np.where(sure, safe, usable & (moves.expected(probability) >= (1 - _TIE) * probability))
    # Rounding must not exclude the actions of the policy.
    keeps[policy, np.arange(model.cells)] |= can & ~there
    time, policy, quickest = _quickest(moves, policy, keeps, probability, there)
    certificate = Certificate(
        surest.iterations + quickest.iterations,
        # Each residual in units of its own tolerance.
        TIME_TOLERANCE
        * max(surest.residual / PROBABILITY_TOLERANCE, quickest.residual / TIME_TOLERANCE),
        TIME_TOLERANCE,
    )
    certificate.check("stochastic_shortest_path", throw)
    return ShortestPath(
        jax.device_put(probability),
        jax.device_put(np.where(sure, time, np.inf)),
        jax.device_put(time),
        jax.device_put(policy.astype(np.int32)),
        certificate,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Moves:
    """The possible steps of all actions, in a matrix with a row for each action in each cell."""

    matrix: scipy.sparse.csr_array
    allowed: _Usable
    stays: _Usable
    "`True` for an action in a cell if none of its steps from there leaves the space."

    @classmethod
    def of(cls, model: DecisionModel) -> "_Moves":
        matrices = [chain.to_scipy() for chain in model.chains]
        stays = np.stack([leaving_rows(matrix) == 0 for matrix in matrices])
        matrix = scipy.sparse.vstack(matrices, format="csr")
        return cls(matrix, np.asarray(model.allowed), stays)

    @property
    def cells(self) -> int:
        return self.allowed.shape[1]

    @functools.cached_property
    def steps(self) -> tuple[Int[np.ndarray, "edges"], Int[np.ndarray, "edges"]]:
        """The row and the column of every possible step, row by row."""
        return self.matrix.nonzero()

    def of_policy(self, policy: _Policy) -> scipy.sparse.csr_array:
        return self.matrix[policy * self.cells + np.arange(self.cells)]

    def expected(self, value: _Values) -> Float[np.ndarray, "actions cells"]:
        """Compute the expected value after one step, for each action and cell."""
        return (self.matrix @ value).reshape(self.allowed.shape)

    def joint(self, usable: _Usable) -> scipy.sparse.csr_array:
        """Return the graph of all possible steps of usable actions."""
        row, column = self.steps
        kept = usable.ravel()[row]
        row, column = row[kept] % self.cells, column[kept]
        # Entries of a pair of cells are added up.
        ones = np.ones(row.size)
        return scipy.sparse.csr_array((ones, (row, column)), shape=(self.cells, self.cells))

    def nearer(self, policy: _Policy, usable: _Usable, target: _Cells) -> _Policy:
        """Change a policy, where possible, to usable actions that may lead nearer to a target."""
        after = next_cells(self.joint(usable), target)
        row, column = self.steps
        action, cell = np.divmod(row, self.cells)
        leads = usable.ravel()[row] & ~target[cell] & (after[cell] == column)
        policy = policy.copy()
        # The first action is assigned last, so it stays.
        policy[cell[leads][::-1]] = action[leads][::-1]
        return policy


def _sure(moves: _Moves, usable: _Usable, target: _Cells) -> tuple[_Cells, _Usable]:
    """Find the cells from which some policy is certain to arrive, and the actions of such policies.

    Only `usable` actions that never leave the space are considered. Cells that cannot reach the
    target are removed, with all actions that may lead to them. This is repeated until every cell
    left can reach the target.
    """
    safe = usable & moves.stays
    sure = np.ones(moves.cells, bool)
    into = moves.matrix.T.tocsr()
    lost = ~reaching(moves.joint(safe), target)
    while lost.any():
        # Cells without a safe action are found without a search of the whole graph.
        while lost.any():
            sure &= ~lost
            safe[:, lost] = False
            safe.reshape(-1)[into[np.flatnonzero(lost)].indices] = False
            lost = sure & ~target & ~safe.any(axis=0)
        lost = sure & ~reaching(moves.joint(safe), target)
    return sure, safe


def _surest(
    moves: _Moves, policy: _Policy, usable: _Usable, sure: _Cells, maybe: _Cells
) -> tuple[_Values, _Policy, Certificate]:
    """Improve a policy until its probability of arriving from the cells `maybe` is the largest.

    The policy must be able to arrive from them. The cells `sure` have the probability 1. Returns
    the probability, the policy, and a certificate with the gain that is still possible.
    """
    value = sure.astype(np.float64)
    rounds, residual = 0, 0.0
    # A better policy leaves each class with a changed cell, because otherwise the average of the
    # value over this class would rise from one step to the next.
    while maybe.any():
        rounds += 1
        matrix = moves.of_policy(policy)
        part = Transient.of(matrix, maybe)
        value[maybe] = 0
        ends, _ = part.expect((matrix[part.cells] @ value)[:, None])
        value[maybe] = np.minimum(ends[:, 0], ALMOST_SURE)
        gain = np.where(usable, moves.expected(value), -1)
        best = gain.max(axis=0)
        residual = float(np.abs(best - value)[maybe].max())
        change = maybe & (best > value + _BETTER * value)
        if not change.any() or rounds >= _MAX_ROUNDS:
            break
        policy = np.where(change, gain.argmax(axis=0), policy)
    return value, policy, Certificate(rounds, residual, PROBABILITY_TOLERANCE)


def _quickest(
    moves: _Moves, policy: _Policy, keeps: _Usable, probability: _Values, target: _Cells
) -> tuple[_Values, _Policy, Certificate]:
    """Improve a policy until its time is minimal, while it keeps its `probability` of arriving.

    Only actions in the mask `keeps` are chosen. Returns the expected times over the paths that
    arrive, the policy, and a certificate that bounds the relative gain that is still possible.
    """
    toward = dataclasses.replace(moves, matrix=conditioned(moves.matrix, probability))
    time = np.where(probability > 0, 0.0, np.inf)
    inside = (probability > 0) & ~target
    rounds, residual = 0, 0.0
    while inside.any():
        rounds += 1
        time[inside], solved = leaving_times(toward.of_policy(policy), inside)
        after = 1 + toward.expected(np.where(inside, time, 0))
        after = np.where(keeps, after, np.inf)
        best = after.min(axis=0)
        residual = max(solved.residual, float((1 - best[inside] / time[inside]).max()))
        change = inside & (best < time * (1 - _BETTER))
        if not change.any() or rounds >= _MAX_ROUNDS:
            break
        policy = np.where(change, after.argmin(axis=0), policy)
    return time, policy, Certificate(rounds, residual, TIME_TOLERANCE)
