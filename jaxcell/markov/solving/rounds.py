"""Elimination without subtractions, as in `elimination.py`, of many sparse chains at once.

The chains have the same steps, with different probabilities. States are eliminated in rounds. The
states of a round have no steps to each other, so that a round is a few operations on arrays with a
row per step and a column per chain. States that cause few new steps go first (Markowitz 1957), such
as those with one certain step.
"""

import dataclasses
import functools
import threading
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...mapping.batch import Batch, Sums


# Largest number of products of probabilities per chain: the first, plus the second per step.
_MOST, _MOST_PER_STEP = 500_000, 20
_HALF_ULP = 2.0**-53
# Below this number products of probabilities lose digits.
_TINY = 1e-280
_SEED = 0
# Number of products of the plans that are kept, which take about 40 bytes each.
_KEPT = 10_000_000
_PLANS: dict[tuple[bytes, ...], Any] = {}
_LOCK = threading.Lock()


@np.errstate(all="ignore")
def eliminated(
    batch: Batch,
    inside: Bool[np.ndarray, "cells"],
    right: Float[np.ndarray, "cells #members"],
    *,
    adjoint: bool = False,
) -> tuple[Float[np.ndarray, "cells members"], Float[np.ndarray, "members"]]:
    """Solve `x = right + Q x`, or `x = right + Q' x` if `adjoint`, where `Q` is `P` on `inside`.

    **Returns:** the solution, 0 on other cells, and a bound on its relative errors if no number of
    `right` is negative. They are NaN for a chain that cannot leave the cells, or with numbers too
    small for 64 bits.

    **Raises:** `RuntimeError` if it would take too many multiplications.
    """
    used, sums, plan = _plan(*(x.tobytes() for x in (batch.tail, batch.head, inside)))
    if plan is None:
        raise RuntimeError("elimination in rounds: too many multiplications")
    chance = np.zeros((plan.tail.size, batch.chance.shape[1]))
    chance[: sums.shape[0]] = sums @ batch.chance[used]
    x = np.zeros((inside.size, max(right.shape[1], chance.shape[1])))
    x[inside], sure = plan.solve(chance, np.broadcast_to(right, x.shape)[inside], adjoint)
    x[:, ~sure] = np.nan
    return x, np.where(sure, plan.error, np.nan)


@dataclasses.dataclass(frozen=True, eq=False)
class Round:
    """States that are eliminated at once."""

    out: Int[np.ndarray, "out"]
    "The steps from the states."
    into: Int[np.ndarray, "into"]
    "The steps to the states."
    first: Int[np.ndarray, "ways"]
    "For each way through a state, the index in `into` of its first step."
    second: Int[np.ndarray, "ways"]
    "The second step of each way."
    here: Sums
    "Sums over the steps `out`, for the states."
    after: Sums
    "Sums over the steps `out`, for the states to which they lead."
    there: Sums
    "Sums over the steps `into`, for the states."
    before: Sums
    "Sums over the steps `into`, for the states from which they lead."
    whole: Sums
    "Sums over the ways, for the steps whose probabilities they increase."


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """The rounds of an elimination, with all steps between different states that arise in it."""

    states: int
    tail: Int[np.ndarray, "steps"]
    head: Int[np.ndarray, "steps"]
    "The state to which a step leads, or `states` for a step out of all states."
    rounds: list[Round]
    error: float
    """A bound on the relative error of solutions, as in `eliminate`: if `m` states lead to a state
    with `n` steps, its elimination changes `m` rows by less than `n + 8` roundings."""

    @functools.cached_property
    def products(self) -> int:
        """Number of products of probabilities per chain."""
        return sum(part.first.size for part in self.rounds)

    @classmethod
    def of(
        cls,
        states: int,
        tail: Int[np.ndarray, "steps"],
        head: Int[np.ndarray, "steps"],
        terms: int,
    ) -> "Plan | None":
        """Plan the elimination of a chain with these steps, or return `None` if it is too long.

        The probability of each step is a sum of at most `terms` numbers.
        """
        most = most_products(tail.size)
        rank = np.random.default_rng(_SEED).permutation(states + 1)
        never = np.iinfo(np.int64).max
        width = states + 1
        tails, heads, step, count = [tail], [head], np.arange(tail.size), tail.size
        left = np.arange(width) < states
        rounds, work, error = [], 0, 2 * states * (terms + 2)
        while left.any():
            m, n = (np.bincount(end, minlength=width) for end in (head, tail))
            # States that cause fewer new steps than their neighbours; equals are in random order.
            cost = np.where(left, m * n * width + rank, never)
            least = np.full(width, never)
            np.minimum.at(least, tail, cost[head])
            np.minimum.at(least, head, cost[tail])
            now = left & (cost < least)
            left &= ~now
            work += int((m * n)[now].sum())
            if work > most:
                return None
            error += int(((2 * m + 2) * (n + 8))[now].sum())
            (into,), (out,) = np.nonzero(now[head]), np.nonzero(now[tail])
            # All pairs of a step to a state and a step from it, except those that return.
            out = out[np.argsort(tail[out], kind="stable")]
            many = n[head[into]]
            first = np.repeat(np.arange(into.size), many)
            begin = np.searchsorted(tail[out], head[into]) - np.cumsum(many) + many
            second = out[np.arange(first.size) + begin[first]]
            onward = tail[into[first]] != head[second]
            first, second = first[onward], second[onward]
            (kept,) = np.nonzero(~(now[tail] | now[head]))
            ways = tail[into[first]] * width + head[second]
            # A way that is not a step yet becomes one, with a new number.
            pairs = np.append(tail[kept] * width + head[kept], ways)
            ends, where, place = np.unique(pairs, return_index=True, return_inverse=True)
            old = where < kept.size
            number = count - 1 + np.cumsum(~old)
            number[old] = step[kept[where[old]]]
            new = ends[~old]
            whole = number[place[kept.size :]]
            sums = map(Sums.of, (tail[out], head[out], head[into], tail[into], whole))
            rounds.append(Round(step[out], step[into], first, step[second], *sums))
            tails.append(new // width)
            heads.append(new % width)
            tail, head = np.append(tail[kept], tails[-1]), np.append(head[kept], heads[-1])
            step = np.append(step[kept], np.arange(count, count + new.size))
            count += new.size
        bound = error * _HALF_ULP
        return cls(states, np.concatenate(tails), np.concatenate(heads), rounds, bound)

    def solve(
        self,
        chance: Float[np.ndarray, "steps #members"],
        right: Float[np.ndarray, "states members"],
        adjoint: bool,
    ) -> tuple[Float[np.ndarray, "states members"], Bool[np.ndarray, "members"]]:
        """Solve for the probabilities of the first steps in `chance`, whose other rows are 0.

        Returns the solutions, and whether no number is too small for 64 bits.
        """
        tail, head = self.tail, self.head
        x = np.append(right, np.zeros((1, right.shape[1])), axis=0)
        on = np.zeros((self.states + 1, chance.shape[1]))
        shares = []
        for part in self.rounds:
            part.here.add(on, chance[part.out])
            shares.append(chance[part.into] / on[head[part.into]])
            part.whole.add(chance, shares[-1][part.first] * chance[part.second])
            if adjoint:
                x[part.here.number] /= on[part.here.number]
                part.after.add(x, chance[part.out] * x[tail[part.out]])
            else:
                part.before.add(x, shares[-1] * x[head[part.into]])
        x[-1] = 0
        for part, share in zip(reversed(self.rounds), reversed(shares), strict=True):
            if adjoint:
                part.there.add(x, share * x[tail[part.into]])
            else:
                part.here.add(x, chance[part.out] * x[head[part.out]])
                x[part.here.number] /= on[part.here.number]
        sure = (chance > _TINY).all(axis=0) & (on[:-1] > 0).all(axis=0)
        return x[:-1], np.broadcast_to(sure, right.shape[1])


def most_products(steps: int) -> int:
    """Return the largest number of products of probabilities for a chain with these steps."""
    return _MOST + _MOST_PER_STEP * steps


def _plan(*steps: bytes) -> tuple[Int[np.ndarray, "used"], Any, Plan | None]:
    """Return the plan for the tails and heads of steps and the cells `inside`, also a kept one.

    A sweep goes through many patterns of steps again and again, so as many plans are kept as fit.
    """
    with _LOCK:
        kept = _PLANS.pop(steps, None)
    kept = _planned(*steps) if kept is None else kept
    with _LOCK:
        _PLANS[steps] = kept
        while (
            len(_PLANS) > 1 and sum(plan.products for *_, plan in _PLANS.values() if plan) > _KEPT
        ):
            _PLANS.pop(next(iter(_PLANS)))
    return kept


def _planned(
    tail: bytes, head: bytes, inside: bytes
) -> tuple[Int[np.ndarray, "used"], Any, Plan | None]:
    """Plan the elimination of the cells `inside`; return the steps that count, and their sums."""
    begin, end = (np.frombuffer(each, np.int64) for each in (tail, head))
    mask = np.append(np.frombuffer(inside, bool), False)
    states = int(mask.sum())
    place = np.where(mask, np.cumsum(mask) - 1, states)
    begin, end = place[begin], place[end]
    (used,) = np.nonzero((begin < states) & (begin != end))
    sums = Sums.of(begin[used] * (states + 1) + end[used])
    terms = int(np.diff(sums.matrix.indptr).max(initial=1))
    plan = Plan.of(states, *np.divmod(sums.number, states + 1), terms)
    return used, sums.matrix, plan
