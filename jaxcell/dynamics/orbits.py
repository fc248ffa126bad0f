"""The attractor of each cell by the orbit of its centre, instead of by the cells on its way."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from ..space.box import Box
from .batches import in_stages
from .imaging import CHUNK, Say
from .maps import Map


# Visits to the cells of an attractor that settle it, mappings between two looks at which orbits
# have ended, and the most of them.
_VISITS = 16
_STAGE = 16
_MAX_MAPPINGS = 1 << 12
_NONE, _OUTSIDE = -1, -2


def orbit_basins(
    map: Map,
    box: Box,
    params: Any,
    attractor_cells: Sequence[Int[np.ndarray, "_"]],
    *,
    follow: int = 0,
    say: Say | None = None,
) -> tuple[Int[np.ndarray, "cells"], Int[np.ndarray, "cells"]]:
    """Follow the centre of every cell until it has visited the cells of one attractor for long.

    **Arguments:**

    - `map`, `box`, `params`, `follow`, `say`: as for [`jaxcell.dynamics.images`][].
    - `attractor_cells`: the cells of each attractor.

    **Returns:** the attractor of each cell, -2 if its orbit leaves the box, -1 if it comes to none;
    and the mappings until the first of these visits.
    """
    owner = np.full(box.size + 2, _NONE, np.int32)
    owner[box.outside] = _OUTSIDE
    for k, cells in enumerate(attractor_cells):
        owner[cells] = k
    params = jax.tree.map(jnp.asarray, params)
    basin, step = np.empty((2, box.size), np.int32)
    for first in range(0, box.size, CHUNK):
        cells = np.arange(first, min(first + CHUNK, box.size), dtype=np.int32)
        basin[cells], step[cells] = _of_chunk(map, box, params, jnp.asarray(owner), cells, follow)
        if say is not None:
            say("following orbits", int(cells[-1]) + 1, box.size)
    return basin, step


def _of_chunk(
    map: Map, box: Box, params: Any, owner: Any, cells: Int[np.ndarray, "size"], follow: int
) -> tuple[np.ndarray, ...]:
    def stage(state: Any, k: int) -> Any:
        done = (k + 1) * _STAGE
        state = jax.device_get(_visit(map, box, params, owner, state, k * _STAGE, follow))
        _, label, begun, visits, away = state
        lost, settled = away > follow, visits >= _VISITS
        basin = np.where(lost, _OUTSIDE, np.where(settled, label, _NONE)).astype(np.int32)
        since = np.where(lost, done, np.where(settled, begun, _NONE)).astype(np.int32)
        return state, lost | settled | (done >= _MAX_MAPPINGS), (basin, since)

    begun, visits, away = np.zeros((3, cells.size), np.int32)
    label = np.full(cells.size, _NONE, np.int32)
    return in_stages((box.centre(cells), label, begun, visits, away), stage)


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _visit(map: Map, box: Box, params: Any, owner: Any, state: Any, done: Any, follow: Any) -> Any:
    """Some mappings more, with the attractor that was visited last, since when, and how often."""

    def orbit(x, label, begun, visits, away):  # type: ignore[no-untyped-def]
        def step(k, state):  # type: ignore[no-untyped-def]
            x, label, begun, visits, away = state
            x = map(x, params)
            here = owner[box.index(x)]
            visit, another = here >= 0, (here >= 0) & (here != label)
            begun = jnp.where(another, jnp.asarray(done + k + 1, begun.dtype), begun)
            visits = jnp.where(another, 1, visits + visit.astype(visits.dtype))
            # What has been outside for too long does not come back.
            away = jnp.where((here == _OUTSIDE) | (away > follow), away + 1, 0)
            return x, jnp.where(visit, here, label), begun, visits, away

        return jax.lax.fori_loop(0, _STAGE, step, (x, label, begun, visits, away))

    return jax.vmap(orbit)(*state)
