import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..base.indices import as_array, check_indices
from ..base.precision import require_x64
from ..base.shown import Shown
from ..base.wide import traced
from ..mapping.generalized import Chain, ChainLike
from .hitting import common_cells


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class DecisionModel(Shown):
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
    def of(cls, chains: Sequence[ChainLike], reward: Any, allowed: Any = None) -> "DecisionModel":
        """Create a model from the chain, the rewards and the allowed cells of each action.

        `reward` and `allowed` are arrays `[actions, cells]`. By default all actions are allowed.
        Rewards of actions that are not allowed are ignored.
        """
        require_x64("DecisionModel")
        shape = (len(chains), common_cells(chains, "action"))
        may = np.ones(shape, bool) if allowed is None else as_array(allowed, "allowed")
        gain = as_array(reward, "reward").astype(np.float64)
        for name, array, dtype in (("allowed", may, bool), ("reward", gain, np.float64)):
            if array.shape != shape or array.dtype != dtype:
                raise ValueError(
                    f"{name}: expected an array [actions, cells] = {list(shape)} of "
                    f"{np.dtype(dtype)}, got {list(array.shape)} of {array.dtype}"
                )
        gain = jnp.where(may, gain, 0)
        if traced(may, gain):
            return cls(tuple(chains), gain, jnp.asarray(may))
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


def policy_chain(model: DecisionModel, policy: Int[Array, "cells"]) -> Chain:
    """Return the chain that takes the action of a policy in each cell.

    **Arguments:** a model, and an action for each cell. **Returns:** the chain.

    A robot on three cells in a row goes right or left, and gains 1 at the right end:

        >>> import jax.numpy as jnp
        >>> from jaxcell import examples, markov
        >>> markov.policy_chain(examples.line_model(), jnp.array([0, 0, 1])).image.tolist()
        [[1, 2, 1]]
    """
    chosen = check_indices(policy, model.actions, "policy", "action")
    if chosen.shape != (model.cells,):
        raise ValueError(
            f"policy: expected an action for each of {model.cells} cells, got {list(chosen.shape)}"
        )
    if traced(model, chosen):
        return _closed(model, chosen)
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
    # A program cannot refuse an action.
    may = jnp.any(
        model.allowed & (policy[None] == jnp.arange(model.actions, dtype=policy.dtype)[:, None]),
        axis=0,
    )
    probability = jnp.broadcast_to(jnp.where(may, 0.0, jnp.nan), image.shape)
    for action, chain in enumerate(model.chains):
        used = chain.image.shape[0]
        taken = (may & (policy == action))[None]
        image = image.at[:used].set(jnp.where(taken, chain.image, image[:used]))
        probability = probability.at[:used].set(
            jnp.where(taken, chain.probability, probability[:used])
        )
    return Chain(image, probability)
