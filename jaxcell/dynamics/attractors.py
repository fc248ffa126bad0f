"""Attractors of maps, found by following orbits from periodic groups of cells."""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..mapping import PeriodicGroups
from ..space.box import Box
from .batches import padded, params_of, slices, stacked
from .cycles import period, settled_cycles
from .maps import Flow, Map
from .merging import merged
from .orbits import NONE, OUTSIDE, attractor_owners, orbit_ends
from .returns import return_times


# Number of orbits from each group and, while groups have several, the largest total number.
_STARTS = 4
_MAX_STARTS = 1 << 12
# Number of groups that are followed: a map that preserves volumes may have as many as cells.
MAX_GROUPS = 1 << 13
SCATTERED = 256
"""Default number of orbits from random points, which find attractors that periodic groups miss."""
# Distance in cells from a point to a face at which it counts as on both sides.
_BESIDE = 1e-3
# Number of mappings in the observed window.
_WINDOW = 256
_GOLDEN = (5**0.5 - 1) / 2
# Mappings before the window, which double until the merged orbits stay the same.
_SETTLE = 64
_MAX_SETTLE = 1 << 13
# Least number of steps of a flow per mapping before the window.
_LEAST_STEPS = 32
# Mappings per cell of the box, in total, to find the attractors of the other groups.
_SHARED = 64
# Number of orbits of other groups that are followed at once.
_PART = 1 << 17


@dataclasses.dataclass(frozen=True, eq=False)
class Attractors:
    """Attractors of a map, and the attractor to which each periodic group leads.

    The fields without a docstring are those of [`Basins`][jaxcell.dynamics.Basins].
    """

    of_group: Int[np.ndarray, "groups"]
    "The attractor that most orbits from each group reach; -1 for none, -2 if they leave the box."
    several: Bool[np.ndarray, "groups"]
    "`True` for groups from which orbits end on several attractors, such as groups at a saddle."
    count: int
    orbit: Float[np.ndarray, "attractors window axes"]
    sampled: Float[np.ndarray, "attractors"]
    starts: Float[np.ndarray, "scattered axes"]
    ends: Int[np.ndarray, "scattered"]
    cells: tuple[Int[np.ndarray, "_"], ...]
    "The cells that orbits on each attractor visit, in ascending order."
    period: Int[np.ndarray, "attractors"]
    return_time: Float[np.ndarray, "attractors"] | None
    lower: Float[np.ndarray, "attractors axes"]
    upper: Float[np.ndarray, "attractors axes"]
    settled: bool
    neutral: bool


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
    """Find the attractors that the periodic groups of cell maps represent.

    A limit cycle or a chaotic attractor becomes many periodic groups, and a saddle becomes a group
    that attracts no orbits. So orbits of the map itself, not of the map of cells, start in a few
    cells of each group, and are followed until doubling the number of mappings does not change the
    attractors found. Orbits that approach each other within half a cell are on one attractor.
    Orbits from random points find attractors that are too small for the cells, and estimate the
    share of starts that lead to each attractor. If there are more than 8,192 groups, orbits start
    only in the groups with the largest basins. From each other group, one orbit is followed until
    it visits cells of a known attractor. (Hsu 1987 instead computes a generalized map of the cells
    near the groups; with short mappings, it would spread over the neighbourhood of an attractor.)

    `members` are the parameters of several maps, whose orbits are computed in one batch. The
    `groups` of each member end with the two sinks. `scattered` orbits start at random points. An
    orbit may stay outside the box for `follow` mappings before it counts as lost.
    """
    starts, begun = zip(*(_starts(box, each, scattered, seed) for each in groups), strict=True)
    params, start = stacked(members), dict(enumerate(starts))
    ends: dict[int, np.ndarray] = {}
    results: dict[int, Attractors] = {}
    done, more = 0, _SETTLE
    steps = max(map.usual, _LEAST_STEPS) if isinstance(map, Flow) else 1
    while start:
        rows = np.concatenate([*start.values()])
        sizes = [len(points) for points in start.values()]
        orbits = _orbits(map, box, params, np.repeat([*start], sizes), rows, more)
        # The next round takes as many mappings as all rounds so far.
        done = more = done + more
        for k, orbit in zip([*start], np.split(orbits, np.cumsum(sizes)[:-1]), strict=True):
            before, ends[k] = ends.get(k), merged(box, orbit, follow)
            same = before is not None and np.array_equal(before, ends[k])
            cycles, neutral = None, False
            if same:
                ages = done * steps, _MAX_SETTLE * steps
                cycles, neutral = settled_cycles(map, box, members[k], orbit, ends[k], *ages)
            start[k] = orbit[:, -1]
            if cycles is not None or neutral or done >= _MAX_SETTLE:
                own = groups[k], begun[k], orbit, ends[k], starts[k][begun[k].size :]
                results[k] = _of_orbits(map, box, members[k], *own, cycles, neutral)
                _lead_others(map, box, members[k], groups[k], begun[k], results[k], follow)
                del start[k]
    return [results[k] for k in range(len(members))]


def _starts(
    box: Box, groups: PeriodicGroups, scattered: int, seed: int
) -> tuple[Float[np.ndarray, "starts axes"], Int[np.ndarray, "of_groups"]]:
    """Draw points in a few cells of each group, and then `scattered` points in the whole box.

    Returns all points, and the group of each point that was drawn in a group.
    """
    rng = np.random.default_rng(seed)
    live = int(groups.count) - 2
    each = int(np.clip(_MAX_STARTS // max(1, live), 1, _STARTS))
    followed = np.arange(live)
    if live > MAX_GROUPS:
        size = np.zeros(live + 2, np.int32)
        for part in slices(box.size):
            np.subtract.at(size, groups.group[part], np.int32(1))
        followed = np.sort(np.argpartition(size[:live], MAX_GROUPS)[:MAX_GROUPS])
    cells = cells_of(box, groups, followed, each).ravel()
    inside = rng.uniform(-0.5, 0.5, (cells.size, box.dimensions))
    anywhere = rng.uniform(box.lower, box.upper, (scattered, box.dimensions))
    start = np.concatenate([box.centre(cells) + inside * box.width, anywhere])
    return start, np.repeat(followed, each)


def cells_of(
    box: Box, groups: PeriodicGroups, chosen: Int[np.ndarray, "chosen"], each: int
) -> Int[np.ndarray, "chosen each"]:
    """Choose `each` evenly spaced cells of each chosen group, with repeats if it has fewer."""
    group, step = np.asarray(groups.group), np.asarray(groups.step)
    number = np.full(int(groups.count), -1, np.int32)
    number[chosen] = np.arange(chosen.size)
    place = np.arange(each) * np.asarray(groups.group_period)[chosen, None] // each
    chosen_cells = np.zeros_like(place, dtype=np.int64)
    for part in slices(box.size):
        cells = np.flatnonzero((step[part] == 0) & (number[group[part]] >= 0))
        here = number[group[part][cells]]
        order = np.argsort(here, kind="stable")
        start = np.searchsorted(here[order], np.arange(chosen.size + 1))
        # The places in this part of the cells.
        own = (place >= 0) & (place < np.diff(start)[:, None])
        chosen_cells[own] = part.start + cells[order[(start[:-1, None] + place)[own]]]
        place -= np.diff(start)[:, None]
    return chosen_cells


def _of_orbits(
    map: Map,
    box: Box,
    params: Any,
    groups: PeriodicGroups,
    begun: Int[np.ndarray, "of_groups"],
    orbit: Float[np.ndarray, "starts window axes"],
    end: Int[np.ndarray, "starts"],
    starts: Float[np.ndarray, "scattered axes"],
    cycles: dict[int, Float[np.ndarray, "_ axes"]] | None,
    neutral: bool,
) -> Attractors:
    """Build the result from orbits; `end` is the attractor that each orbit reaches, or -1 for none.

    The first orbits start in the groups `begun`, and the others at the random points `starts`. The
    argument `cycles` has the attractors that are cycles of points; it is `None` if orbits have not
    settled.
    """
    count = int(end.max(initial=-1)) + 1
    # The last two groups are the sinks, in which no orbit starts.
    of_group = np.full(int(groups.count), NONE, np.int32)
    of_group[-2] = OUTSIDE
    several = np.zeros(of_group.size, bool)
    # Orbits that leave come last, because the first of the commonest ends is taken.
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
    first_of = np.searchsorted(end[by_end], np.arange(count + 1))
    each = np.split(by_end, first_of)[1:-1]
    visited = [np.unique(box.index(orbit[own])) for own in each]
    shape = count, box.dimensions
    lower = np.reshape([np.nanmin(orbit[own], axis=(0, 1)) for own in each], shape)
    upper = np.reshape([np.nanmax(orbit[own], axis=(0, 1)) for own in each], shape)
    shown = orbit[by_end[first_of[:-1]]]
    for k, cycle in (cycles or {}).items():
        shown[k] = np.resize(cycle, shown[k].shape)
        lower[k], upper[k] = cycle.min(axis=0), cycle.max(axis=0)
        # A point on a face belongs to the cells on both sides, from which orbits approach it.
        beside = itertools.product((-_BESIDE, _BESIDE), repeat=box.dimensions)
        visited[k] = np.unique(box.index(cycle[:, None] + np.array([*beside]) * box.width))
    periods = np.array([period(own, box) for own in shown], np.int64)
    time: np.ndarray | None = None
    if isinstance(map, Flow):
        # Points of a flow are observed in uneven steps, after which only a point is back.
        periods[periods > 1] = 0
        time = np.zeros(count)
        time[periods == 0] = return_times(map, box, params, shown[periods == 0, 0])
    elif (duration := getattr(map, "duration", None)) is not None:
        time = duration * np.where(periods > 0, periods, np.inf)
    return Attractors(
        of_group=of_group,
        several=several,
        count=count,
        orbit=shown,
        sampled=np.bincount(anywhere + 1, minlength=count + 1)[1:] / anywhere.size,
        starts=starts,
        ends=anywhere,
        cells=tuple(cells[cells < box.size] for cells in visited),
        period=periods,
        return_time=time,
        lower=lower,
        upper=upper,
        settled=cycles is not None,
        neutral=neutral,
    )


def _lead_others(
    map: Map,
    box: Box,
    params: Any,
    groups: PeriodicGroups,
    begun: Int[np.ndarray, "of_groups"],
    known: Attractors,
    follow: int,
) -> None:
    """Find the attractor of each group that is not in `begun`, and write it into `known`."""
    others = _first_cells(box, groups, begun)
    if not others.size:
        return
    owner = attractor_owners(box, known.cells)
    most = _SHARED * box.size // others.size
    for part in np.array_split(others, 1 + others.size // _PART):
        ends, _ = orbit_ends(map, box, params, owner, box.centre(part), follow=follow, most=most)
        known.of_group[groups.group[part]] = ends


def _first_cells(
    box: Box, groups: PeriodicGroups, skipped: Int[np.ndarray, "_"]
) -> Int[np.ndarray, "others"]:
    """Return the lowest-numbered cell of each group except `skipped`, in the order of groups."""
    other = np.ones(int(groups.count), bool)
    other[skipped] = False
    cells, highest = [np.zeros(0, np.int32)], -1
    for part in slices(box.size):
        on = np.flatnonzero(groups.step[part] == 0)
        number = np.maximum.accumulate(np.append(highest, groups.group[part][on]))
        new, highest = np.diff(number) > 0, number[-1]
        cells.append((part.start + on[new][other[number[1:][new]]]).astype(np.int32))
    return np.concatenate(cells)


def _orbits(
    map: Map, box: Box, params: Any, member: np.ndarray, start: np.ndarray, settle: int
) -> Float[np.ndarray, "starts window axes"]:
    """Return `_WINDOW` successive points of the orbit of each start, after `settle` mappings."""
    return padded(lambda *rows: _orbits_of(map, box, params, *rows, settle), (member, start))


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _orbits_of(map: Map, box: Box, params: Any, member: Any, start: Any, settle: Any) -> Any:
    # A flow is observed at every step, so that two orbits on one cycle are merged; and in uneven
    # steps, because a cycle of n even steps would be observed at n points only.
    parts = jnp.asarray(0.5 + np.arange(_WINDOW) * _GOLDEN % 1, start.dtype)

    def orbit(member, x):  # type: ignore[no-untyped-def]
        own = params_of(params, member)

        def step(k, state):  # type: ignore[no-untyped-def]
            y, window = state
            looked, place = k >= settle, jnp.maximum(k - settle, 0)
            if isinstance(map, Flow):
                usual = max(map.usual, _LEAST_STEPS)
                steps, part = jnp.where(looked, 1, usual), jnp.where(looked, parts[place], 1)
                y = map.ahead(y, own, steps, part)
            else:
                y = map(y, own)
            y = box.wrapped(y)
            # Points before the window overwrite its first place.
            return y, window.at[place].set(y)

        window = jnp.zeros((_WINDOW, x.size), x.dtype)
        return jax.lax.fori_loop(0, settle + _WINDOW, step, (x, window))[1]

    return jax.vmap(orbit)(member, start)
