"""Attractors, from the periodic groups of a box and the orbits that begin in them."""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from ..mapping import PeriodicGroups
from ..mapping.section import bucket
from ..space.box import Box
from .batches import params_of, stacked, with_last
from .maps import Flow, Map


# Orbits that begin in each group and in all of them, and the mappings that are looked at.
_STARTS = 4
_MAX_STARTS = 1 << 12
SCATTERED = 256
"""Orbits from random points of the box."""
_WINDOW = 256
_GOLDEN = (5**0.5 - 1) / 2
# Orbits of each of two attractors that are nearer to each other than half a cell.
_MIN_APART = 8
# Mappings before that, twice as many until what merges stays the same.
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
    scattered: int
    "Number of these orbits."
    cells: tuple[Int[np.ndarray, "_"], ...]
    "The cells that orbits on each attractor visit, in ascending order."
    settled: bool
    "Whether twice as many mappings gave the same attractors."


def attractors(
    map: Map,
    box: Box,
    members: Sequence[Any],
    groups: Sequence[PeriodicGroups],
    *,
    follow: int = 0,
    scattered: int = SCATTERED,
    seed: int = 0,
) -> list[Attractors]:
    """Find the attractors that the periodic groups of cell maps stand for.

    A limit cycle or a chaotic attractor makes many periodic groups, and a saddle makes one that
    attracts nothing. So the map itself, not that of the cells, is followed from a few points of
    each group until their orbits have settled; orbits that come nearer to each other than half a
    cell are on one attractor (as in the second stage of Hsu 1987, with orbits in place of a
    generalized map of the groups' neighbourhood, whose cells at small steps spread the groups over
    all of it). Orbits from random points find attractors that cells are too coarse for, and say how
    many starts should lead to each.

    **Arguments:**

    - `map`, `box`, `follow`: as for [`jaxcell.dynamics.images`][].
    - `members`: the parameters of each member, which are followed in one batch.
    - `groups`: the periodic groups of the images of each, with those of the two sinks.
    - `scattered`: orbits from random points of the box.
    - `seed`: of the points.

    **Returns:** [`Attractors`][jaxcell.dynamics.attractors.Attractors] of each.
    """
    starts, group = zip(*(_starts(box, one, scattered, seed) for one in groups), strict=True)
    params, start = stacked(members), dict(enumerate(starts))
    ends: dict[int, np.ndarray] = {}
    found: dict[int, Attractors] = {}
    done, more = 0, _SETTLE
    while start:
        rows = np.concatenate([*start.values()])
        sizes = [len(one) for one in start.values()]
        orbits = _orbits(map, box, params, np.repeat([*start], sizes), rows, more)
        # Then as many again as there were.
        done = more = done + more
        for k, orbit in zip([*start], np.split(orbits, np.cumsum(sizes)[:-1]), strict=True):
            before, ends[k] = ends.get(k), _merged(box, orbit, follow)
            settled = before is not None and np.array_equal(before, ends[k])
            start[k] = orbit[:, -1]
            if settled or done >= _MAX_SETTLE:
                found[k] = _of_orbits(box, groups[k], group[k], orbit, ends[k], settled)
                del start[k]
    return [found[k] for k in range(len(members))]


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
    box: Box, groups: PeriodicGroups, scattered: int, seed: int
) -> tuple[Float[np.ndarray, "starts axes"], Int[np.ndarray, "of_groups"]]:
    """Random points of a few cells of each group, and of the box; and the group of the first."""
    rng = np.random.default_rng(seed)
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
    anywhere = rng.uniform(box.lower, box.upper, (scattered, box.dimensions))
    start = np.concatenate([box.centre(cells[chosen]) + inside * box.width, anywhere])
    return start, group[chosen]


def _of_orbits(
    box: Box,
    groups: PeriodicGroups,
    group: Int[np.ndarray, "of_groups"],
    orbit: Float[np.ndarray, "starts window axes"],
    end: Int[np.ndarray, "starts"],
    settled: bool,
) -> Attractors:
    """The attractors that orbits end on, the first of which began in groups."""
    count = int(end.max(initial=-1)) + 1
    votes = np.zeros((int(groups.count), count + 1), np.int64)
    np.add.at(votes, (group, end[: group.size]), 1)
    # No orbit begins in a sink: those are the last two groups.
    votes[-2:, -1] = 1
    of_group = votes.argmax(axis=1)
    index = box.index(orbit)
    anywhere = end[group.size :]
    return Attractors(
        of_group=np.where(of_group == count, -1, of_group),
        several=np.count_nonzero(votes, axis=1) > 1,
        count=count,
        orbit=orbit[[int(np.argmax(end == k)) for k in range(count)]],
        sampled=np.bincount(anywhere + 1, minlength=count + 1)[1:] / anywhere.size,
        scattered=anywhere.size,
        cells=tuple(np.unique(index[end == k][index[end == k] < box.size]) for k in range(count)),
        settled=settled,
    )


def _orbits(
    map: Map, box: Box, params: Any, member: np.ndarray, start: np.ndarray, settle: int
) -> Float[np.ndarray, "starts window axes"]:
    """The last mappings of orbits from points."""
    rows, size = len(start), bucket(len(start))
    filled = (jnp.asarray(with_last(values, size)) for values in (member, start))
    return np.asarray(_orbits_of(map, box, params, *filled, settle))[:rows]


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _orbits_of(map: Map, box: Box, params: Any, member: Any, start: Any, settle: Any) -> Any:
    # A flow is looked at step by step, so that two orbits on one cycle are seen to be on it; and by
    # uneven steps, since a cycle of a whole number of even ones is seen at as many points only.
    parts = jnp.asarray(0.5 + np.arange(_WINDOW) * _GOLDEN % 1, start.dtype)

    def orbit(member, x):  # type: ignore[no-untyped-def]
        own = params_of(params, member)
        x = jax.lax.fori_loop(0, settle, lambda _, y: map(y, own), x)

        def step(y, part):  # type: ignore[no-untyped-def]
            y = map.one(y, own, part) if isinstance(map, Flow) else map(y, own)
            return y, y

        return jax.lax.scan(step, x, parts)[1]

    return jax.vmap(orbit)(member, start)


def _merged(
    box: Box, orbit: Float[np.ndarray, "starts window axes"], follow: int
) -> Int[np.ndarray, "starts"]:
    """The attractor of each orbit, numbered as they come; -1 for those that leave the box."""
    last = box.index(orbit[:, -1 - follow :])
    stays = np.flatnonzero((last < box.size).any(axis=1))
    place = (orbit[stays] - np.array(box.lower)) / box.width
    label = _linked(box, place, 2)
    # Attractors that come as near to each other as that are apart at half the length, unless too
    # few orbits are left to tell. The orbits of a large one would be links of a chain still.
    for k in range(int(label.max(initial=-1)) + 1):
        own = np.flatnonzero(label == k)
        finer = _linked(box, place[own], 4) if own.size >= 2 * _MIN_APART else np.zeros(1, int)
        size = np.bincount(finer)
        apart = np.flatnonzero(size >= max(_MIN_APART, own.size / 5))
        if apart.size > 1 and size[apart].sum() >= 0.9 * own.size:
            finer = np.where(np.isin(finer, apart), finer, size.argmax())
            label[own] = label.max() + 1 + finer
    _, first, label = np.unique(label, return_index=True, return_inverse=True)
    found = np.full(orbit.shape[0], -1)
    found[stays] = np.argsort(np.argsort(first))[label]
    return found


def _linked(
    box: Box, place: Float[np.ndarray, "orbits window axes"], parts: int
) -> Int[np.ndarray, "orbits"]:
    """Components of orbits that come into one of the parts of a cell, half of each overlapping."""
    orbits = len(place)
    bits = orbits.bit_length()
    along = []
    for axis, (cells, kind) in enumerate(zip(box.cells, box.axes, strict=True)):
        count, at = parts * cells, parts * place[..., axis]
        at[~np.isfinite(at)] = -1
        both = (np.floor(at + shift) for shift in (0.0, 0.5))
        if kind == "periodic":
            both = (one - count * np.floor(one / count) for one in both)
        along.append([np.clip(one, -1, count + 1).astype(np.int64) + 1 for one in both])
    meets = np.zeros((orbits, orbits), bool)
    for corner in itertools.product(*along):
        key = np.zeros(place.shape[:2], np.int64)
        for one, cells in zip(corner, box.cells, strict=True):
            key = key * (parts * cells + 3) + one
        # Sorted by cells, so that orbits in one cell are next to each other.
        key = np.sort(((key << bits) + np.arange(orbits)[:, None]).ravel())
        between = key[1:] ^ key[:-1]
        two = np.flatnonzero((between > 0) & (between < 1 << bits))
        meets[key[two] & ((1 << bits) - 1), key[two + 1] & ((1 << bits) - 1)] = True
    return connected_components(csr_array(meets), directed=False)[1]
