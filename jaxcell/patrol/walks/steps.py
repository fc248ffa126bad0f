"""Walks on a graph as tables of steps, for gradients in the logits of all of them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

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
def pull(
    chance: Float[Array, "branches cells"], value: Float[Array, "cells targets"], steps: Steps
) -> Float[Array, "cells targets"]:
    """`P v` for several `v`. Every step has one back, so that its derivative gathers too.

    The transpose that JAX finds by itself scatters, which takes several times as long.
    """
    return sum(p[:, None] * value[to] for p, to in zip(chance, steps.image, strict=True))


def _pull_forward(chance, value, steps):  # type: ignore[no-untyped-def]
    return pull(chance, value, steps), (chance, value, steps)


def _pull_backward(kept, force):  # type: ignore[no-untyped-def]
    chance, value, steps = kept
    into = jnp.where(steps.even > 0, chance[steps.back, steps.image], 0)
    along = jnp.stack([jnp.sum(force * value[to], axis=1) for to in steps.image])
    return along, pull(into, force, steps), None


pull.defvjp(_pull_forward, _pull_backward)
