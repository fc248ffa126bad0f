import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float, Int

from ..base.certificate import Certificate, Real
from ..base.divided import put_on_device, start_loop
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import traced
from ..mapping.classes import closed_classes
from ..mapping.sequence import check_steps
from ..mapping.traced import implicit, like, on_host
from .decision import DecisionModel, policy_chain
from .limiting import limiting_distribution
from .moves import Moves, Usable
from .solving.solve import solve_signed
from .solving.stationary import solve_stationary
from .traced import CERTIFIED
from .transient import Transient


# An action that gains less, relative to the largest value, is no improvement.
_BETTER = 1e-12
# Largest error of the average, relative to the largest reward.
_TOLERANCE = 1e-8
_MAX_ROUNDS = 1000
_HALF_ULP = 2.0**-53


def finite_horizon(
    model: DecisionModel, steps: int
) -> tuple[Float[Array, "{steps}+1 cells"], Int[Array, "{steps} cells"]]:
    """Find the best actions for a given number of steps, by backward induction.

    With `n` steps left, `V_n = max_u (r_u + P_u V_(n-1))`, without a discount; `V_0 = 0`.

    **Arguments:** a model, and the number of steps. **Returns:** `V_0, ..., V_steps`, and the best
    action with 1 to `steps` steps left, the first of equally good actions.

    A robot on three cells in a row goes right or left, and gains 1 at the right end:

        >>> from jaxcell import examples, markov
        >>> value, policy = markov.finite_horizon(examples.line_model(), steps=3)
        >>> value[3].tolist(), policy[2].tolist()
        ([1.0, 2.0, 3.0], [0, 0, 0])
    """
    require_x64("finite_horizon")
    check_steps(steps)
    return _induced(model, steps)


@functools.partial(jax.jit, static_argnames="steps")
def _induced(
    model: DecisionModel, steps: int
) -> tuple[Float[Array, "{steps}+1 cells"], Int[Array, "{steps} cells"]]:
    def step(value, _):  # type: ignore[no-untyped-def]
        each = zip(model.reward, model.chains, strict=True)
        total = jnp.stack([gain + chain.pull(value) for gain, chain in each])
        total = jnp.where(model.allowed, total, -jnp.inf)
        best = jnp.max(total, axis=0)
        return best, (best, jnp.argmax(total, axis=0).astype(jnp.int32))

    start = start_loop(jnp.zeros(model.cells), model.reward, model.chains)
    _, (values, policy) = jax.lax.scan(step, start, length=steps)
    return jnp.concatenate([jnp.zeros((1, model.cells)), values]), policy


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Average(Pictured):
    """The largest reward per step in the long run, and a policy that attains it."""

    reward: Real
    bias: Float[Array, "cells"]
    "The sum of the later rewards above the average, relative to a cell that is often visited."
    policy: Int[Array, "cells"]
    certificate: Certificate
    "The certificate; its residual bounds the error of `reward`, relative to the largest reward."


def average_reward(model: DecisionModel, *, throw: bool = True) -> Average:
    """Find the policy with the largest average reward per step in the long run (Howard 1960).

    Each policy is evaluated exactly, by `h = r - reward + P h`, and improved where an action gains
    more. If an application of the best actions changes all biases `h` by `low` to `high`, the
    largest average is between `low` and `high` (Odoni 1969).

    **Arguments:** a model whose chains do not leave the space, and whose policies have one
    persistent group each. **Returns:** the average, biases and the best action of each cell. Only
    the average has derivatives.

    A robot on three cells in a row goes right or left, and gains 1 at the right end:

        >>> from jaxcell import examples, markov
        >>> best = markov.average_reward(examples.line_model())
        >>> round(best.reward, 6), best.policy.tolist()
        (1.0, [0, 0, 0])
    """
    require_x64("average_reward")
    form = like(float), like(float, model.cells), like(int, model.cells), *CERTIFIED
    given = model.chains, model.allowed, model.reward
    reward, bias, policy, rounds, residual = on_host(_best, form, *given)
    certificate = Certificate(rounds, residual, _TOLERANCE)
    certificate.check("average_reward", throw)
    if traced(model):
        taken = policy[None] == jnp.arange(model.actions, dtype=policy.dtype)[:, None]
        gain = jnp.where(taken, model.reward, 0.0).sum(axis=0)
        chain = policy_chain(model, policy)
        share = limiting_distribution(chain, throw=False).value
        reward = implicit(_change, reward, (share, gain))
    bias, policy = put_on_device((bias, policy))
    return Average(reward, bias, policy, certificate)


def _change(reward: Real, inputs: tuple[Array, Array]) -> Array:
    return inputs[0] @ inputs[1]


def _best(
    matrices: Sequence[scipy.sparse.csr_array],
    allowed: Usable,
    reward: Float[np.ndarray, "actions cells"],
) -> tuple[float, Float[np.ndarray, "cells"], Int[np.ndarray, "cells"], int, float]:
    moves, cell = Moves.of(matrices, allowed), np.arange(allowed.shape[1])
    if not moves.stays[moves.allowed].all():
        action, where = np.argwhere(moves.allowed & ~moves.stays)[0]
        raise ValueError(
            f"model: action {action} may leave the space from cell {where}, after which nothing is "
            "gained; stochastic_shortest_path and value_iteration serve such models"
        )
    policy = np.where(moves.allowed, reward, -np.inf).argmax(axis=0)
    largest = float(np.abs(reward[moves.allowed]).max(initial=0.0)) or 1.0
    rounds, better = 0, np.ones(policy.size, bool)
    while better.any() and rounds < _MAX_ROUNDS:
        rounds += 1
        average, bias = _evaluated(moves.of_policy(policy), reward[policy, cell])
        gain = np.where(moves.allowed, reward + moves.changes(bias)[0], -np.inf)
        size = largest + 2 * float(np.abs(bias).max())
        better = gain.max(axis=0) > gain[policy, cell] + _BETTER * size
        policy = np.where(better, gain.argmax(axis=0), policy)
    most, least = gain.max(axis=0).max(), gain.max(axis=0).min()
    rounding = (np.diff(moves.matrix.indptr).max() + 8) * _HALF_ULP * size
    residual = (max(most - average, average - least) + rounding) / largest
    return average, bias, policy.astype(np.int32), rounds, float(residual)


def _evaluated(
    step: scipy.sparse.csr_array, reward: Float[np.ndarray, "cells"]
) -> tuple[float, Float[np.ndarray, "cells"]]:
    """Return the average reward of a chain, and its biases."""
    group, count, _ = closed_classes(step)
    if count > 1:
        raise ValueError(
            f"model: a policy has {count} persistent groups, whose averages may differ; expected "
            "policies with one group"
        )
    share, inside = np.zeros(group.size), group == 0
    share[inside], *_ = solve_stationary(step[inside][:, inside], group[inside])
    average = float(share @ reward)
    others = np.arange(group.size) != share.argmax()
    bias = np.zeros(group.size)
    part = Transient.of(step, others)
    above = (reward - average)[others]
    bias[others] = solve_signed(lambda columns: part.expect(columns).value[:, :-1], above)
    return average, bias
