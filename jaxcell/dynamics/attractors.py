"""Attractors, from the periodic groups of a box and the orbits that begin in them."""

import dataclasses
import functools
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..mapping import PeriodicGroups
from ..space.box import Box
from .maps import Flow, Map


# Orbits that begin in each group and in all of them, and the mappings that are looked at.
_STARTS = 4
_MAX_STARTS = 1 << 12
SCATTERED = 256
"""Orbits from random points of the box."""
_WINDOW = 256
# Mappings before that, doubled until what merges stays the same.
_SETTLE = 64
_MAX_SETTLE = 1 << 13


@dataclasses.dataclass(frozen=True, eq=False)
class Attractors:
    """Attractors of a map, and the one that each periodic group leads to."""

    of_group: Int[np.ndarray, "groups"]
    "The attractor that most orbits from each group end on; -1 if they leave the box."
    several: Bool[np.ndarray, "groups"]
    "Whether orbits from the group end on more than one, as near a saddle."
    count: int
    orbit: Float[np.ndarray, "attractors window axes"]
    "An orbit on each attractor."
    sampled: Float[np.ndarray, "attractors"]
    "The share of orbits from random points of the box that end on each attractor."
    cells: tuple[Int[np.ndarray, "_"], ...]
    "The cells that orbits on each attractor visit, in ascending order."
    settled: bool
    "Whether twice as many mappings gave the same attractors."


def attractors(
    map: Map, box: Box, params: Any, groups: PeriodicGroups, *, follow: int = 0, seed: int = 0
) -> Attractors:
    """Find the attractors that the periodic groups of a cell map stand for.

    A limit cycle or a chaotic attractor makes many periodic groups, and a saddle makes one that
    attracts nothing. So the map itself, not that of the cells, is followed from a few points of
    each group until their orbits have settled; orbits that come nearer to each other than half a
    cell are on one attractor (as in the second stage of Hsu 1987, with orbits in place of a
    generalized map of the groups' neighbourhood, whose cells at small steps spread the groups over
    all of it). Orbits from random points find attractors that cells are too coarse for, and say how
    many starts should lead to each.

    **Arguments:**

    - `map`, `box`, `params`, `follow`: as for [`jaxcell.dynamics.images`][].
    - `groups`: the periodic groups of its images, with those of the two sinks.
    - `seed`: of the points.

    **Returns:** [`Attractors`][jaxcell.dynamics.attractors.Attractors].
    """
    rng = np.random.default_rng(seed)
    start, group = _starts(box, groups, rng)
    scattered = rng.uniform(box.lower, box.upper, (SCATTERED, box.dimensions))
    start = np.concatenate([start, scattered])
    settle, before = _SETTLE, np.zeros(0)
    while True:
        orbit, start = _orbits(map, box, params, start, settle)
        end = _merged(box, orbit, follow)
        settled = np.array_equal(before, end)
        if settled or settle >= _MAX_SETTLE:
            break
        settle, before = 2 * settle, end
    count = int(end.max(initial=-1)) + 1
    votes = np.zeros((int(groups.count), count + 1), np.int64)
    np.add.at(votes, (group, end[: group.size]), 1)
    # No orbit begins in a sink: those are the last two groups.
    votes[-2:, -1] = 1
    of_group = votes.argmax(axis=1)
    index = box.index(orbit)
    return Attractors(
        of_group=np.where(of_group == count, -1, of_group),
        several=np.count_nonzero(votes, axis=1) > 1,
        count=count,
        orbit=orbit[[int(np.argmax(end == k)) for k in range(count)]],
        sampled=np.bincount(end[group.size :] + 1, minlength=count + 1)[1:] / SCATTERED,
        cells=tuple(np.unique(index[end == k][index[end == k] < box.size]) for k in range(count)),
        settled=settled,
    )


def period(orbit: Float[np.ndarray, "window axes"], box: Box) -> int:
    """Mappings after which an orbit is back, to 1e-3 of a cell; 0 if it is not within its half."""
    near = box.apart((orbit[::-1] - orbit[-1]) / box.width).max(axis=1) < 1e-3
    half = near.size // 2
    back = np.flatnonzero(near[1:half])
    if not back.size:
        return 0
    steps = int(back[0]) + 1
    return steps if near[:half:steps].all() else 0


def _starts(
    box: Box, groups: PeriodicGroups, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "starts axes"], Int[np.ndarray, "starts"]]:
    """Random points of a few cells of each group, and the group of each."""
    cells = np.flatnonzero(np.asarray(groups.step[: box.size]) == 0)
    group = np.asarray(groups.group)[cells]
    order = np.argsort(group, kind="stable")
    cells, group = cells[order], group[order]
    live = int(groups.count) - 2
    each = int(np.clip(_MAX_STARTS // max(1, live), 1, _STARTS))
    first = np.searchsorted(group, np.unique(group))
    size = np.diff([*first, group.size])
    # Evenly along the group, some cells twice if it has few.
    chosen = (first[:, None] + np.arange(each) * size[:, None] // each).ravel()
    inside = rng.uniform(-0.5, 0.5, (chosen.size, box.dimensions))
    return box.centre(cells[chosen]) + inside * box.width, group[chosen]


def _orbits(
    map: Map, box: Box, params: Any, start: Float[np.ndarray, "starts axes"], settle: int
) -> tuple[Float[np.ndarray, "starts window axes"], Float[np.ndarray, "starts axes"]]:
    """The last mappings of orbits from points, and where they end."""
    # One of few sizes, each compiled once.
    size = 1 << max(4, (start.shape[0] - 1).bit_length())
    filled = np.resize(start, (size, box.dimensions))
    orbit = np.asarray(_orbits_of(map, box, params, jnp.asarray(filled), settle))
    return orbit[: start.shape[0]], orbit[: start.shape[0], -1]


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _orbits_of(map: Map, box: Box, params: Any, start: Any, settle: Any) -> Any:
    # A flow is looked at step by step, so that two orbits on one cycle are seen to be on it.
    fine = map.one if isinstance(map, Flow) else map

    def orbit(x):  # type: ignore[no-untyped-def]
        x = jax.lax.fori_loop(0, settle, lambda _, y: map(y, params), x)
        return jax.lax.scan(lambda y, _: (fine(y, params),) * 2, x, None, length=_WINDOW)[1]

    return jax.vmap(orbit)(start)


def _merged(
    box: Box, orbit: Float[np.ndarray, "starts window axes"], follow: int
) -> Int[np.ndarray, "starts"]:
    """The attractor of each orbit, numbered as they come; -1 for those that leave the box."""
    starts = orbit.shape[0]
    last = box.index(orbit[:, -1 - follow :])
    lost = (last >= box.size).all(axis=1)
    place = (orbit[~lost] - np.array(box.lower)) / box.width
    edges = []
    # Two points within half a cell of each other are in one cell of one of these grids.
    for grid, shift in enumerate(itertools.product((0.0, 0.5), repeat=box.dimensions)):
        corner = np.floor(np.nan_to_num(place + np.array(shift), nan=-1.0, posinf=-1, neginf=-1))
        for axis, kind in enumerate(box.axes):
            if kind == "periodic":
                corner[..., axis] %= box.cells[axis]
        flat = np.zeros(corner.shape[:-1])
        for axis, cells in enumerate(box.cells):
            flat = flat * (2 * cells + 3) + np.clip(corner[..., axis], -1, 2 * cells)
        who = np.broadcast_to(np.flatnonzero(~lost)[:, None], flat.shape)
        pairs = np.unique(np.stack([who.ravel(), flat.ravel()]), axis=1)
        _, cell = np.unique(pairs[1], return_inverse=True)
        edges.append((pairs[0].astype(np.int64), cell, grid))
    offset, rows, columns = starts, [], []
    for who, cell, _ in edges:
        rows.append(who)
        columns.append(offset + cell)
        offset += int(cell.max(initial=-1)) + 1
    row, column = np.concatenate(rows), np.concatenate(columns)
    graph = coo_array((np.ones(row.size), (row, column)), shape=(offset, offset))
    _, label = connected_components(graph, directed=False)
    found = np.full(starts, -1)
    found[~lost] = np.unique(label[:starts][~lost], return_inverse=True)[1]
    return found
