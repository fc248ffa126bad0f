"""The attractor of each cell, found from the orbit of its centre instead of the images of cells."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..space.box import Box
from .batches import in_stages, slices
from .imaging import Say
from .maps import Map


VISITS = 16
"""Number of visits to the cells of an attractor after which an orbit is assigned to it."""
# Number of mappings between two checks for orbits that have ended, and the largest number.
_STAGE = 16
_MAX_MAPPINGS = 1 << 12
NONE, OUTSIDE = -1, -2
"""Numbers that stand for no attractor, and for the outside of the box."""


def orbit_basins(
    map: Map,
    box: Box,
    params: Any,
    attractor_cells: Sequence[Int[np.ndarray, "_"]],
    *,
    follow: int = 0,
    say: Say | None = None,
) -> tuple[Int[np.ndarray, "cells"], Int[np.ndarray, "cells"]]:
    """Follow the centre of each cell until it has repeatedly visited the cells of one attractor.

    Returns the attractor of each cell (-2 if its orbit leaves the box, and -1 if it reaches no
    attractor), and the number of mappings until the first visit to this attractor.
    """
    owner = attractor_owners(box, attractor_cells)
    basin, step = np.empty((2, box.size), np.int32)
    for part in slices(box.size):
        centres = box.centre(np.arange(part.start, part.stop, dtype=np.int32))
        basin[part], step[part] = orbit_ends(map, box, params, owner, centres, follow=follow)
        if say is not None:
            say("following orbits", part.stop, box.size)
    return basin, step


def attractor_owners(
    box: Box, attractor_cells: Sequence[Int[np.ndarray, "_"]]
) -> Int[np.ndarray, "_"]:
    """Return the attractor that contains each cell, -1 for none, and -2 for the sink outside."""
    owner = np.full(box.size + 2, NONE, np.int32)
    owner[box.outside] = OUTSIDE
    for k, cells in enumerate(attractor_cells):
        owner[cells] = k
    return owner


def orbit_ends(
    map: Map,
    box: Box,
    params: Any,
    owner: Int[np.ndarray, "_"],
    points: Float[np.ndarray, "points axes"],
    *,
    follow: int = 0,
    visits: int = VISITS,
    most: int = _MAX_MAPPINGS,
) -> tuple[Int[np.ndarray, "points"], Int[np.ndarray, "points"]]:
    """Follow points for at most `most` mappings, to find the attractors that they reach.

    `owner` is a result of `attractor_owners`. Returns the attractor whose cells each point visited
    `visits` times, or `NONE` or `OUTSIDE`, and the number of mappings until the first visit,
    which is 0 for a point that starts there.
    """
    params, known = jax.tree.map(jnp.asarray, params), jax.device_put(owner)

    def stage(state: Any, k: int) -> Any:
        done = (k + 1) * _STAGE
        state = jax.device_get(_visit(map, box, params, known, state, k * _STAGE, follow))
        _, label, begun, seen, away = state
        lost, settled = away > follow, seen >= visits
        basin = np.where(lost, OUTSIDE, np.where(settled, label, NONE)).astype(np.int32)
        since = np.where(lost, done, np.where(settled, begun, NONE)).astype(np.int32)
        return state, lost | settled | (done >= min(most, _MAX_MAPPINGS)), (basin, since)

    begun, seen, away = np.zeros((3, len(points)), np.int32)
    label = np.full(len(points), NONE, np.int32)
    basin, since = in_stages((points, label, begun, seen, away), stage)
    since[(basin >= 0) & (owner[box.index(points)] == basin)] = 0
    return basin, since


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _visit(map: Map, box: Box, params: Any, owner: Any, state: Any, done: Any, follow: Any) -> Any:
    """Map points `_STAGE` times, and count how often each has visited its latest attractor."""

    def orbit(x, label, begun, visits, away):  # type: ignore[no-untyped-def]
        def step(k, state):  # type: ignore[no-untyped-def]
            x, label, begun, visits, away = state
            x = box.wrapped(map(x, params))
            here = owner[box.index(x)]
            visit, another = here >= 0, (here >= 0) & (here != label)
            begun = jnp.where(another, jnp.asarray(done + k + 1, begun.dtype), begun)
            visits = jnp.where(another, 1, visits + visit.astype(visits.dtype))
            # An orbit that has been outside for too long does not return.
            away = jnp.where((here == OUTSIDE) | (away > follow), away + 1, 0)
            return x, jnp.where(visit, here, label), begun, visits, away

        return jax.lax.fori_loop(0, _STAGE, step, (x, label, begun, visits, away))

    return jax.vmap(orbit)(*state)
