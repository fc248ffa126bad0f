"""Walks on a graph as tables of steps, for gradients in the logits of all of them."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...markov import dense
from ...optimize import Graph


# Of a step where a search begins: a gradient hardly moves logits of less likely ones.
_LIKELY = 1e-3


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
        return cls(*jax.device_put((image, even, back)))

    def logits(
        self, matrices: Float[np.ndarray, "*some cells cells"]
    ) -> Float[np.ndarray, "*some branches cells"]:
        """Logits of the steps of transition matrices, whose probability counts as 0.001 or more."""
        here, image = np.arange(self.image.shape[1]), np.asarray(self.image)
        return np.log(np.maximum(matrices[..., here, image], _LIKELY))

    def matrices(
        self, chance: Float[np.ndarray, "*some branches cells"]
    ) -> Float[np.ndarray, "*some cells cells"]:
        """The transition matrices of steps with such probabilities."""
        cells = chance.shape[-1]
        found = np.zeros((*chance.shape[:-2], cells, cells))
        places: Any = (..., np.arange(cells), np.asarray(self.image))
        np.add.at(found, places, chance)
        return found

    @jax.jit
    def chances(
        self, logits: Float[Array, "robots branches cells"], floor: float | Float[Array, ""]
    ) -> Float[Array, "robots branches cells"]:
        """The probability of each step, of which the floor is shared evenly."""
        even = self.even.astype(logits.dtype)
        even = (even / even.sum(axis=0, keepdims=True))[None]
        own = jax.nn.softmax(jnp.where(even > 0, logits, -jnp.inf), axis=1)
        return (1 - floor) * own + floor * even

    def pull(
        self, chance: Float[Array, "branches cells"], value: Float[Array, "cells targets"]
    ) -> Float[Array, "cells targets"]:
        """`P v` for several `v`."""
        return _pull(chance, value, self)

    def often(self, chance: Float[Array, "branches cells"]) -> Float[Array, "cells"]:
        """How much each cell counts as one where a robot may be: all alike."""
        return jnp.ones(chance.shape[1], chance.dtype)

    def share_of_time(self, chance: Float[Array, "branches cells"]) -> Float[Array, "cells"]:
        """The share of its time that a robot spends in each cell in the long run."""
        cells = chance.shape[1]
        matrix = jnp.zeros((cells, cells))
        here = jnp.broadcast_to(jnp.arange(cells), chance.shape)
        return dense.stationary(matrix.at[here, self.image].add(chance.astype(matrix.dtype)))


class ChargedSteps(NamedTuple):
    """The steps of a robot that must be at a charger every so many steps.

    Its cells are the vertices once for each number of steps since the charge, so that where it goes
    may depend on that.
    """

    near: Steps
    allowed: Bool[Array, "ages branches vertices"]
    "Which steps leave time to come to the charger."
    charger: Int[Array, ""]
    rare: Float[Array, ""]
    "Of the likeliest step: what is less likely is never made."

    @jax.jit
    def chances(
        self, logits: Float[Array, "robots branches cells"], floor: float | Float[Array, ""]
    ) -> Float[Array, "robots branches cells"]:
        """The probability of each step, without rare ones; there is no floor.

        Gradients are those with the rare ones, which may come back.
        """
        may = self.allowed.swapaxes(0, 1).reshape(1, *logits.shape[1:])
        own = jax.nn.softmax(jnp.where(may, logits, jnp.finfo(logits.dtype).min), axis=1)
        own = jnp.where(may, own, 0)
        most = own.max(axis=1, keepdims=True)
        made = jnp.where(own < self.rare.astype(own.dtype) * most, 0, own)
        made /= jnp.where(most > 0, made.sum(axis=1, keepdims=True), 1)
        return own + jax.lax.stop_gradient(made - own)

    def pull(
        self, chance: Float[Array, "branches cells"], value: Float[Array, "cells targets"]
    ) -> Float[Array, "cells targets"]:
        """`P v` for several `v`."""
        by_age = value.reshape(*self.allowed.shape[::2], -1)
        after = jnp.roll(by_age, -1, axis=0).at[:, self.charger].set(by_age[0, self.charger])
        return jax.vmap(lambda one, v: _pull(one, v, self.near))(
            self._by_age(chance), after
        ).reshape(value.shape)

    def often(self, chance: Float[Array, "branches cells"]) -> Float[Array, "cells"]:
        """How often a robot is in each cell between two charges."""
        begin = jnp.zeros(self.allowed.shape[2], chance.dtype).at[self.charger].set(1)

        def step(here, one):  # type: ignore[no-untyped-def]
            there = jnp.zeros_like(here).at[self.near.image].add(one * here[None])
            return there.at[self.charger].set(0), here

        return jax.lax.scan(step, begin, self._by_age(chance))[1].ravel()

    def share_of_time(self, chance: Float[Array, "branches cells"]) -> Float[Array, "cells"]:
        """The share of its time that a robot spends in each cell in the long run."""
        often = self.often(chance)
        return often / often.sum()

    def _by_age(
        self, chance: Float[Array, "branches cells"]
    ) -> Float[Array, "ages branches vertices"]:
        ages, branches, vertices = self.allowed.shape
        return chance.reshape(branches, ages, vertices).swapaxes(0, 1)


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
