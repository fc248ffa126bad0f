"""A release: simulated drifters from one place or from cells, tick by tick, and what they meet."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np
import scipy.sparse
import shapely
from jaxtyping import Bool, Float, Int

from ..base.process import stoppable
from ..base.shown import Shown
from ..currents.sphere import wrapped
from ..mapping import Chain
from ..mapping.sequence import push_on_host
from .advection import drifted, longest_step
from .beaches import beaching, coast
from .drift_step import METHODS
from .flow import Flow
from .maps import drift_map, refined
from .positions import in_degrees, on_the_grid
from .regions import TURNS, within
from .water import Water, square


# The longest time in seconds between two looks at where drifters are, and a day.
_TICK, DAY = 3600.0, 86_400.0
# The parts of the way between two looks at which a drifter may be at a coast.
_PARTS = (0.25, 0.5, 0.75, 1.0)
# The number of draws after which no water is found within polygons.
_TRIES = 200


Area: TypeAlias = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""A function that marks the points, in columns and rows of the grid, that are in an area."""


def area_around(water: Water, place: tuple[float, float], radius: float | None = None) -> Area:
    """Return the disc around a place in degrees, or without a radius a square as large as a cell.

    **Raises:** `ValueError` if the place is not in the water.
    """
    cell = water.cell(*place)
    middle = on_the_grid(water, *np.array(place, float)[:, None])[0].T
    side = water.sides[:, [cell]]

    def inside(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        off = np.stack([x, y]) - middle
        if water.wraps:
            turn = water.number.shape[1]
            off[0] = (off[0] + turn / 2) % turn - turn / 2
        if radius is None:
            return (np.abs(off) <= 0.5).all(axis=0)
        return np.hypot(*(off * side)) <= radius

    return inside


def area_of(water: Water, polygons: np.ndarray) -> Area:
    """Return the area of polygons in degrees."""
    whole = shapely.union_all(polygons)
    return lambda x, y: within(whole, *in_degrees(water, x, y))


def points_around(
    random: np.random.Generator,
    water: Water,
    place: tuple[float, float],
    count: int,
    radius: float | None = None,
) -> Float[np.ndarray, "2 count"]:
    """Draw points in the water around a place, in columns and rows of the grid.

    **Arguments:**

    - `random`, `water`, `count`: the generator, the cells, and the number of points.
    - `place`: longitude and latitude in degrees.
    - `radius`: the radius in metres of the disc of the points; by default they are in a square of
        the size of a cell.

    **Raises:** `ValueError` if the place is not in the water.
    """
    cell, inside = water.cell(*place), area_around(water, place, radius)
    middle = on_the_grid(water, *np.array(place, float)[:, None])[0].T
    width = 1.0 if radius is None else 2 * radius / water.sides[:, [cell]]
    kept = np.zeros((2, 0))
    while kept.shape[1] < count:
        points = middle + width * random.uniform(-0.5, 0.5, (2, count))
        at, _ = water.at(*square(*points))
        wet = (at >= 0) & (water.piece[at] == water.piece[cell]) & inside(*points)
        kept = np.concatenate([kept, points[:, wet]], axis=1)
    return kept[:, :count]


def points_in(
    random: np.random.Generator, water: Water, polygons: np.ndarray, count: int
) -> Float[np.ndarray, "2 count"]:
    """Draw points in the water of polygons in degrees, uniformly by area, as columns and rows.

    **Raises:** `ValueError` if hardly a point of the polygons is in the water.
    """
    parts = shapely.get_parts(shapely.union_all(polygons))
    west, south, east, north = shapely.bounds(parts).T
    low, high = np.sin(np.radians([south, north]))
    area, kept = (east - west) * (high - low), np.zeros((2, 0))
    for _ in range(_TRIES):
        part = random.choice(parts.size, count, p=area / area.sum())
        lon = random.uniform(west[part], east[part])
        lat = np.degrees(np.arcsin(random.uniform(low[part], high[part])))
        inside = shapely.contains_xy(parts[part], lon, lat)
        points = on_the_grid(water, lon[inside], lat[inside])[0].T
        kept = np.append(kept, points[:, water.at(*square(*points))[0] >= 0], axis=1)
        if kept.shape[1] >= count:
            return kept[:, :count]
    raise ValueError(f"no water of {water.depth:g} m is within its polygons")


@dataclasses.dataclass(frozen=True, eq=False)
class Release(Shown):
    """Simulated drifters at some times after their release, and their first arrivals."""

    x: Float[np.ndarray, "times drifters"]
    "The column of each drifter. Drifters stay where they left the map or stranded."
    y: Float[np.ndarray, "times drifters"]
    cell: Int[np.ndarray, "times drifters"]
    "The cell of each drifter, which for a stranded one is at its beach; -1 off the map."
    stranded: Bool[np.ndarray, "times drifters"]
    reached: Float[np.ndarray, "places drifters"]
    "Seconds until each drifter is first in each region or, last, at a coast; infinite for never."
    shore: Int[np.ndarray, "drifters"]
    "The cell where a drifter has stranded or, if none strands, was first at a coast; -1 for none."


class Look(NamedTuple):
    """The places of drifters at a time; they stay where they left the map or stranded."""

    seconds: float
    x: Float[np.ndarray, "drifters"]
    y: Float[np.ndarray, "drifters"]
    cell: Int[np.ndarray, "drifters"]
    stranded: Bool[np.ndarray, "drifters"]


def follow_drifters(
    water: Water,
    flow: Flow,
    points: Float[np.ndarray, "2 drifters"],
    start: float,
    times: Sequence[float],
    *,
    tick: float = _TICK,
    afloat: float = math.inf,
    stranded: float = math.inf,
    seed: int = 0,
    say: Callable[..., None] = lambda *_: None,
) -> Iterator[Look]:
    """Simulate drifters with the Runge-Kutta method, and look where they are, first at the release.

    The arguments are those of [`release_drifters`][]. Looks are at most `tick` seconds apart.
    """
    random, longest = np.random.default_rng(seed), longest_step(water, flow)
    x, y = points
    key, at_coast = jax.random.key(seed), np.append(coast(water), False)
    origin = water.at(*square(x, y))[0]
    ashore, strands = np.zeros(x.size, bool), water.coast == "strand"
    yield Look(0.0, x, y, origin, ashore)
    for number, (since, until) in enumerate(itertools.pairwise([0.0, *times])):
        say("following drifters", number, len(times))
        ticks = np.linspace(since, until, max(1, math.ceil((until - since) / tick - 1e-9)) + 1)
        for now, after in itertools.pairwise(ticks.tolist()):
            key, drawn = jax.random.split(key)
            to = drifted(water, flow, x, y, start + now, start + after, longest, drawn)
            x, y = np.where(ashore, (x, y), to)
            if strands:
                ashore = ashore | water.at(*square(x, y))[1]
            cell = water.landing(x[None], y[None], origin=origin, exits=True)[0]
            if strands:
                beached = water.landing(x[None, ashore], y[None, ashore], origin=origin[ashore])
                cell[ashore] = beached[0]
            sinks, floats = (
                random.random(x.size) < -math.expm1(-math.log(2) * (after - now) / half)
                for half in (afloat, stranded)
            )
            ashore = np.where(ashore, strands | ~floats, at_coast[cell] & sinks)
            yield Look(after, x, y, cell, ashore)


def release_drifters(
    water: Water,
    flow: Flow,
    points: Float[np.ndarray, "2 drifters"],
    start: float,
    times: Sequence[float],
    regions: Sequence[shapely.Geometry] | np.ndarray = (),
    *,
    afloat: float = math.inf,
    **options: Any,
) -> Release:
    """Simulate drifters, and keep where they are at some times and when they arrive.

    Between two looks a drifter goes straight, by half a cell on average or less.

    **Arguments:**

    - `water`, `flow`: the cells, and the flow of the same layer at all records.
    - `points`: the columns and rows of the release.
    - `start`: the time of the release, in seconds as in `Flow.time`.
    - `times`: the times after the release that are kept, in seconds, ascending.
    - `regions`: polygons in degrees whose first visits are kept, beside those of cells at a coast.
    - `afloat`, `stranded`: half-lives in seconds at a coast and on a beach, as for
        [`beaching`][jaxcell.drift.beaching].
    - `seed`: the seed of diffusion and of beaching.
    - `say`: a function that is called with the progress.
    """
    tick = tick_of(water, flow)
    looks = follow_drifters(water, flow, points, start, times, tick=tick, afloat=afloat, **options)
    return met_in(water, looks, times, regions, water.coast == "strand" or np.isfinite(afloat))


def tick_of(water: Water, flow: Flow) -> float:
    """Return the longest time in seconds between two looks at which arrivals are seen."""
    tick = min(_TICK, longest_step(water, flow))
    if flow.diffusivity:
        tick = min(tick, float(water.sides.min()) ** 2 / (32 * flow.diffusivity))
    return tick


def met_in(
    water: Water,
    looks: Iterator[Look],
    times: Sequence[float],
    regions: Sequence[shapely.Geometry] | np.ndarray,
    strands: bool | np.bool_,
) -> Release:
    """Keep where drifters are at some times and when they first arrive, from looks at them.

    If drifters strand, the shore of a drifter is the cell where it has stranded at the end. After
    Ctrl-C there are only the times until then.
    """
    first, at_coast = next(looks), np.append(coast(water), False)
    shapely.prepare(regions)
    reached, last = np.full((len(regions) + 1, first.cell.size), np.inf), first
    kept: list[Look] = []
    shore, place = np.full(first.cell.size, -1), np.stack(in_degrees(water, first.x, first.y))
    with stoppable(lambda: kept):
        for look in itertools.chain([first], looks):
            length, begin = look.seconds - last.seconds, place
            place = np.stack(in_degrees(water, look.x, look.y))
            for when, region in zip(reached, regions, strict=False):
                new = np.flatnonzero(np.isinf(when))
                before = _first_within(region, begin[:, new], place[:, new])
                met = np.isfinite(before)
                when[new[met]] = last.seconds + length * before[met]
            for part in _PARTS:
                x, y = last.x + part * (look.x - last.x), last.y + part * (look.y - last.y)
                cell = look.cell if part == 1 else water.at(*square(x, y))[0]
                ashore = (shore < 0) & at_coast[cell]
                shore[ashore], reached[-1, ashore] = cell[ashore], last.seconds + part * length
            if np.isclose(look.seconds, times, rtol=1e-9).any():
                kept.append(look)
            last = look
    end = kept[-1]
    reached[reached > end.seconds] = np.inf
    shore[np.isinf(reached[-1])] = -1
    if strands:
        shore = np.where(end.stranded, end.cell, -1)
    _, x, y, cell, stranded = map(np.stack, zip(*kept, strict=True))
    return Release(x, y, cell, stranded, reached, shore)


def _first_within(
    region: shapely.Geometry, begin: Float[np.ndarray, "2 ways"], end: Float[np.ndarray, "2 ways"]
) -> Float[np.ndarray, "ways"]:
    """Compute the part of each straight way that is before a polygon; infinite if it meets none."""
    part, (west, south, east, north) = np.full(begin.shape[1], np.inf), region.bounds
    along = np.stack([wrapped(end[0] - begin[0]), end[1] - begin[1]])
    for turn in TURNS:
        turned = begin + np.array([[turn], [0.0]])
        ways = np.stack([turned, turned + along])
        low, high = ways.min(axis=0), ways.max(axis=0)
        near = (high[0] >= west) & (low[0] <= east) & (high[1] >= south) & (low[1] <= north)
        ways = ways[..., near].transpose(2, 0, 1)
        inside = shapely.contains_xy(region, ways[:, 0])
        lines = shapely.linestrings(ways)
        length = shapely.length(lines)
        meets = ~inside & (length > 0) & shapely.intersects(region, lines)
        before = np.where(inside, 0.0, np.inf)
        met = shapely.intersection(lines[meets], region)
        before[meets] = shapely.distance(shapely.points(ways[meets, 0]), met) / length[meets]
        part[near] = np.minimum(part[near], before)
    return part


def visit_cells(
    water: Water,
    flow: Flow,
    points: Float[np.ndarray, "2 drifters"],
    start: float,
    seconds: float,
    **options: Any,
) -> tuple[scipy.sparse.csr_array, Look]:
    """Find the cells that each drifter visits until some seconds after the release.

    The arguments are those of [`release_drifters`][]. Between two looks a drifter moves by at most
    half a cell. **Returns:** a matrix of 1 for the cells (columns) that a drifter (row) visits; and
    where drifters are at the end.
    """
    tick = min(_TICK, 0.5 / max(float(np.abs(flow.rate).max()), 0.5 / _TICK))
    days = np.append(np.arange(DAY, seconds, DAY), seconds).tolist()
    looks = follow_drifters(water, flow, points, start, days, tick=tick, **options)
    last = next(looks)
    shape = last.cell.size, water.cells
    seen = [np.arange(last.cell.size) * water.cells + last.cell]
    for look in looks:
        new = np.flatnonzero((look.cell != last.cell) & (look.cell >= 0))
        seen.append(new * water.cells + look.cell[new])
        last = look
    drifter, cell = np.divmod(np.unique(np.concatenate(seen)), water.cells)
    return scipy.sparse.csr_array((np.ones(cell.size), (drifter, cell)), shape=shape), last


def push_release(
    water: Water,
    flow: Flow,
    share: Float[np.ndarray, "cells"],
    starts: Sequence[float],
    times: Sequence[float],
    halves: dict[str, float],
    say: Callable[..., None] = lambda *_: None,
) -> Float[np.ndarray, "times cells"]:
    """Push a release through a map of cells from each time to the next; mean over its starts."""
    steps = sorted(
        (start + begin, start + end, time, release)
        for release, start in enumerate(starts)
        for time, (begin, end) in enumerate(itertools.pairwise([0.0, *times]))
    )
    pushed, shares = np.zeros((len(times), water.cells)), dict.fromkeys(range(len(starts)), share)
    count = len({step[:2] for step in steps})
    groups = itertools.groupby(steps, key=lambda step: step[:2])
    for number, ((begin, end), releases) in enumerate(groups):
        say("mapping the release on cells", number, count)
        chain, cell = chain_between(water, flow, begin, end, halves)
        for *_, time, release in releases:
            before = shares[release]
            before = np.append(before, np.zeros(chain.cells - before.size))
            shares[release] = push_on_host(chain, before, 1)
            pushed[time] += on_cells(water, shares[release], cell) / len(starts)
    return pushed


def chain_between(
    water: Water, flow: Flow, begin: float, end: float, halves: dict[str, float]
) -> tuple[Chain, Int[np.ndarray, "beaches"]]:
    """Map cells, and beaches if drifters strand, from one time to another.

    Returns the chain, and the cell of each beach.
    """
    step = refined(METHODS["drifters"], end - begin, (end - begin) / longest_step(water, flow))
    chain = drift_map(water, flow, step, start=begin)
    if not np.isfinite(halves["afloat"]):
        return chain, np.zeros(0, np.int32)
    with_beaches: Any = beaching(chain, coast(water), end - begin, **halves)
    return with_beaches


def on_cells(
    water: Water, share: Float[np.ndarray, "states"], cell: Int[np.ndarray, "beaches"]
) -> Float[np.ndarray, "cells"]:
    """Add what is on beaches to the cells of these beaches."""
    return share[: water.cells] + np.bincount(cell, share[water.cells :], water.cells)


def likely(share: Float[np.ndarray, "cells"], part: float) -> Bool[np.ndarray, "cells"]:
    """Mark the fewest cells that together have a part of the drifters on the map."""
    order = np.argsort(-share, kind="stable")
    before = np.cumsum(share[order]) - share[order]
    chosen = np.zeros(share.size, bool)
    chosen[order] = (before < part * share.sum()) & (share[order] > 0)
    return chosen
