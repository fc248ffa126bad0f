import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..base.certificate import Certificate
from ..base.precision import require_x64
from ..mapping.generalized import Chain
from .hitting import common_cells


# Number of sweeps with a fixed policy between two choices of a policy. The fastest number is 5 for
# a drifter with a goal, and 40 for processes that never end; 10 is nearly as fast for both.
_SWEEPS = 10
# Actions whose gains differ by less, relative to the largest value, are equally good.
_TIE = 1e-12


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class DecisionModel:
    """A Markov decision process on cells: in each cell one of several actions is taken.

    The chain of an action has the probabilities of its moves. If a row sums to less than 1, the
    rest is the probability of leaving for the sink, where no more rewards are gained.

    A robot on three cells in a row goes right or left, and gains 1 at the right end:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> right = mapping.Chain(np.array([[1, 2, 2]]), np.ones((1, 3)))
        >>> left = mapping.Chain(np.array([[0, 0, 1]]), np.ones((1, 3)))
        >>> reward = np.array([[0, 0, 1], [0, 0, 1]])
        >>> model = markov.DecisionModel.of([right, left], reward)
        >>> model.actions, model.cells
        (2, 3)
    """

    chains: tuple[Chain, ...]
    "The chain of each action, over the same cells."
    reward: Float[Array, "actions cells"]
    "The expected reward of each action in each cell."
    allowed: Bool[Array, "actions cells"]
    "`True` for each action that can be taken in each cell; each cell has at least one."

    @classmethod
    def of(cls, chains: Sequence[Chain], reward: Any, allowed: Any = None) -> "DecisionModel":
        """Create a model from the chain, the rewards and the allowed cells of each action.

        `reward` and `allowed` are arrays `[actions, cells]`. By default all actions are allowed.
        Rewards of actions that are not allowed are ignored.
        """
        require_x64("DecisionModel")
        shape = (len(chains), common_cells(chains, "action"))
        may = np.ones(shape, bool) if allowed is None else np.asarray(allowed)
        gain = np.asarray(reward, np.float64)
        for name, array, dtype in (("allowed", may, bool), ("reward", gain, np.float64)):
            if array.shape != shape or array.dtype != dtype:
                raise ValueError(
                    f"{name}: expected an array [actions, cells] = {list(shape)} of "
                    f"{np.dtype(dtype)}, got {list(array.shape)} of {array.dtype}"
                )
        gain = np.where(may, gain, 0)
        if not np.isfinite(gain).all():
            action, cell = np.argwhere(~np.isfinite(gain))[0]
            raise ValueError(
                f"reward[{action}, {cell}] is {gain[action, cell]}; expected a finite number"
            )
        if not may.any(axis=0).all():
            raise ValueError(
                f"allowed: no action is allowed in cell {np.argmin(may.any(axis=0))}; expected one"
            )
        return cls(tuple(chains), *jax.device_put((gain, np.array(may))))

    @property
    def actions(self) -> int:
        """Number of actions."""
        return len(self.chains)

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.chains[0].cells


@dataclasses.dataclass(frozen=True, eq=False)
class Optimum:
    """The value of every cell, and the best action in it."""

    value: Float[Array, "cells"]
    policy: Int[Array, "cells"]
    "The action to take in each cell; the first of equally good actions."
    certificate: Certificate
    "The certificate; its residual bounds the error of every value."

    @property
    def iterations(self) -> int:
        """Number of sweeps over all cells."""
        return self.certificate.iterations

    @property
    def gap(self) -> float:
        """An upper bound on the error of every value, up to rounding.

        The values of other policies exceed those of `policy` by at most twice this bound.
        """
        return self.certificate.residual


def value_iteration(
    model: DecisionModel,
    discount: float | int,
    tolerance: float | int = 1e-8,
    *,
    max_sweeps: int = 100_000,
    throw: bool = True,
) -> Optimum:
    """Find the best policy of a decision model with value iteration (Alam 2018, Alg. 5.5).

    As in the dissertation, the reward of the first step is discounted too: the value is
    `V = discount * max_u (r_u + P_u V)`. Most texts and programs use
    `W = max_u (r_u + discount * P_u W)`; then `V = discount * W`, and the policies are equal.

    Most sweeps keep the policy, which is several times faster (modified policy iteration, Puterman
    and Shin 1978). The algorithm of the dissertation stops when no value changes, which may never
    happen in floating-point arithmetic. Here the iteration stops when a bound on the error is below
    the tolerance (MacQueen 1966): if a sweep changes all values by at most `c`, all later changes
    together are at most `c * discount / (1 - discount)`.

    **Arguments:** a model; a discount of more than 0 and less than 1 (without a discount, values
    may be infinite; see [`jaxcell.markov.stochastic_shortest_path`][]); a tolerance in units of the
    reward; and the largest number of sweeps. **Returns:** the value and best action of each cell.

    A robot on three cells in a row goes right or left, and gains 1 at the right end:

        >>> from jaxcell import examples, markov
        >>> best = markov.value_iteration(examples.line_model(), discount=0.5)
        >>> best.policy.tolist(), best.value.round(6).tolist()
        ([0, 0, 0], [0.25, 0.5, 1.0])
    """
    if not 0 < discount < 1:
        raise ValueError(
            f"discount: expected more than 0 and less than 1, got {discount}; "
            "without a discount, use stochastic_shortest_path, for the quickest arrival"
        )
    if not tolerance > 0:
        raise ValueError(f"tolerance: expected a positive number, got {tolerance}")
    value, policy, gap, sweeps = _iterate(model, float(discount), float(tolerance), max_sweeps)
    certificate = Certificate(int(sweeps), float(gap), float(tolerance))
    certificate.check("value_iteration", throw)
    return Optimum(value, policy, certificate)


def policy_chain(model: DecisionModel, policy: Int[Array, "cells"]) -> Chain:
    """Return the chain that takes the action of a policy in each cell.

    **Arguments:** a model, and an action for each cell. **Returns:** the chain.

    A robot on three cells in a row goes right or left, and gains 1 at the right end:

        >>> import jax.numpy as jnp
        >>> from jaxcell import examples, markov
        >>> markov.policy_chain(examples.line_model(), jnp.array([0, 0, 1])).image.tolist()
        [[1, 2, 1]]
    """
    chosen = np.asarray(policy)
    wrong = np.flatnonzero((chosen < 0) | (chosen >= model.actions))
    if wrong.size:
        raise ValueError(
            f"policy: cell {wrong[0]} has action {chosen[wrong[0]]}; actions are 0 to "
            f"{model.actions - 1}"
        )
    forbidden = np.flatnonzero(~np.asarray(model.allowed)[chosen, np.arange(model.cells)])
    if forbidden.size:
        cell = forbidden[0]
        raise ValueError(f"policy: action {chosen[cell]} is not allowed in cell {cell}")
    return _closed(model, chosen)


@jax.jit
def _closed(model: DecisionModel, policy: Int[Array, "cells"]) -> Chain:
    branches = max(chain.image.shape[0] for chain in model.chains)
    me = jnp.arange(model.cells, dtype=jnp.int32)
    image = jnp.broadcast_to(me, (branches, model.cells))
    probability = jnp.zeros(image.shape)
    for action, chain in enumerate(model.chains):
        used = chain.image.shape[0]
        taken = (policy == action)[None]
        image = image.at[:used].set(jnp.where(taken, chain.image, image[:used]))
        probability = probability.at[:used].set(
            jnp.where(taken, chain.probability, probability[:used])
        )
    return Chain(image, probability)


@jax.jit
def _iterate(
    model: DecisionModel,
    discount: Float[Array, ""],
    tolerance: Float[Array, ""],
    max_sweeps: Int[Array, ""],
) -> tuple[Float[Array, "cells"], Int[Array, "cells"], Float[Array, ""], Int[Array, ""]]:
    """Iterate the values; return them, the policy, an error bound, and the number of sweeps."""
    ahead = discount / (1 - discount)
    leaks = functools.reduce(
        jnp.logical_or,
        (
            jnp.any((chain.leaving > 0) & may)
            for chain, may in zip(model.chains, model.allowed, strict=True)
        ),
    )

    def choose(value):  # type: ignore[no-untyped-def]
        """Update the values of all cells once, with the best actions.

        Returns the new values; the best action in each cell; the first of the actions that are best
        up to rounding; a lower and an upper bound on the sum of all later changes of a value; and
        whether this update changed the values by no more than rounding errors.
        """
        gains = [
            jnp.where(may, reward + chain.pull(value), -jnp.inf)
            for chain, reward, may in zip(model.chains, model.reward, model.allowed, strict=True)
        ]
        gain = jnp.stack(gains)
        best = jnp.max(gain, axis=0)
        scale = jnp.max(jnp.abs(best))
        # The sweeps need a best action, because they would lose the gain over a nearly best one.
        policy = jnp.argmax(gain, axis=0).astype(jnp.int32)
        tied = jnp.argmax(gain >= (best - _TIE * scale)[None], axis=0).astype(jnp.int32)
        later = discount * best
        change = later - value
        # The sink counts as one more cell, whose value never changes.
        low = jnp.minimum(jnp.min(change), jnp.where(leaks, 0.0, jnp.inf))
        high = jnp.maximum(jnp.max(change), jnp.where(leaks, 0.0, -jnp.inf))
        rounding = jnp.maximum(-low, high) <= 4 * jnp.finfo(value.dtype).eps * scale
        return later, policy, tied, ahead * low, ahead * high, rounding

    def gap(low, high):  # type: ignore[no-untyped-def]
        """Bound the error of the values, given bounds `low` and `high` on the sum of later changes.

        If no action leads to the sink, the bound is for the values plus `(low + high) / 2`.
        """
        return jnp.where(leaks, jnp.maximum(-low, high), (high - low) / 2)

    def going_on(state):  # type: ignore[no-untyped-def]
        (_, _, _, low, high, rounding), sweeps = state
        return (gap(low, high) > tolerance) & ~rounding & (sweeps < max_sweeps)

    def improve(state):  # type: ignore[no-untyped-def]
        (value, policy, *_), sweeps = state
        chain = _closed(model, policy)
        reward = jnp.take_along_axis(model.reward, policy[None], axis=0)[0]

        def sweep(_, value):  # type: ignore[no-untyped-def]
            return discount * (reward + chain.pull(value))

        return choose(jax.lax.fori_loop(0, _SWEEPS, sweep, value)), sweeps + _SWEEPS + 1

    # The start is below all true values, so that values grow.
    lowest = ahead * jnp.minimum(jnp.min(model.reward), 0.0)
    start = (choose(jnp.full(model.cells, lowest)), jnp.int32(1))
    (value, _, policy, low, high, _), sweeps = jax.lax.while_loop(going_on, improve, start)
    return value + jnp.where(leaks, 0.0, (low + high) / 2), policy, gap(low, high), sweeps
