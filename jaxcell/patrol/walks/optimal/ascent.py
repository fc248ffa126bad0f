"""Gradient ascent of the least probability of capture, in the logits of the steps of all robots."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from ..steps import ChargedSteps, Steps, SymmetricSteps


# Number of steps between evaluations of all targets; in between, this number of targets counts, the
# least captured ones.
_BLOCK, ALL_TARGETS = 25, 80
# Number of values that one step keeps for its gradient.
_KEPT = 5e7
# Learning rate of the logits.
_RATE = 0.1
# Least probability whose logarithm is taken.
_TINY = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class Ascent:
    """The ascent of the probability that robots see a target in time from where they are worst."""

    steps: Steps | ChargedSteps | SymmetricSteps
    unseen: Float[np.ndarray, "cells targets"]
    "1 where a target is out of view, else 0."
    attack_time: int
    floor: float
    "The least share of a step that goes to any neighbour with equal probability."
    hardness: tuple[float, float]
    "Hardness of the soft minimum of the logarithms of capture, at first and at the end."

    def climb(
        self, begin: Any, progress: Float[np.ndarray, "steps"], best: Any = None
    ) -> tuple[Any, float, Any, list[float]]:
        """Follow the gradient with Adam.

        **Arguments:**

        - `begin`: logits, array `[robots, branches, cells]`, or a state of the optimiser.
        - `progress`: the progress of each step, 0 to 1; the steps get shorter and the minimum
            harder.
        - `best`: the best logits so far.

        **Returns:** the best logits, their value, the last state, and the best value by block.
        """
        if not isinstance(begin, tuple):
            logits = np.asarray(begin, np.float32)
            none = np.zeros_like(logits)
            state = optax.ScaleByAdamState(np.zeros((), np.int32), none, none)
            begin = jax.device_put((logits, state))
        active = active_targets(self.unseen, self.attack_time, begin[0].shape[0])
        rate = _RATE * 0.5 * (1 + np.cos(np.pi * progress))
        soft, hard = self.hardness
        hardness = soft * (hard / soft) ** progress
        unseen, time = jax.device_put(self.unseen), self.attack_time
        best = begin[0] if best is None else best
        value, course = float(_least(best, self.steps, unseen, self.floor, time)[0]), []
        missed = _least(begin[0], self.steps, unseen, self.floor, time)[1]
        for first in range(0, progress.size, _BLOCK):
            weak = np.argsort(-np.asarray(missed))[:active]
            if isinstance(self.steps, SymmetricSteps):
                weak = np.arange(missed.size)
            block = slice(first, first + _BLOCK)
            schedule = rate[block].astype("f4"), hardness[block].astype("f4")
            begin = _follow(*begin, self.steps, self.unseen[:, weak], self.floor, schedule, time)
            now, missed = _least(begin[0], self.steps, unseen, self.floor, time)
            if float(now) > value:
                best, value = begin[0], float(now)
            course.append(value)
        return best, value, begin, course


def active_targets(
    unseen: Float[np.ndarray, "cells targets"], attack_time: int, robots: int
) -> int:
    """Choose the number of targets whose gradient is followed at a time, as memory allows."""
    cells, targets = unseen.shape
    kept = int(_KEPT / (cells * attack_time * robots))
    return min(targets, max(8, min(ALL_TARGETS, kept)))


def late_gain(course: list[float]) -> float:
    """Compute the share of the value that the last quarter of the blocks added."""
    if not course:
        return 0.0
    return max(0.0, 1 - course[-max(1, len(course) // 4)] / max(course[-1], _TINY))


def log_missed_from_worst(
    late: Float[Array, "cells targets"],
    weight: Float[Array, "cells targets"],
    hardness: Float[Array, ""] | None,
    tiny: float = _TINY,
) -> Float[Array, "targets"]:
    """Compute the logarithm of the probability that a robot misses attacks from its worst start.

    With a hardness, the worst start is a soft minimum of logarithms, because a probability that is
    a product of many would leave a gradient of almost 0.

    **Arguments:**

    - `late`: probability that the robot does not see the target in time, by its cell.
    - `weight`: weight of the cell as a start, 0 for none.
    - `tiny`: least probability whose logarithm is taken.
    """
    caught = jnp.where(weight > 0, jnp.maximum(1 - late, tiny), 1.0)
    if hardness is None:
        worst = jnp.min(caught, axis=0)
    else:
        soft = -hardness * jnp.log(caught)
        worst = jnp.exp(-jax.nn.logsumexp(soft, axis=0, b=weight) / hardness)
    # This form is exact for small probabilities.
    return jnp.log1p(-jnp.minimum(worst, 1 - 1e-6))


def soft_loss(
    missed: Float[Array, "targets"], hardness: Float[Array, ""] | float, tiny: float = _TINY
) -> Float[Array, ""]:
    """Compute minus a soft minimum over targets of the logarithm of the probability of capture.

    **Arguments:**

    - `missed`: logarithm of the probability that no robot captures.
    - `tiny`: least probability whose logarithm is taken.
    """
    caught = jnp.log(jnp.maximum(-jnp.expm1(missed), tiny))
    return jax.nn.logsumexp(-hardness * caught) / hardness


def _log_missed(
    logits: Float[Array, "robots branches cells"],
    steps: Steps | ChargedSteps | SymmetricSteps,
    unseen: Float[Array, "cells targets"],
    floor: float | Float[Array, ""],
    hardness: Float[Array, ""] | None,
    attack_time: int,
) -> Float[Array, "targets"]:
    total = jnp.zeros(unseen.shape[1], unseen.dtype)
    for chance in steps.chances(logits, floor):

        def step(value, _, chance=chance):  # type: ignore[no-untyped-def]
            return unseen * steps.pull(chance, value), None

        late, _ = jax.lax.scan(step, unseen, length=attack_time - 1)
        late = steps.pull(chance, late)
        weight = jnp.broadcast_to(steps.often(chance)[:, None], late.shape)
        total += log_missed_from_worst(late, weight, hardness)
    return total


@functools.partial(jax.jit, static_argnames="attack_time")
def _least(logits, steps, unseen, floor, attack_time):  # type: ignore[no-untyped-def]
    """Compute the least probability of capture, and the log-probability of none at each target."""
    missed = _log_missed(logits, steps, unseen, floor, None, attack_time)
    return -jnp.expm1(jnp.max(missed, initial=-jnp.inf)), missed


@functools.partial(jax.jit, static_argnames="attack_time")
def _follow(logits, moments, steps, unseen, floor, schedule, attack_time):  # type: ignore[no-untyped-def]
    """Make steps of Adam on the logits, for the soft minimum over the given targets."""
    adam = optax.scale_by_adam()

    def loss(logits, hardness):  # type: ignore[no-untyped-def]
        return soft_loss(_log_missed(logits, steps, unseen, floor, hardness, attack_time), hardness)

    def step(state, now):  # type: ignore[no-untyped-def]
        logits, moments = state
        rate, hardness = now
        change, moments = adam.update(jax.grad(loss)(logits, hardness), moments)
        return (logits - rate * change, moments), None

    with jax.numpy_dtype_promotion("standard"):
        return jax.lax.scan(step, (logits, moments), schedule)[0]
