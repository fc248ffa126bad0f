import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from ...markov import dense
from ...optimize import Graph


class Steps(NamedTuple):
    """The steps from each cell to its neighbours, slot by slot."""

    image: Int[Array, "branches cells"]
    "Where each leads; to the cell itself where there are fewer neighbours than slots."
    even: Float[Array, "branches cells"]
    "The chance of each if all are alike; 0 where there is none."
    back: Int[Array, "branches cells"]
    "The slot of the neighbour that leads back."

    @classmethod
    def of(cls, graph: Graph) -> "Steps":
        cells = graph.vertices
        steps = np.concatenate([graph.edges, graph.edges[:, ::-1]]).astype(np.int64)
        tail, head = steps[np.lexsort((steps[:, 1], steps[:, 0]))].T
        degree = np.bincount(tail, minlength=cells)
        slot = np.arange(tail.size) - np.repeat(np.cumsum(degree) - degree, degree)
        image = np.tile(np.arange(cells, dtype=np.int32), (degree.max(), 1))
        even, back = np.zeros(image.shape, np.float32), np.zeros(image.shape, np.int32)
        image[slot, tail] = head
        even[slot, tail] = 1 / degree[tail]
        back[slot, tail] = slot[np.searchsorted(tail * cells + head, head * cells + tail)]
        return cls(jnp.asarray(image), jnp.asarray(even), jnp.asarray(back))


def chances(
    logits: Float[Array, "robots branches cells"],
    steps: Steps,
    floor: float | Float[Array, ""],
) -> Float[Array, "robots branches cells"]:
    even = steps.even.astype(logits.dtype)
    even = (even / even.sum(axis=0, keepdims=True))[None]
    own = jax.nn.softmax(jnp.where(even > 0, logits, -jnp.inf), axis=1)
    return (1 - floor) * own + floor * even


@jax.custom_vjp
def _pull(
    chance: Float[Array, "branches cells"], value: Float[Array, "cells targets"], steps: Steps
) -> Float[Array, "cells targets"]:
    """`P v` for several `v`. Every step has one back, so that its derivative gathers too.

    The transpose that JAX finds by itself scatters, which takes several times as long.
    """
    return sum(p[:, None] * value[to] for p, to in zip(chance, steps.image, strict=True))


def _pull_forward(chance, value, steps):  # type: ignore[no-untyped-def]
    return _pull(chance, value, steps), (chance, value, steps)


def _pull_backward(kept, force):  # type: ignore[no-untyped-def]
    chance, value, steps = kept
    into = jnp.where(steps.even > 0, chance[steps.back, steps.image], 0)
    along = jnp.stack([jnp.sum(force * value[to], axis=1) for to in steps.image])
    return along, _pull(into, force, steps), None


_pull.defvjp(_pull_forward, _pull_backward)


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
            return unseen * _pull(chance, value, steps), None

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
