"""Attractors, from the periodic groups of a box and the orbits that begin in them."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..mapping import PeriodicGroups
from ..mapping.section import bucket
from ..space.box import Box
from .batches import params_of, stacked, with_last
from .imaging import CHUNK
from .maps import Flow, Map
from .merging import merged
from .orbits import NONE, OUTSIDE, attractor_owners, orbit_ends


# Orbits that begin in each group and, where groups have several, in all of them.
_STARTS = 4
_MAX_STARTS = 1 << 12
# Groups in which they begin: a map that keeps volumes may have as many groups as cells.
_MAX_GROUPS = 1 << 13
SCATTERED = 256
"""Orbits from random points of the box."""
# The mappings that are looked at.
_WINDOW = 256
_GOLDEN = (5**0.5 - 1) / 2
# Mappings before that, twice as many until what merges stays the same.
_SETTLE = 64
_MAX_SETTLE = 1 << 13
# Mappings for each cell of the box, in all, to find where the other groups lead.
_SHARED = 64
# Orbits that are followed for it at once.
_PART = 1 << 17


@dataclasses.dataclass(frozen=True, eq=False)
class Attractors:
    """Attractors of a map, and the one that each periodic group leads to."""

    of_group: Int[np.ndarray, "groups"]
    "The attractor that most orbits from a group end on; -1 for none or NaN, -2 if they leave."
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
    many starts should lead to each. Of more groups than 8,192, those with the largest basins are
    followed so, and each of the others only until it visits cells of an attractor that is known.

    **Arguments:**

    - `map`, `box`, `follow`: as for [`jaxcell.dynamics.images`][].
    - `members`: the parameters of each member, which are followed in one batch.
    - `groups`: the periodic groups of the images of each, with those of the two sinks.
    - `scattered`: orbits from random points of the box.
    - `seed`: of the points.

    **Returns:** [`Attractors`][jaxcell.dynamics.attractors.Attractors] of each.
    """
    starts, begun = zip(*(_starts(box, one, scattered, seed) for one in groups), strict=True)
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
            before, ends[k] = ends.get(k), merged(box, orbit, follow)
            settled = before is not None and np.array_equal(before, ends[k])
            start[k] = orbit[:, -1]
            if settled or done >= _MAX_SETTLE:
                found[k] = _of_orbits(box, groups[k], begun[k], orbit, ends[k], settled)
                _lead_others(map, box, members[k], groups[k], begun[k], found[k], follow)
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
    """Random points of a few cells of groups, and of the box; and the group of the first."""
    rng = np.random.default_rng(seed)
    live = int(groups.count) - 2
    each = int(np.clip(_MAX_STARTS // max(1, live), 1, _STARTS))
    followed = np.arange(live)
    if live > _MAX_GROUPS:
        size = np.zeros(live + 2, np.int32)
        for first in range(0, box.size, CHUNK):
            np.subtract.at(size, groups.group[: box.size][first : first + CHUNK], np.int32(1))
        followed = np.sort(np.argpartition(size[:live], _MAX_GROUPS)[:_MAX_GROUPS])
    cells = _cells_of(box, groups, followed, each).ravel()
    inside = rng.uniform(-0.5, 0.5, (cells.size, box.dimensions))
    anywhere = rng.uniform(box.lower, box.upper, (scattered, box.dimensions))
    start = np.concatenate([box.centre(cells) + inside * box.width, anywhere])
    return start, np.repeat(followed, each)


def _cells_of(
    box: Box, groups: PeriodicGroups, chosen: Int[np.ndarray, "chosen"], each: int
) -> Int[np.ndarray, "chosen each"]:
    """Cells of groups, evenly among those of each, some twice if it has few."""
    group, step = (np.asarray(x)[: box.size] for x in (groups.group, groups.step))
    number = np.full(int(groups.count), -1, np.int32)
    number[chosen] = np.arange(chosen.size)
    place = np.arange(each) * np.asarray(groups.group_period)[chosen, None] // each
    found = np.zeros_like(place, dtype=np.int64)
    for first in range(0, box.size, CHUNK):
        part = slice(first, first + CHUNK)
        cells = np.flatnonzero((step[part] == 0) & (number[group[part]] >= 0))
        here = number[group[part][cells]]
        order = np.argsort(here, kind="stable")
        start = np.searchsorted(here[order], np.arange(chosen.size + 1))
        # What the place is among the group's cells of this part.
        own = (place >= 0) & (place < np.diff(start)[:, None])
        found[own] = first + cells[order[(start[:-1, None] + place)[own]]]
        place -= np.diff(start)[:, None]
    return found


def _of_orbits(
    box: Box,
    groups: PeriodicGroups,
    begun: Int[np.ndarray, "of_groups"],
    orbit: Float[np.ndarray, "starts window axes"],
    end: Int[np.ndarray, "starts"],
    settled: bool,
) -> Attractors:
    """The attractors that orbits end on, the first of which began in groups."""
    count = int(end.max(initial=-1)) + 1
    # No orbit begins in a sink: those are the last two groups.
    of_group = np.full(int(groups.count), NONE, np.int32)
    of_group[-2] = OUTSIDE
    several = np.zeros(of_group.size, bool)
    # Those that leave come last, as what most do is taken, and the first of what as many do.
    away = np.where(np.isfinite(orbit[: begun.size, -1]).all(axis=-1), count, count + 1)
    pair = begun * (count + 2) + np.where(end[: begun.size] < 0, away, end[: begun.size])
    pair, votes = np.unique(pair, return_counts=True)
    of_pair, ends = np.divmod(pair, count + 2)
    order = np.lexsort((-votes, of_pair))
    voted, first, kinds = np.unique(of_pair[order], return_index=True, return_counts=True)
    most = ends[order[first]]
    of_group[voted] = np.select([most < count, most == count], [most, OUTSIDE], NONE)
    several[voted] = kinds > 1
    anywhere = end[begun.size :]
    by_end = np.argsort(end, kind="stable")
    starts = np.searchsorted(end[by_end], np.arange(count + 1))
    each = np.split(by_end, starts)[1:-1]
    visited = (np.unique(box.index(orbit[own])) for own in each)
    return Attractors(
        of_group=of_group,
        several=several,
        count=count,
        orbit=orbit[by_end[starts[:-1]]],
        sampled=np.bincount(anywhere + 1, minlength=count + 1)[1:] / anywhere.size,
        scattered=anywhere.size,
        cells=tuple(cells[cells < box.size] for cells in visited),
        settled=settled,
    )


def _lead_others(
    map: Map,
    box: Box,
    params: Any,
    groups: PeriodicGroups,
    begun: Int[np.ndarray, "of_groups"],
    found: Attractors,
    follow: int,
) -> None:
    """Write where groups lead in which no orbit began, if an orbit from one cell of each tells."""
    others = _first_cells(box, groups, begun)
    if not others.size:
        return
    owner = attractor_owners(box, found.cells)
    most = _SHARED * box.size // others.size
    for part in np.array_split(others, 1 + others.size // _PART):
        ends, _ = orbit_ends(map, box, params, owner, box.centre(part), follow=follow, most=most)
        found.of_group[groups.group[part]] = ends


def _first_cells(
    box: Box, groups: PeriodicGroups, known: Int[np.ndarray, "_"]
) -> Int[np.ndarray, "others"]:
    """The smallest cells of groups that are not known, by which they are numbered."""
    other = np.ones(int(groups.count), bool)
    other[known] = False
    cells, highest = [np.zeros(0, np.int32)], -1
    for first in range(0, box.size, CHUNK):
        here = slice(first, min(first + CHUNK, box.size))
        on = np.flatnonzero(groups.step[here] == 0)
        number = np.maximum.accumulate(np.append(highest, groups.group[here][on]))
        new, highest = np.diff(number) > 0, number[-1]
        cells.append((first + on[new][other[number[1:][new]]]).astype(np.int32))
    return np.concatenate(cells)


def _orbits(
    map: Map, box: Box, params: Any, member: np.ndarray, start: np.ndarray, settle: int
) -> Float[np.ndarray, "starts window axes"]:
    """The last mappings of orbits from points."""
    rows, size = len(start), bucket(len(start))
    filled = (with_last(values, size) for values in (member, start))
    return np.asarray(_orbits_of(map, box, params, *filled, settle))[:rows]


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _orbits_of(map: Map, box: Box, params: Any, member: Any, start: Any, settle: Any) -> Any:
    # A flow is looked at step by step, so that two orbits on one cycle are seen to be on it; and by
    # uneven steps, since a cycle of a whole number of even ones is seen at as many points only.
    parts = jnp.asarray(0.5 + np.arange(_WINDOW) * _GOLDEN % 1, start.dtype)

    def orbit(member, x):  # type: ignore[no-untyped-def]
        own = params_of(params, member)

        def step(k, state):  # type: ignore[no-untyped-def]
            y, window = state
            looked, place = k >= settle, jnp.maximum(k - settle, 0)
            if isinstance(map, Flow):
                steps, part = jnp.where(looked, 1, map.usual), jnp.where(looked, parts[place], 1)
                y = map.ahead(y, own, steps, part)
            else:
                y = map(y, own)
            y = box.wrapped(y)
            # Until then, over and over where the first will be.
            return y, window.at[place].set(y)

        window = jnp.zeros((_WINDOW, x.size), x.dtype)
        return jax.lax.fori_loop(0, settle + _WINDOW, step, (x, window))[1]

    return jax.vmap(orbit)(member, start)
