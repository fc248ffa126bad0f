import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..steps import ChargedSteps, Steps, SymmetricSteps


# Number of steps between evaluations of all targets, and the largest number of targets, those with
# the least capture, that count in between.
_BLOCK, ALL_TARGETS = 25, 80
# Largest number of values that one step keeps for its gradient.
_KEPT = 5e7
# Learning rate of the logits at the start.
_RATE = 0.1
# Least probability whose logarithm is taken.
_TINY = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class Ascent:
    """The gradient ascent of the least probability of capture over the logits of steps."""

    steps: Steps | ChargedSteps | SymmetricSteps
    unseen: Float[np.ndarray, "cells targets"]
    "1 for each cell from which a robot does not see the target, otherwise 0."
    attack_time: int
    floor: float
    "The least share of steps in which a robot goes to a uniformly random neighbour."
    hardness: tuple[float, float]
    "Inverse temperature of the soft minimum of log-capture, at the start and at the end."

    def climb(
        self, logits: Float[np.ndarray, "robots branches cells"], count: int
    ) -> tuple[Any, float, list[float]]:
        """Follow the gradient with `count` steps of Adam, while the hardness rises.

        **Returns:** the best logits, their value, and the best value per block of steps.
        """
        now = begin(np.asarray(logits, np.float32))
        best = now[0]
        active = active_targets(self.unseen, self.attack_time, len(logits))
        soft, hard = self.hardness
        hardness = (soft * (hard / soft) ** (np.arange(count) / count)).astype("f4")
        rest = self.steps, jax.device_put(self.unseen), self.floor, self.attack_time
        least, missed = _least(best, *rest)
        value, course = float(least), []
        for first in range(0, count, _BLOCK):
            weak = np.argsort(-np.asarray(missed))[:active]
            if isinstance(self.steps, SymmetricSteps):
                weak = np.arange(missed.size)
            targeted = self.steps, self.unseen[:, weak], self.floor, self.attack_time
            now = _follow(now, hardness[first : first + _BLOCK], count, *targeted)
            least, missed = _least(now[0], *rest)
            if float(least) > value:
                best, value = now[0], float(least)
            course.append(value)
        return best, value, course


def begin(logits: Float[np.ndarray, "robots branches cells"]) -> tuple[Any, Any]:
    """Return the state in which [`follow`][] begins."""
    # All moments are 0 at the start.
    moments = jax.eval_shape(_adam(1).init, logits)
    zeros = jax.tree.map(lambda part: np.zeros(part.shape, part.dtype), moments)
    return jax.device_put((logits, zeros))


def follow(
    loss: Callable[[Any, Any], Array],
    now: tuple[Any, Any],
    hardness: Float[Array, "steps"],
    count: int,
    scale: float = 1e-8,
) -> tuple[Any, Any]:
    """Take one step of Adam on the logits for each hardness, the second argument of `loss`.

    The learning rate falls to 0 in `count` steps, and `scale` is the epsilon of Adam. **Returns:**
    the new state `now`, the logits and the moments of Adam.
    """
    adam = _adam(count, scale)

    def step(now, hardness):  # type: ignore[no-untyped-def]
        logits, moments = now
        change, moments = adam.update(jax.grad(loss)(logits, hardness), moments)
        return (logits + change, moments), None

    with jax.numpy_dtype_promotion("standard"):
        return jax.lax.scan(step, now, hardness)[0]


def _adam(count: int, scale: float = 1e-8) -> Any:
    # The import of optax takes longer than many commands.
    import optax

    return optax.adam(optax.cosine_decay_schedule(_RATE, count), eps=scale)


def active_targets(
    unseen: Float[np.ndarray, "cells targets"], attack_time: int, robots: int
) -> int:
    """Choose the number of targets in one gradient step according to the free memory."""
    cells, targets = unseen.shape
    kept = int(_KEPT / (cells * attack_time * robots))
    return min(targets, max(8, min(ALL_TARGETS, kept)))


def late_gain(course: list[float]) -> float:
    """Compute the gain in the last quarter of the values `course`, relative to the last value."""
    if not course:
        return 0.0
    return max(0.0, 1 - course[-max(1, len(course) // 4)] / max(course[-1], _TINY))


def log_missed_from_worst(
    late: Float[Array, "cells targets"],
    weight: Float[Array, "cells targets"],
    hardness: Float[Array, ""] | None,
    tiny: float = _TINY,
) -> Float[Array, "targets"]:
    """Compute the log-probability that a robot from its worst start misses each target.

    `late` is the probability of a miss from each cell, `weight` its weight as a start, and `tiny`
    the least capture that counts. With a hardness, an inverse temperature, the minimum of capture
    over starts is a soft minimum of logarithms, because the gradient of a product of many
    probabilities is almost 0.
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
    """Compute the negative soft minimum, over the targets, of the log-probability of capture.

    `missed` contains the log-probabilities that all robots miss a target."""
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
    missed = _log_missed(logits, steps, unseen, floor, None, attack_time)
    return -jnp.expm1(jnp.max(missed, initial=-jnp.inf)), missed


@functools.partial(jax.jit, static_argnames=("count", "attack_time"))
def _follow(now, hardness, count, steps, unseen, floor, attack_time):  # type: ignore[no-untyped-def]
    def loss(logits, hardness):  # type: ignore[no-untyped-def]
        return soft_loss(_log_missed(logits, steps, unseen, floor, hardness, attack_time), hardness)

    return follow(loss, now, hardness, count)
