"""Gradient ascent of the probability of capture, with exact shares of time in each iteration."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import scipy.sparse.csgraph
import scipy.sparse.linalg
from jaxtyping import Array, Float, Int

from ...optimize import Graph
from ..walks.optimal.ascent import active_targets, log_missed_from_worst, soft_loss
from ..walks.steps import Steps


# The share of time of excursions in an average cell, and their largest share of time in total.
_VISITED, _MOST_EXCURSIONS = 1e-5, 0.1
# The conductance of excursions in the farthest cell, relative to cells that are often visited.
_FARTHEST = 0.2
# Number of steps between evaluations of targets, and the number of targets of an evaluation.
_BLOCK, _EVALUATED = 10, 400
# Learning rate of the logits, and the epsilon of Adam, which is so large that noise does not change
# the logits of cells that are hardly visited.
_RATE, _SCALE = 0.1, 1e-7
# Hardness of the soft minimum of the logarithms of capture, at the start and at the end.
_SOFT, _HARD = 10.0, 100.0
# Least probability whose logarithm is taken.
_TINY = 1e-9

Logits = Float[np.ndarray, "robots branches cells"]


@dataclasses.dataclass(frozen=True, eq=False)
class Circulation:
    """The walk of one robot as a mixture of two flows that enter and leave each cell equally often.

    The first flow is the flow of a walk with trained steps, the second the flow of a reversible
    walk, the *excursions*. No commute time in the mixture exceeds the commute time of the
    excursions divided by their share of the time, because additional flow never makes commute times
    longer (Rayleigh's principle, which holds for the symmetric part of any walk).
    """

    chance: Float[np.ndarray, "branches cells"]
    share: Float[np.ndarray, "cells"]
    "The share of time in each cell in the long run."


@dataclasses.dataclass(frozen=True, eq=False)
class Trained(Circulation):
    """The trained walk of a robot, with a solver for the linear system of its shares of time."""

    pivot: int
    rest: Int[np.ndarray, "others"]
    solver: Any

    @classmethod
    def of(cls, image: Int[np.ndarray, "branches cells"], chance: Any, pivot: int) -> "Trained":
        """Solve for the shares of time of a walk, given the probability `chance` of each step to
        `image`, and a cell `pivot` that the walk visits often."""
        branches, cells = image.shape
        here = np.tile(np.arange(cells), branches)
        walk = scipy.sparse.csr_array((chance.ravel(), (here, image.ravel())), (cells, cells))
        rest = np.delete(np.arange(cells), pivot)
        system = (scipy.sparse.eye_array(cells - 1) - walk[rest][:, rest]).tocsc()
        options = {"SymmetricMode": True}
        solver = scipy.sparse.linalg.splu(
            system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
        )
        share = np.ones(cells)
        share[rest] = solver.solve(walk[[pivot]].toarray()[0, rest], trans="T")
        share = np.maximum(share, 0)
        return cls(chance, share / share.sum(), pivot, rest, solver)

    def gradient(self, of_share: Float[np.ndarray, "cells"]) -> Float[np.ndarray, "cells"]:
        """Turn derivatives with respect to shares of time into those with respect to visits."""
        by = of_share - self.share @ of_share
        worth = np.zeros(self.share.size)
        worth[self.rest] = self.solver.solve(by[self.rest])
        return worth


@dataclasses.dataclass(frozen=True, eq=False)
class CirculationAscent:
    """The gradient ascent of the least probability of capture over the targets."""

    graph: Graph
    steps: Steps
    unseen: Float[np.ndarray, "cells targets"]
    "1 for each cell from which a robot does not see the target, otherwise 0."
    attack_time: int
    start: str
    "The places of robots when the attack begins: `uniform`, `stationary` or `worst`."
    floor: float
    "The least share of trained steps in which a robot goes to a uniformly random neighbour."

    def climb(
        self,
        logits: Logits,
        count: int,
        work: str = "",
        say: Callable[[str, int, int], None] | None = None,
    ) -> tuple[Logits, list[Circulation], list[float]]:
        """Follow the gradient with `count` steps of Adam; `say` reports the progress of `work`.

        **Returns:** the last logits, the walks, and the least capture after every `_BLOCK` steps.
        """
        image, robots = np.asarray(self.steps.image), len(logits)
        active = active_targets(self.unseen, self.attack_time, robots)
        unseen = jax.device_put(self.unseen.astype(np.float32))
        parts = max(1, -(-unseen.shape[1] // _EVALUATED))
        missed, course = np.zeros(unseen.shape[1]), []
        adam = optax.scale_by_adam(eps=_SCALE)
        moments = adam.init(logits)
        pivots = [0] * robots
        fixed = {"attack_time": self.attack_time, "start": self.start}
        for step, now in enumerate(np.arange(count) / max(1, count)):
            trained = self._trained(logits, pivots)
            pivots = [int(np.argmax(walk.share)) for walk in trained]
            if step % _BLOCK == 0:
                if say is not None:
                    say(work, step, count)
                excursions = [self._excursions(walk.share) for walk in trained]
                mixed = [np.stack(part) for part in zip(*excursions, strict=True)]
                flows = jax.device_put([part.astype(np.float32) for part in mixed])
                block = step // _BLOCK
                for part in range(parts) if block == 0 else [block % parts]:
                    targets = unseen[:, part::parts], self.steps, None
                    missed[part::parts] = _log_missed(*_stacked(trained), *flows, *targets, **fixed)
                course.append(float(-np.expm1(missed.max(initial=-np.inf))))
                targeted = unseen[:, _weakest(missed, active)]
            hardness = _SOFT * (_HARD / _SOFT) ** now
            by_chance, by_share = _gradient(
                *_stacked(trained), *flows, targeted, self.steps, np.float32(hardness), **fixed
            )
            slope = np.asarray(by_chance, float)
            for robot, walk in enumerate(trained):
                worth = walk.gradient(np.asarray(by_share[robot], float))
                slope[robot] += walk.share * worth[image]
                own = (walk.chance - self.floor * self._even) / (1 - self.floor)
                slope[robot] -= (own * slope[robot]).sum(axis=0)
                slope[robot] *= (1 - self.floor) * own
            with jax.numpy_dtype_promotion("standard"):
                change, moments = adam.update(slope, moments)
            logits = logits - _RATE * 0.5 * (1 + np.cos(np.pi * now)) * np.asarray(change)
        walks = []
        for walk in self._trained(logits, pivots):
            share, chance = self._excursions(walk.share)
            total = (1 - self._part) * walk.share + share
            mixed = ((1 - self._part) * walk.share * walk.chance + share * chance) / total
            walks.append(Circulation(mixed / mixed.sum(axis=0), total / total.sum()))
        return logits, walks, course

    @functools.cached_property
    def _even(self) -> Float[np.ndarray, "branches cells"]:
        even = np.asarray(self.steps.even, float)
        return even / even.sum(axis=0)

    @functools.cached_property
    def _part(self) -> float:
        return min(_MOST_EXCURSIONS, _VISITED * self.graph.vertices)

    def _trained(self, logits: Logits, pivots: list[int]) -> list[Trained]:
        chance = np.exp(logits - logits.max(axis=1, keepdims=True)) * (self._even > 0)
        chance /= chance.sum(axis=1, keepdims=True)
        chance = (1 - self.floor) * chance + self.floor * self._even
        image = np.asarray(self.steps.image)
        return [Trained.of(image, *each) for each in zip(chance, pivots, strict=True)]

    def _excursions(
        self, share: Float[np.ndarray, "cells"]
    ) -> tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "branches cells"]]:
        """Build the reversible walk of the excursions, which visit all cells.

        The conductance of an edge falls with its distance from the cells with a large `share` of
        the time, so that excursions drift back to these cells. Returns the share of time that
        excursions spend in each cell, and the probability of each of their steps.
        """
        image, conductance = np.asarray(self.steps.image), (self._even > 0).astype(float)
        often = np.flatnonzero(share >= 1 / share.size)
        near = self.graph.matrix(np.ones(len(self.graph.edges)))
        far = scipy.sparse.csgraph.dijkstra(near, unweighted=True, indices=often, min_only=True)
        fall = np.log(_FARTHEST) / max(1.0, float(far.max()))
        # No step may be less probable than the floor allows.
        fall = max(fall, np.log(max(self.floor, 1e-9)) if self.floor else fall)
        conductance *= np.exp(fall * (far + far[image]) / 2)
        total = conductance.sum(axis=0)
        return self._part * total / total.sum(), conductance / total


def _weakest(missed: Float[np.ndarray, "targets"], count: int) -> Int[np.ndarray, "weakest"]:
    """Choose the `count` targets missed most, at least one in each of `count // 4` index ranges."""
    targets = np.arange(missed.size)
    if count >= missed.size:
        return targets
    weak = np.argsort(-missed, kind="stable")
    parts = np.array_split(targets, max(1, count // 4))
    local = np.array([part[np.argmax(missed[part])] for part in parts])
    chosen = np.zeros(missed.size, bool)
    chosen[local] = True
    chosen[weak[~chosen[weak]][: count - np.count_nonzero(chosen)]] = True
    return np.flatnonzero(chosen)


def _stacked(walks: Sequence[Circulation]) -> list[np.ndarray]:
    return [
        np.stack([getattr(walk, name) for walk in walks]).astype(np.float32)
        for name in ("chance", "share")
    ]


@functools.partial(jax.jit, static_argnames=("attack_time", "start"))
def _log_missed(
    chance: Float[Array, "robots branches cells"],
    share: Float[Array, "robots cells"],
    excursion_share: Float[Array, "robots cells"],
    excursion_chance: Float[Array, "robots branches cells"],
    unseen: Float[Array, "cells targets"],
    steps: Steps,
    hardness: Float[Array, ""] | None,
    attack_time: int,
    start: str,
) -> Float[Array, "targets"]:
    logarithm = jnp.zeros(unseen.shape[1], unseen.dtype)
    flows = chance, share, excursion_share, excursion_chance
    for trained, often, rare, excursion in zip(*flows, strict=True):
        total = (1 - rare.sum()) * often + rare
        mixed = (1 - rare.sum()) * often[None] * trained + rare[None] * excursion
        mixed = mixed / total[None]

        def step(value, _, mixed=mixed):  # type: ignore[no-untyped-def]
            return unseen * steps.pull(mixed, value), None

        late, _ = jax.lax.scan(step, unseen, length=attack_time)
        if start == "worst":
            logarithm += log_missed_from_worst(late, unseen, hardness, _TINY)
        else:
            begin = unseen * total[:, None] if start == "stationary" else unseen
            missed = jnp.sum(begin * late, axis=0) / jnp.maximum(jnp.sum(begin, axis=0), 1e-30)
            logarithm += jnp.log(missed + 1e-30)
    return logarithm


@functools.partial(jax.jit, static_argnames=("attack_time", "start"))
def _gradient(chance, share, *rest, attack_time, start):  # type: ignore[no-untyped-def]
    hardness = rest[-1]

    def loss(chance, share):  # type: ignore[no-untyped-def]
        missed = _log_missed(chance, share, *rest, attack_time=attack_time, start=start)
        return soft_loss(missed, hardness, _TINY)

    return jax.grad(loss, argnums=(0, 1))(chance, share)
