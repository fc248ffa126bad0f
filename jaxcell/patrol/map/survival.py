import functools

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from ...markov import dense
from ..walks.steps import Steps, chances, pull


def _missed(
    logits: Float[Array, "robots branches cells"],
    steps: Steps,
    unseen: Float[Array, "cells targets"],
    floor: float | Float[Array, ""],
    hardness: Float[Array, ""] | None,
    attack_time: int,
    start: str,
) -> Float[Array, "targets"]:
    """The logarithm of the probability that no robot captures.

    With a hardness, the worst start is a soft maximum.
    """
    total = jnp.zeros(unseen.shape[1], unseen.dtype)
    for chance in chances(logits, steps, floor):

        def step(value, _, chance=chance):  # type: ignore[no-untyped-def]
            return unseen * pull(chance, value, steps), None

        late, _ = jax.lax.scan(step, unseen, length=attack_time)
        if start == "worst":
            missed = jnp.max(late, axis=0)
            if hardness is not None:
                missed = jnp.sum(jax.nn.softmax(2 * hardness * late, axis=0) * late, axis=0)
        else:
            share = unseen
            if start == "stationary":
                share = unseen * _share_of_time(chance, steps).astype(unseen.dtype)[:, None]
            missed = jnp.sum(share * late, axis=0) / jnp.sum(share, axis=0)
        total += jnp.log(missed + 1e-30)
    return total


def _share_of_time(chance: Float[Array, "branches cells"], steps: Steps) -> Float[Array, "cells"]:
    cells = chance.shape[1]
    matrix = jnp.zeros((cells, cells))
    here = jnp.broadcast_to(jnp.arange(cells), chance.shape)
    return dense.stationary(matrix.at[here, steps.image].add(chance.astype(matrix.dtype)))


@functools.partial(jax.jit, static_argnames=("attack_time", "start"))
def least(logits, steps, unseen, floor, attack_time, start):  # type: ignore[no-untyped-def]
    """The least probability of capture, and the probability of none at each target."""
    missed = jnp.exp(_missed(logits, steps, unseen, floor, None, attack_time, start))
    return 1 - jnp.max(missed, initial=0.0), missed


@functools.partial(jax.jit, static_argnames=("attack_time", "start"))
def follow(logits, moments, steps, unseen, floor, schedule, attack_time, start):  # type: ignore[no-untyped-def]
    """Some steps of Adam on the logits, for the soft minimum over some targets."""
    adam = optax.scale_by_adam()

    def loss(logits, hardness):  # type: ignore[no-untyped-def]
        missed = _missed(logits, steps, unseen, floor, hardness, attack_time, start)
        caught = jnp.log(-jnp.expm1(missed) + 1e-9)
        return jax.nn.logsumexp(-hardness * caught) / hardness

    def step(state, now):  # type: ignore[no-untyped-def]
        logits, moments = state
        rate, hardness = now
        change, moments = adam.update(jax.grad(loss)(logits, hardness), moments)
        return (logits - rate * change, moments), None

    with jax.numpy_dtype_promotion("standard"):
        return jax.lax.scan(step, (logits, moments), schedule)[0]
