"""Walks on a graph as tables of steps, for gradients with respect to the logits of all steps."""

from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...optimize import Graph
from ...space.copies import copies


# Least probability of a step where an ascent starts: gradients hardly change rarer steps.
_LIKELY = 1e-3


_TeamSteps: TypeAlias = Float[Array, "robots branches cells"]
_Chance: TypeAlias = Float[Array, "branches cells"]
_Values: TypeAlias = Float[Array, "cells targets"]


class Steps(NamedTuple):
    """The steps from each cell to its neighbours, with one slot per neighbour."""

    image: Int[Array, "branches cells"]
    "The cell to which each step leads; in slots without a neighbour, the cell itself."
    even: _Chance
    "The probability of each step if all are equally likely; 0 in slots without a neighbour."
    back: Int[Array, "branches cells"]
    "For each step, the slot of the step back, among the steps from the neighbour."

    @classmethod
    def of(cls, graph: Graph) -> "Steps":
        cells = graph.vertices
        steps = np.concatenate([graph.edges, graph.edges[:, ::-1]]).astype(np.int64)
        tail, head = steps[np.lexsort((steps[:, 1], steps[:, 0]))].T
        degree = np.bincount(tail, minlength=cells)
        _, slot = copies(degree)
        image = np.tile(np.arange(cells, dtype=np.int32), (degree.max(), 1))
        even, back = np.zeros(image.shape, np.float32), np.zeros(image.shape, np.int32)
        image[slot, tail] = head
        even[slot, tail] = 1 / degree[tail]
        back[slot, tail] = slot[np.searchsorted(tail * cells + head, head * cells + tail)]
        return cls(*jax.device_put((image, even, back)))

    def logits(
        self, matrices: Float[np.ndarray, "*batch cells states"]
    ) -> Float[np.ndarray, "*batch branches cells"]:
        """Compute the logits of transition matrices; probabilities below 0.001 count as 0.001."""
        here, image = np.arange(self.image.shape[1]), np.asarray(self.image)
        return np.log(np.maximum(matrices[..., here, image], _LIKELY))

    def matrices(
        self, chance: Float[np.ndarray, "*batch branches cells"]
    ) -> Float[np.ndarray, "*batch cells cells"]:
        """Build transition matrices from the probabilities of steps."""
        cells = chance.shape[-1]
        matrices = np.zeros((*chance.shape[:-2], cells, cells))
        places: Any = (..., np.arange(cells), np.asarray(self.image))
        np.add.at(matrices, places, chance)
        return matrices

    @jax.jit
    def chances(self, logits: _TeamSteps, floor: float | Float[Array, ""]) -> _TeamSteps:
        """Compute the probability of each step, with a share `floor` of equally likely steps."""
        even = self.even.astype(logits.dtype)
        even = (even / even.sum(axis=0, keepdims=True))[None]
        own = jax.nn.softmax(jnp.where(even > 0, logits, -jnp.inf), axis=1)
        return (1 - floor) * own + floor * even

    def pull(self, chance: _Chance, value: _Values) -> _Values:
        """Compute the products `P v` of the transition matrix and several vectors.

        Because every step has a step back, the derivative can gather values. JAX's own derivative
        scatters values, which takes several times as long.
        """
        return _pull(chance, value, self)

    def often(self, chance: _Chance) -> Float[Array, "cells"]:
        """Return the weight of each cell as a start in `log_missed_from_worst`; here 1 for all."""
        return jnp.ones(chance.shape[1], chance.dtype)


class SymmetricSteps(NamedTuple):
    """The steps of a robot with memory that acts in the same way in all symmetric positions.

    A state of the memory is a pair (frame, number), and each step may change both. The *frame* is
    the symmetry of the graph through which the robot sees the graph; frame 0 is the identity. The
    *cells* are the pairs of a number and a vertex in frame 0. The steps in other frames follow by
    symmetry.
    """

    own: Steps
    """The steps from each cell, in frame 0, to states: a frame, a number and a neighbouring vertex.
    In the index of a state the frame varies slowest, and the vertex fastest."""
    frames: Int[Array, "frames vertices"]
    "The image of each vertex in each frame; the frames are a group of permutations."

    @classmethod
    def of(cls, graph: Graph, frames: Int[np.ndarray, "frames vertices"]) -> "SymmetricSteps":
        """Build the steps from a graph whose vertices are pairs of a memory state and a vertex."""
        cells = graph.vertices // len(frames)
        own = Steps(*(part[:, :cells] for part in Steps.of(graph)))
        return cls(own, jax.device_put(frames))

    def logits(
        self, matrices: Float[np.ndarray, "robots states states"]
    ) -> Float[np.ndarray, "robots branches cells"]:
        """Compute the logits of the transition matrices of the first frame."""
        return self.own.logits(matrices[:, : self.own.image.shape[1]])

    def matrices(
        self, chance: Float[np.ndarray, "robots branches cells"]
    ) -> Float[np.ndarray, "robots states states"]:
        """Build the transition matrices of all frames from the probabilities in frame 0."""
        frames = np.asarray(self.frames)
        count, vertices = frames.shape
        own = np.asarray(self._dense(chance))
        own = own.reshape(len(own), -1, vertices, count, own.shape[1] // vertices, vertices)
        place = {frame.tobytes(): i for i, frame in enumerate(frames)}
        whole = np.zeros((count, *own.shape))
        for frame, rows in zip(frames, whole, strict=True):
            after = [place[step[frame].tobytes()] for step in frames]
            rows[:, :, :, after] = own[:, :, frame][..., frame]
        states = count * own.shape[1] * vertices
        return whole.swapaxes(0, 1).reshape(len(own), states, states)

    @jax.jit
    def chances(self, logits: _TeamSteps, floor: float | Float[Array, ""]) -> _TeamSteps:
        return self.own.chances(logits, floor)

    def pull(self, chance: _Chance, value: _Values) -> _Values:
        by_number = value.reshape(-1, *self.frames.shape[1:], value.shape[1])
        whole = jnp.concatenate([by_number[:, frame][..., frame] for frame in self.frames])
        return self._dense(chance[None])[0] @ whole.reshape(-1, value.shape[1])

    def often(self, chance: _Chance) -> Float[Array, "cells"]:
        return self.own.often(chance)

    def _dense(self, chance: Any) -> Float[Array, "robots cells states"]:
        cells = chance.shape[2]
        empty = jnp.zeros((len(chance), cells, cells * len(self.frames)), chance.dtype)
        return empty.at[:, jnp.arange(cells), self.own.image].add(chance)


class ChargedSteps(NamedTuple):
    """The steps of a robot that must return to a charger within a given number of steps.

    The cells are pairs of a vertex and the number of steps since the last charge.
    """

    near: Steps
    allowed: Bool[Array, "ages branches vertices"]
    "The steps that leave time to return to the charger."
    charger: Int[Array, ""]
    rare: Float[Array, ""]
    "Steps with less than this fraction of the largest probability are never made."

    @jax.jit
    def chances(self, logits: _TeamSteps, floor: float | Float[Array, ""]) -> _TeamSteps:
        """Compute the probability of each step, 0 for rare steps; the floor is ignored.

        Gradients include the rare steps, so that a rare step can become more likely again.
        """
        may = self.allowed.swapaxes(0, 1).reshape(1, *logits.shape[1:])
        own = jax.nn.softmax(jnp.where(may, logits, jnp.finfo(logits.dtype).min), axis=1)
        own = jnp.where(may, own, 0)
        most = own.max(axis=1, keepdims=True)
        made = jnp.where(own < self.rare.astype(own.dtype) * most, 0, own)
        made /= jnp.where(most > 0, made.sum(axis=1, keepdims=True), 1)
        return own + jax.lax.stop_gradient(made - own)

    def pull(self, chance: _Chance, value: _Values) -> _Values:
        by_age = value.reshape(*self.allowed.shape[::2], -1)
        after = jnp.roll(by_age, -1, axis=0).at[:, self.charger].set(by_age[0, self.charger])
        return jax.vmap(lambda steps, v: _pull(steps, v, self.near))(
            self._by_age(chance), after
        ).reshape(value.shape)

    def often(self, chance: _Chance) -> Float[Array, "cells"]:
        """Compute the expected number of visits of a robot to each cell between two charges."""
        begin = jnp.zeros(self.allowed.shape[2], chance.dtype).at[self.charger].set(1)

        def step(here, chance):  # type: ignore[no-untyped-def]
            there = jnp.zeros_like(here).at[self.near.image].add(chance * here[None])
            return there.at[self.charger].set(0), here

        return jax.lax.scan(step, begin, self._by_age(chance))[1].ravel()

    def _by_age(self, chance: _Chance) -> Float[Array, "ages branches vertices"]:
        ages, branches, vertices = self.allowed.shape
        return chance.reshape(branches, ages, vertices).swapaxes(0, 1)


@jax.custom_vjp
def _pull(chance: _Chance, value: _Values, steps: Steps) -> _Values:
    return sum(p[:, None] * value[to] for p, to in zip(chance, steps.image, strict=True))


def _pull_forward(chance, value, steps):  # type: ignore[no-untyped-def]
    return _pull(chance, value, steps), (chance, value, steps)


def _pull_backward(kept, force):  # type: ignore[no-untyped-def]
    chance, value, steps = kept
    into = jnp.where(steps.even > 0, chance[steps.back, steps.image], 0)
    along = jnp.stack([jnp.sum(force * value[to], axis=1) for to in steps.image])
    return along, _pull(into, force, steps), None


_pull.defvjp(_pull_forward, _pull_backward)
