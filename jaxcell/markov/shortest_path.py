import dataclasses
from collections.abc import Sequence
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from ..base.certificate import Certificate
from ..base.divided import put_on_device
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import traced
from ..mapping.classes import reaching
from ..mapping.traced import like, on_host
from .conditional import ALMOST_SURE, conditioned, distortion
from .decision import DecisionModel, policy_chain
from .hitting import TOLERANCE, cell_mask, check_target, leaving_times
from .moves import Moves, Policy, Usable
from .solving.scaled import Scaled
from .traced import CERTIFIED, expected
from .transient import Transient


_Cells: TypeAlias = Bool[np.ndarray, "cells"]
_Values: TypeAlias = Float[np.ndarray, "cells"]

# Relative gain up to which a policy is not changed.
_BETTER = 1e-11
# Actions are equally sure if their probabilities of arriving differ relatively by less than this.
_TIE = 1e-11
_MAX_ROUNDS = 1000


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class ShortestPath(Pictured):
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
    """The certificate. Its residual is the largest of four numbers: the error of the probabilities,
    the relative error of the times of the policy, and the largest gain in probability and relative
    gain in time from a change of one action."""


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
    real = like(float, model.cells)
    form = real, real, like(int, model.cells), like(bool, model.cells), *CERTIFIED
    arguments = model.chains, model.allowed, there
    probability, time, policy, sure, rounds, residual = on_host(_shortest, form, *arguments)
    certificate = Certificate(rounds, residual, TOLERANCE)
    certificate.check("stochastic_shortest_path", throw)
    probability, time, policy, sure = put_on_device((probability, time, policy, sure))
    if traced(arguments):
        # The best policy stays the best for small changes.
        inside = jnp.isfinite(time) & ~there
        product = jnp.where(inside, time * probability, 0.0)
        chain = policy_chain(model, policy)
        probability = expected(probability, chain, inside & ~sure, 0.0)
        product = expected(product, chain, inside, probability)
        time = jnp.where(inside, product / probability, time)
    certain = jnp.where(sure | jnp.isnan(time), time, jnp.inf)
    return ShortestPath(probability, certain, time, policy, certificate)


def _shortest(
    matrices: Sequence[scipy.sparse.csr_array], allowed: Usable, there: _Cells
) -> tuple[_Values, _Values, Policy, _Cells, int, float]:
    check_target(there)
    if not np.any(allowed, axis=0).all():
        raise ValueError("allowed: expected an action in each cell")
    moves = Moves.of(matrices, allowed)
    usable = moves.allowed & ~there
    can = reaching(moves.joint(usable), there)
    sure, safe = _sure(moves, usable, there)
    policy = np.argmax(moves.allowed, axis=0)
    policy = moves.nearer(policy, usable, sure)
    policy = moves.nearer(policy, safe, there)
    probability, policy, relative, surest = _surest(moves, policy, usable, sure, can & ~sure)
    keeps = np.where(sure, safe, usable & (moves.expected(probability) >= (1 - _TIE) * probability))
    # Rounding must not exclude the actions of the policy.
    inside = can & ~there
    keeps[policy, np.arange(moves.cells)] |= inside
    time, policy, quickest = _quickest(moves, policy, keeps, probability, relative, inside)
    rounds = surest.iterations + quickest.iterations
    residual = max(surest.residual, quickest.residual)
    return probability, time, policy.astype(np.int32), sure, rounds, residual


def _sure(moves: Moves, usable: Usable, target: _Cells) -> tuple[_Cells, Usable]:
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
    moves: Moves, policy: Policy, usable: Usable, sure: _Cells, maybe: _Cells
) -> tuple[_Values, Policy, float, Certificate]:
    """Improve a policy until its probability of arriving from the cells `maybe` is the largest.

    The policy must be able to arrive from them. The cells `sure` have the probability 1. Returns
    the probability, the policy, a bound on the relative errors of its probabilities, and a
    certificate with the gain that is still possible.
    """
    value = sure.astype(np.float64)
    rounds, residual, relative = 0, 0.0, 0.0
    # A better policy leaves each class with a changed cell, because otherwise the average of the
    # value over this class would rise from one step to the next.
    while maybe.any():
        rounds += 1
        matrix = moves.of_policy(policy)
        part = Transient.of(matrix, maybe)
        value[maybe] = 0
        ends = part.expect((matrix[part.cells] @ value)[:, None])
        value[maybe] = np.clip(ends.value[:, 0], 0, ALMOST_SURE)
        gain = np.where(usable, moves.expected(value), -1)
        best = gain.max(axis=0)
        residual = float(max(np.abs(best - value)[maybe].max(), ends.error[:, 0].max()))
        relative = float(ends.relative[:, 0].max())
        change = maybe & (best > value + _BETTER * value)
        if not change.any() or rounds >= _MAX_ROUNDS:
            break
        policy = np.where(change, gain.argmax(axis=0), policy)
    return value, policy, relative, Certificate(rounds, residual, TOLERANCE)


def _quickest(
    moves: Moves,
    policy: Policy,
    keeps: Usable,
    probability: _Values,
    relative: float,
    inside: _Cells,
) -> tuple[_Values, Policy, Certificate]:
    """Improve a policy until its time is minimal, while it keeps its `probability` of arriving.

    Only actions in the mask `keeps` are chosen, in the cells `inside`, from which it can arrive.
    `relative` bounds the relative errors of probabilities. Returns the expected times over the
    paths that arrive, the policy, and a certificate that bounds the relative gain that is still
    possible.
    """
    arrives = Scaled.of(probability)
    matrix, total = conditioned(moves.matrix, arrives)
    toward = dataclasses.replace(moves, matrix=matrix)
    time = np.where(inside | (probability > 0), 0.0, np.inf)
    rounds, residual = 0, 0.0
    while inside.any():
        rounds += 1
        time[inside], solved = leaving_times(toward.of_policy(policy), inside)
        # Times that are too long for 64-bit numbers stay the longest.
        with np.errstate(over="ignore", invalid="ignore"):
            after = 1 + toward.expected(np.where(inside, time, 0))
            after = np.where(keeps & ~np.isnan(after), after, np.inf)
            best = after.min(axis=0)
            gain = np.where(np.isinf(time[inside]), 0, 1 - best[inside] / time[inside])
        residual = max(solved.residual, float(gain.max()))
        change = inside & (best < time * (1 - _BETTER))
        if not change.any() or rounds >= _MAX_ROUNDS:
            break
        policy = np.where(change, after.argmin(axis=0), policy)
    row = policy * moves.cells + np.arange(moves.cells)
    before = moves.of_policy(policy)
    residual += distortion(before, arrives, total[row], relative, time, inside)
    return time, policy, Certificate(rounds, residual, TOLERANCE)
