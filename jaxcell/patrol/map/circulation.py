"""Gradient ascent of the probability of capture, with exact shares of time in each iteration."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.csgraph
import scipy.sparse.linalg
from jaxtyping import Array, Float, Int

from ...optimize import Graph
from ..walks.optimal.ascent import (
    active_targets,
    begin,
    follow,
    log_missed_from_worst,
    soft_loss,
)
from ..walks.steps import Steps


# The share of time of excursions in an average cell, and their largest share of time in total.
_VISITED, _MOST_EXCURSIONS = 1e-5, 0.1
# The conductance of excursions in the farthest cell, relative to cells that are often visited.
_FARTHEST = 0.2
# Number of steps between evaluations of targets, and the number of targets of an evaluation.
_BLOCK, _EVALUATED = 10, 400
# The epsilon of Adam, which is so large that noise does not change the logits of cells that are
# hardly visited.
_SCALE = 1e-7
# Number of factorizations that are kept, for systems and their transposes.
_FACTORS = 16
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
        active = active_targets(self.unseen, self.attack_time, len(logits))
        unseen = jax.device_put(self.unseen.astype(np.float32))
        parts = max(1, -(-unseen.shape[1] // _EVALUATED))
        missed, course = np.zeros(unseen.shape[1]), []
        now, pivots = begin(logits), np.zeros(len(logits), int)
        hardness = _SOFT * (_HARD / _SOFT) ** (np.arange(count) / max(1, count))
        fixed = {"attack_time": self.attack_time, "start": self.start}
        for block, first in enumerate(range(0, count, _BLOCK)):
            if say is not None:
                say(work, first, count)
            flows = self._flows(now[0], pivots)
            pivots = flows[1].argmax(axis=1)
            for part in range(parts) if block == 0 else [block % parts]:
                targets = unseen[:, part::parts], self.steps, None
                missed[part::parts] = _log_missed(*flows, *targets, **fixed)
            course.append(float(-np.expm1(missed.max(initial=-np.inf))))
            rest = flows[2:], unseen[:, _weakest(missed, active)], self.steps, self.floor
            harder = hardness[first : first + _BLOCK].astype("f4")
            now = _follow(now, harder, count, pivots, *rest, **fixed)
        walks = []
        for chance, often, rare, excursion in zip(*self._flows(now[0], pivots), strict=True):
            total = (1 - self._part) * often + rare
            mixed = ((1 - self._part) * often * chance + rare * excursion) / total
            walks.append(Circulation(mixed / mixed.sum(axis=0), total / total.sum()))
        return np.asarray(now[0]), walks, course

    @functools.cached_property
    def _part(self) -> float:
        return min(_MOST_EXCURSIONS, _VISITED * self.graph.vertices)

    def _flows(self, logits: Any, pivots: Int[np.ndarray, "robots"]) -> list[np.ndarray]:
        """Return the steps and shares of time of trained walks, then those of excursions."""
        chance, share = map(np.asarray, _trained(logits, pivots, self.steps, self.floor))
        excursions = [self._excursions(often) for often in share]
        return [chance, share, *(np.stack(part) for part in zip(*excursions, strict=True))]

    def _excursions(
        self, share: Float[np.ndarray, "cells"]
    ) -> tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "branches cells"]]:
        """Build the reversible walk of the excursions, which visit all cells.

        The conductance of an edge falls with its distance from the cells with a large `share` of
        the time, so that excursions drift back to these cells. Returns the share of time that
        excursions spend in each cell, and the probability of each of their steps.
        """
        image, conductance = np.asarray(self.steps.image), np.asarray(self.steps.even) > 0
        often = np.flatnonzero(share >= 1 / share.size)
        near = self.graph.matrix(np.ones(len(self.graph.edges)))
        far = scipy.sparse.csgraph.dijkstra(near, unweighted=True, indices=often, min_only=True)
        fall = np.log(_FARTHEST) / max(1.0, float(far.max()))
        # No step may be less probable than the floor allows.
        fall = max(fall, np.log(max(self.floor, 1e-9)) if self.floor else fall)
        conductance = conductance * np.exp(fall * (far + far[image]) / 2)
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


@jax.jit
def _trained(logits, pivots, steps, floor):  # type: ignore[no-untyped-def]
    """Compute the probability of each step of walks, and their shares of time in the long run."""
    chance = steps.chances(logits, floor)
    return chance, jax.vmap(shares, (0, 0, None))(chance, pivots, steps)


def shares(
    chance: Float[Array, "branches cells"], pivot: int | Int[Array, ""], steps: Steps
) -> Float[Array, "cells"]:
    """Compute the share of time in each cell in the long run, given the probability of each step.

    The system for the visits between two visits to the cell `pivot`, which must be a likely cell,
    is solved on the host. The shares have derivatives: its transpose is solved with the same
    factors.
    """
    first = jnp.arange(chance.shape[1]) == pivot
    into = jnp.where((steps.even > 0) & ~first[None], chance[steps.back, steps.image], 0.0)

    def apply(visits: Float[Array, "cells"]) -> Float[Array, "cells"]:
        return visits - jnp.sum(into * visits[steps.image], axis=0)

    def on_host(which: str) -> Callable[..., Any]:
        fixed = steps.image, jax.lax.stop_gradient(into)
        call = functools.partial(jax.pure_callback, functools.partial(_solved, which))
        return lambda _, right: call(right, *fixed, right, vmap_method="broadcast_all")

    begin = first.astype(chance.dtype)
    # The host factorizes the transpose, whose columns are at hand.
    visits = jax.lax.custom_linear_solve(apply, begin, on_host("T"), on_host("N"))
    visits = jnp.maximum(visits, 0.0)
    return visits / jnp.sum(visits)


def _solved(which: str, image: Any, into: Any, right: Any) -> np.ndarray:
    """Solve `x = right + Q x`, or its transpose, where `Q` has the entries `into` at `image`."""
    image, into, right = np.asarray(image), np.asarray(into), np.asarray(right)
    found = np.empty_like(right)
    for walk in np.ndindex(right.shape[:-1]):
        solver = _factored(image.shape[-2:], image[walk].tobytes(), into[walk].tobytes())
        found[walk] = solver.solve(right[walk], which)
    return found


@functools.lru_cache(_FACTORS)
def _factored(shape: tuple[int, int], image: bytes, into: bytes) -> Any:
    branches, cells = shape
    data = np.vstack([np.ones(cells), -np.frombuffer(into).reshape(shape)])
    rows = np.vstack([np.arange(cells), np.frombuffer(image, np.int32).reshape(shape)])
    ends = np.arange(cells + 1) * (branches + 1)
    return scipy.sparse.linalg.splu(
        scipy.sparse.csc_array((data.T.ravel(), rows.T.ravel(), ends), (cells, cells)),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


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
    def one(flows):  # type: ignore[no-untyped-def]
        trained, often, rare, excursion = flows
        total = (1 - rare.sum()) * often + rare
        mixed = (1 - rare.sum()) * often[None] * trained + rare[None] * excursion
        mixed = mixed / total[None]

        def step(value, _):  # type: ignore[no-untyped-def]
            return unseen * steps.pull(mixed, value), None

        late, _ = jax.lax.scan(step, unseen, length=attack_time)
        if start == "worst":
            return log_missed_from_worst(late, unseen, hardness, _TINY)
        begin = unseen * total[:, None] if start == "stationary" else unseen
        missed = jnp.sum(begin * late, axis=0) / jnp.maximum(jnp.sum(begin, axis=0), 1e-30)
        return jnp.log(missed + 1e-30)

    flows = chance, share, excursion_share, excursion_chance
    return jnp.sum(jax.lax.map(one, [part.astype(unseen.dtype) for part in flows]), axis=0)


@functools.partial(jax.jit, static_argnames=("count", "attack_time", "start"))
def _follow(now, hardness, count, pivots, flows, unseen, steps, floor, **fixed):  # type: ignore[no-untyped-def]
    def loss(logits, hardness):  # type: ignore[no-untyped-def]
        trained = *_trained(logits, pivots, steps, floor), *flows
        return soft_loss(_log_missed(*trained, unseen, steps, hardness, **fixed), hardness, _TINY)

    return follow(loss, now, hardness, count, _SCALE)
