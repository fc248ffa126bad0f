import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float, Int

from ..base.certificate import Certificate, Real, Whole
from ..base.divided import put_on_device
from ..base.shown import Pictured
from ..base.wide import traced
from ..mapping.batch import Batch
from ..mapping.generalized import Chain
from ..mapping.traced import implicit, like, on_host
from .decision import DecisionModel, policy_chain
from .moves import Moves, Policy, Usable
from .solving.solve import LIMITS, solve_signed, solve_transient
from .traced import CERTIFIED, solve


_HALF_ULP = 2.0**-53
# Number of sweeps with a policy between two choices of a policy. The fastest number is 5 for a
# drifter with a goal, and 40 for processes that never end.
_SWEEPS = 30
# Largest number of sweeps in all.
_MOST_SWEEPS = 2000
# Largest number of corrections of the last values.
_CORRECTIONS = 10
# Relative error of sums of gains that only bound errors.
_ROUGH = 0.01

_Gains = Float[np.ndarray, "actions cells"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Optimum(Pictured):
    """The value of every cell, and the best action in it."""

    value: Float[Array, "cells"]
    policy: Int[Array, "cells"]
    "The action to take in each cell; the first of equally good actions."
    certificate: Certificate
    "The certificate; its residual bounds the error of every value, relative to the largest one."

    @property
    def iterations(self) -> Whole:
        """Number of choices of a policy."""
        return self.certificate.iterations

    @property
    def gap(self) -> Real:
        """An upper bound on the error of every value, in units of the reward.

        The values of other policies exceed those of `policy` by at most twice this bound.
        """
        largest: Any = jnp.abs(self.value).max()
        return self.certificate.residual * (largest if traced(self) else float(largest))


def value_iteration(
    model: DecisionModel,
    discount: Real | Whole,
    tolerance: float | int = 1e-8,
    *,
    max_rounds: int = 1000,
    throw: bool = True,
) -> Optimum:
    """Find the best policy of a decision model, and its values (Alam 2018, Alg. 5.5).

    As in the dissertation, the reward of the first step is discounted too: the value is
    `V = discount * max_u (r_u + P_u V)`. Most texts and programs use
    `W = max_u (r_u + discount * P_u W)`; then `V = discount * W`, and the policies are equal.

    The algorithm of the dissertation repeats this equation until no value changes, which takes
    about `20 / (1 - discount)` sweeps, and may never end in floating-point arithmetic. Here, unless
    a few sweeps suffice, each policy is evaluated exactly, by a linear solve, and improved where an
    action gains more (Howard 1960), which seldom takes more than ten rounds. The bound on the error
    is that of MacQueen (1966): if an application of the equation changes all values by `low` to
    `high`, all errors are between `low / (1 - discount)` and `high / (1 - discount)`. If this is
    too much, the sum of all later changes under any policy is the bound, from another iteration.
    Both include rounding, and hold for the rows of [`jaxcell.mapping.Chain.to_scipy`][], which adds
    up the probabilities of equal images, even if their sums differ from 1 by rounding.

    **Arguments:** a model; a discount of more than 0 and less than 1 (without a discount, values
    may be infinite; see [`jaxcell.markov.stochastic_shortest_path`][]); a tolerance relative to the
    largest value; and the largest number of choices of a policy. **Returns:** the value and best
    action of each cell.

    A robot on three cells in a row goes right or left, and gains 1 at the right end:

        >>> from jaxcell import examples, markov
        >>> best = markov.value_iteration(examples.line_model(), discount=0.5)
        >>> best.policy.tolist(), best.value.round(6).tolist()
        ([0, 0, 0], [0.25, 0.5, 1.0])
    """
    if not traced(discount) and not 0 < discount < 1:
        raise ValueError(
            f"discount: expected more than 0 and less than 1, got {discount}; "
            "without a discount, use stochastic_shortest_path, for the quickest arrival"
        )
    for name, number in (("tolerance", tolerance), ("max_rounds", max_rounds)):
        if not number > 0:
            raise ValueError(f"{name}: expected a positive number, got {number}")
    factor: Any = jnp.asarray(discount, float) if traced(discount) else discount
    compute, many = (
        functools.partial(find, tolerance=float(tolerance), max_rounds=max_rounds)
        for find in (_optimum, _optima)
    )
    form = like(float, model.cells), like(int, model.cells), *CERTIFIED
    problem = model.chains, model.allowed, model.reward, factor
    value, policy, rounds, residual = on_host(compute, form, *problem, many=many)
    certificate = Certificate(rounds, residual, float(tolerance))
    certificate.check("value_iteration", throw)
    value, policy = put_on_device((value, policy))
    if traced(problem):
        taken = policy[None] == jnp.arange(model.actions, dtype=policy.dtype)[:, None]
        gain = jnp.where(taken, model.reward, 0.0).sum(axis=0)
        inputs = policy_chain(model, policy), gain, jnp.asarray(factor, value.dtype)
        value = implicit(_change, value, inputs)
    return Optimum(value, policy, certificate)


def _are_choices(allowed: Usable, reward: Float[np.ndarray, "*members actions cells"]) -> bool:
    """Check that each cell has an action, and that rewards are finite, as `DecisionModel` does."""
    return bool(np.any(allowed, axis=0).all() and np.isfinite(reward).all())


def _optimum(
    matrices: Sequence[scipy.sparse.csr_array],
    allowed: Usable,
    reward: _Gains,
    discount: float,
    *,
    tolerance: float,
    max_rounds: int,
) -> tuple[Float[np.ndarray, "cells"], Policy, int, float]:
    discount = float(discount)
    if not 0 < discount < 1 or not _are_choices(allowed, reward):
        raise ValueError("discount, allowed, reward")
    problem = _Discounted.of(Moves.of(matrices, allowed), np.asarray(reward), discount)
    policy, found, rounds = problem.improve(tolerance, max_rounds)
    for _ in range(_CORRECTIONS):
        if found.residual <= tolerance:
            break
        corrected = problem.correct(found.better, found)
        if corrected.residual >= found.residual:
            break
        policy, found = found.better, corrected
    if found.residual > tolerance:
        found = problem.bound(found, max_rounds)
    return found.value, policy.astype(np.int32), rounds, found.residual


def _optima(
    batches: Sequence[Batch],
    allowed: Usable,
    reward: Float[np.ndarray, "members actions cells"],
    discount: Float[np.ndarray, "members"],
    *,
    tolerance: float,
    max_rounds: int,
) -> tuple[Any, Any, Any, Any]:
    """Find the best policies of members with equal chains by sweeps, for all members at once.

    Values are NaN where sweeps are too slow.
    """
    wrong = not ((discount > 0) & (discount < 1)).all() or not _are_choices(allowed, reward)
    if wrong or any(batch.chance.shape[1] > 1 for batch in batches):
        raise RuntimeError("expected discounts between 0 and 1, finite rewards, and equal chains")
    moves = Moves.of([batch.matrix() for batch in batches], allowed)
    gain = np.where(allowed, discount[:, None, None] * reward, -np.inf).transpose(1, 2, 0)
    value, left = np.zeros((moves.cells, discount.size)), np.arange(discount.size)
    rounds, cell = np.zeros(discount.size, np.int32), np.arange(moves.cells)
    for _ in range(min(max_rounds, _MOST_SWEEPS // _SWEEPS)):
        rounds[left] += 1
        later = discount[left] * moves.expected(value[:, left])
        total, now = gain[..., left] + later, value[:, left]
        # Members share more policies if gains that do not matter do not decide.
        spare = tolerance / 4 * (1 - discount[left]) * np.abs(now).max(axis=0)
        best = (total >= total.max(axis=0) - spare).argmax(axis=0)
        users: dict[bytes, list[int]] = {}
        for member, policy in zip(left.tolist(), best.T, strict=True):
            users.setdefault(policy.tobytes(), []).append(member)
        for policy, members in users.items():
            chosen = np.frombuffer(policy, best.dtype)
            step, own = moves.of_policy(chosen), gain[chosen[:, None], cell[:, None], members]
            swept, scale = value[:, members], discount[members]
            for _ in range(_SWEEPS):
                swept = own + scale * (step @ swept)
            value[:, members] = swept
        # All later sweeps change values by less than this, if the policies stay.
        fall, after = discount[left] ** _SWEEPS, value[:, left]
        change = fall / (1 - fall) * np.abs(after - now).max(axis=0)
        left = left[change > tolerance / 4 * np.abs(after).max(axis=0)]
        if not left.size:
            break
    none = np.zeros(moves.cells)
    found = [
        _Evaluated.of(_Discounted.of(moves, *given), row, none)
        for *given, row in zip(reward, discount.tolist(), value.T, strict=True)
    ]
    residual = np.array([one.residual for one in found])
    value = np.where(residual[:, None] <= tolerance, [one.value for one in found], np.nan)
    return value, np.array([one.better for one in found], np.int32), rounds, residual


def _change(value: Float[Array, "cells"], inputs: Any) -> Float[Array, "cells"]:
    """Solve for the change of the values of the best policy, for their derivatives."""
    chain, gain, discount = inputs
    left = discount * (gain + chain.pull(value)) - value
    discounted = Chain(chain.image, discount * chain.probability)
    everywhere = jnp.ones(value.shape, bool)
    return solve(discounted, everywhere, left - jax.lax.stop_gradient(left))


@dataclasses.dataclass(frozen=True, eq=False)
class _Discounted:
    """A decision model with a discount."""

    moves: Moves
    reward: _Gains
    discount: float
    ending: _Gains
    "1 minus the discounted sum of the probabilities of each action in each cell, with all digits."

    @classmethod
    def of(cls, moves: Moves, reward: _Gains, discount: float) -> "_Discounted":
        return cls(moves, reward, discount, (1 - discount) + discount * moves.missing)

    @property
    def stays(self) -> bool:
        """`True` if no action leaves the space, up to rounding."""
        ending = self.ending[self.moves.allowed]
        return bool(ending.max() < 2 * ending.min())

    def improve(self, tolerance: float, max_rounds: int) -> tuple[Policy, "_Evaluated", int]:
        """Improve a policy until it is the best, and return it, its values and the rounds.

        A policy is evaluated exactly, by a solve (Howard 1960). If the discount lets values
        converge in a few sweeps, sweeps with the policy are faster (Puterman and Shin 1978).
        """
        none = np.zeros(self.moves.cells)
        found = _Evaluated.of(self, none, none)
        policy, rounds, tried, least = found.better, 0, set[bytes](), math.inf
        few = self.moves.cells > LIMITS.small and self.discount**_MOST_SWEEPS <= tolerance
        while True:
            rounds += 1
            sweeps = few and rounds * _SWEEPS <= _MOST_SWEEPS
            if sweeps:
                found = _Evaluated.of(self, self._swept(policy, found.value), none)
            else:
                tried.add(policy.tobytes())
                found = self.evaluate(policy)
            # Rounding could make the iteration wander among equally good policies.
            settled = least / 2 < found.residual or np.array_equal(found.better, policy)
            if found.residual <= tolerance and settled:
                return policy, found, rounds
            if not sweeps and (rounds >= max_rounds or found.better.tobytes() in tried):
                return policy, found, rounds
            least = min(least, found.residual)
            policy = found.better

    def _swept(
        self, policy: Policy, value: Float[np.ndarray, "cells"]
    ) -> Float[np.ndarray, "cells"]:
        step, reward = self.moves.of_policy(policy), _chosen(self.reward, policy)
        for _ in range(_SWEEPS):
            value = self.discount * (reward + step @ value)
        return value

    def evaluate(self, policy: Policy) -> "_Evaluated":
        """Compute the values of a policy."""
        value = self._solve(policy, self.discount * _chosen(self.reward, policy))
        return _Evaluated.of(self, value, np.zeros_like(value))

    def correct(self, policy: Policy, found: "_Evaluated") -> "_Evaluated":
        """Correct values to those of a policy by a solve for their residual."""
        change = self._solve(policy, _chosen(found.gain, policy))
        own = found.own + change
        base = found.base + own
        # `own` keeps what rounding takes from `base`.
        return _Evaluated.of(self, base, own - (base - found.base))

    def bound(self, found: "_Evaluated", max_rounds: int) -> "_Evaluated":
        """Bound the errors of values by the sum of all later gains, which hardly add up.

        An optimal policy may gain, in each step, at most what `gain` and its rounding are for the
        action. The best action loses, in each step, at most its rounding.
        """
        if not self.ending[self.moves.allowed].min() > 0:
            return found
        value = found.base + found.own
        largest = float(np.abs(value).max())
        spare = found.rounding + 2 * _HALF_ULP * largest * self.ending
        more = self._total(found.gain + found.rounding, spare, max_rounds)
        surest = np.argmax(found.gain - found.rounding, axis=0)
        less = self._total(found.rounding - found.gain, spare, 1, surest)
        residual = _ratio(max(more, less) + 4 * _HALF_ULP * largest, largest)
        if residual > found.residual:
            return found
        return dataclasses.replace(found, value=value, residual=residual)

    def _total(
        self, gain: _Gains, spare: _Gains, max_rounds: int, policy: Policy | None = None
    ) -> float:
        """Bound the discounted sum of all gains, with the best policy or the given one.

        Numbers `w >= gain + discount * P_u w` are a bound. Gains that include `spare` have such
        sums in spite of rounding.
        """
        moves = self.moves
        if policy is not None:
            only = np.arange(len(gain))[:, None] == policy
            moves = dataclasses.replace(moves, allowed=only)
        reward = np.where(moves.allowed, gain + spare, 0) / self.discount
        problem = dataclasses.replace(self, moves=moves, reward=reward)
        _, total, _ = problem.improve(_ROUGH, max_rounds)
        enough = total.gain + total.rounding <= spare
        return float(total.value.max()) if enough[moves.allowed].all() else math.inf

    def _solve(self, policy: Policy, right: np.ndarray) -> Float[np.ndarray, "cells"]:
        step = (self.discount * self.moves.of_policy(policy)).tocsr()
        ending = np.maximum(_chosen(self.ending, policy), 0)
        return solve_signed(lambda columns: solve_transient(step, ending, columns)[0], right)


@dataclasses.dataclass(frozen=True, eq=False)
class _Evaluated:
    """Values `base + own` of cells, and what each action would change.

    A step changes large values by little if the discount is near 1, so both parts are kept, and the
    change is computed from the differences between the values of cells.
    """

    base: Float[np.ndarray, "cells"]
    own: Float[np.ndarray, "cells"]
    gain: _Gains
    "By how much an action, followed by these values, exceeds them."
    better: Policy
    "The first action in each cell whose gain is the largest, up to rounding."
    value: Float[np.ndarray, "cells"]
    "The values; if nothing leaves, they are moved to the middle of their bounds."
    rounding: _Gains
    "Bounds on the errors of gains."
    residual: float
    "A bound on the error of every value, relative to the largest."

    @classmethod
    def of(
        cls,
        problem: _Discounted,
        base: Float[np.ndarray, "cells"],
        own: Float[np.ndarray, "cells"],
    ) -> "_Evaluated":
        moves, discount, ending = problem.moves, problem.discount, problem.ending
        reward = discount * problem.reward
        moved, size = moves.changes(base, own)
        gain = reward + discount * moved - ending * base - ending * own
        size = np.abs(reward) + discount * size + np.abs(ending) * (np.abs(base) + np.abs(own))
        terms = np.diff(moves.matrix.indptr).reshape(gain.shape) + 8
        rounding = terms * _HALF_ULP * size
        gain = np.where(moves.allowed, gain, -np.inf)
        low, high = (gain - rounding).max(axis=0), (gain + rounding).max(axis=0)
        better = np.argmax(gain + rounding >= low, axis=0)
        least, most = ending[moves.allowed].min(), ending[moves.allowed].max()
        # A constant `c` added to all values is a bound if a step changes it by enough.
        down, up = float(low.min()), float(high.max())
        down, up = down / (least if down < 0 else most), up / (least if up > 0 else most)
        # If mass leaves, values of 0 are right where it has left, so no constant is added.
        middle = (down + up) / 2 if problem.stays else 0.0
        value = base + own + middle
        largest = float(np.abs(value).max())
        gap = float(max(up - middle, middle - down)) + 4 * _HALF_ULP * largest
        residual = _ratio(gap if least > 0 else math.inf, largest)
        return cls(base, own, gain, better, value, rounding, residual)


def _ratio(gap: float, largest: float) -> float:
    if gap == 0:
        return 0.0
    return gap / largest if math.isfinite(gap) and largest else math.inf


def _chosen(table: _Gains, policy: Policy) -> Float[np.ndarray, "cells"]:
    """Return the entry of the action of a policy in each cell."""
    return table[policy, np.arange(policy.size)]
