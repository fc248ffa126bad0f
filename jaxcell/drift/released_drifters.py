"""A release: simulated drifters from one place or from cells, tick by tick, and what they meet."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ..base.shown import Shown
from ..mapping import Chain, ChainSequence
from ..mapping.sequence import push_on_host
from .advection import drifted, longest_step
from .beaches import beaching, coast
from .drift_step import METHODS
from .flow import Flow
from .maps import drift_map, refined
from .positions import on_the_grid
from .water import Water, square


# The longest time in seconds between two looks at where drifters are, and a day.
_TICK, DAY = 3600.0, 86_400.0


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
    cell = water.cell(*place)
    middle = on_the_grid(water, *np.array(place, float)[:, None])[0].T
    side = water.sides[:, [cell]]
    kept = np.zeros((2, 0))
    while kept.shape[1] < count:
        off = random.uniform(-0.5, 0.5, (2, count))
        if radius is not None:
            off = 2 * radius * off[:, np.hypot(*off) <= 0.5] / side
        points = middle + off
        at, _ = water.at(*square(*points))
        wet = (at >= 0) & (water.piece[at] == water.piece[cell])
        kept = np.concatenate([kept, points[:, wet]], axis=1)
    return kept[:, :count]


def points_in(
    random: np.random.Generator, water: Water, cells: Bool[np.ndarray, "cells"], count: int
) -> Float[np.ndarray, "2 count"]:
    """Draw points in some cells, uniformly by area, in columns and rows of the grid."""
    area = water.sides.prod(axis=0) * cells
    chosen = random.choice(water.cells, count, p=area / area.sum())
    off = random.uniform(-0.5, 0.5, (2, count))
    return np.stack([water.column[chosen], water.row[chosen]]) + off


@dataclasses.dataclass(frozen=True, eq=False)
class Release(Shown):
    """Simulated drifters at some times after their release, and their first arrivals."""

    x: Float[np.ndarray, "times drifters"]
    "The column of each drifter. Drifters stay where they left the map or stranded."
    y: Float[np.ndarray, "times drifters"]
    cell: Int[np.ndarray, "times drifters"]
    "The cell of each drifter, which for a stranded one is at its beach; -1 off the map."
    stranded: Bool[np.ndarray, "times drifters"]
    reached: Float[np.ndarray, "targets drifters"]
    "Seconds until each drifter is first in a target; infinite if it never is."
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
    targets: Bool[np.ndarray, "targets cells"],
    *,
    afloat: float = math.inf,
    **options: Any,
) -> Release:
    """Simulate drifters, and keep where they are at some times and when they arrive.

    **Arguments:**

    - `water`, `flow`: the cells, and the flow of the same layer at all records.
    - `points`: the columns and rows of the release.
    - `start`: the time of the release, in seconds as in `Flow.time`.
    - `times`: the times after the release that are kept, in seconds, ascending.
    - `targets`: masks of the cells whose first visits are kept.
    - `afloat`, `stranded`: half-lives in seconds at a coast and on a beach, as for
        [`beaching`][jaxcell.drift.beaching].
    - `seed`: the seed of diffusion and of beaching.
    - `say`: a function that is called with the progress.
    """
    looks = follow_drifters(water, flow, points, start, times, afloat=afloat, **options)
    look, at_coast = next(looks), np.append(coast(water), False)
    masks = np.pad(targets, ((0, 0), (0, 1)))
    reached = np.where(masks[:, look.cell], 0.0, np.inf)
    shore, kept = np.where(at_coast[look.cell], look.cell, -1), []
    for look in looks:
        reached = np.minimum(reached, np.where(masks[:, look.cell], look.seconds, np.inf))
        shore = np.where((shore < 0) & at_coast[look.cell], look.cell, shore)
        if look.seconds in times:
            kept.append(look)
    if water.coast == "strand" or np.isfinite(afloat):
        shore = np.where(look.stranded, look.cell, -1)
    _, x, y, cell, ashore = map(np.stack, zip(*kept, strict=True))
    return Release(x, y, cell, ashore, reached, shore)


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
    start: float,
    times: Sequence[float],
    halves: dict[str, float],
) -> Float[np.ndarray, "times cells"]:
    """Push a release through a map of cells from each time to the next."""
    pushed, cell = [], np.zeros(0, int)
    longest, at_coast = longest_step(water, flow), coast(water)
    strands = np.isfinite(halves["afloat"])
    if strands:
        cell = np.flatnonzero(at_coast)
        share = np.append(share, np.zeros(cell.size))
    for begin, end in itertools.pairwise([0.0, *times]):
        length = end - begin
        step = refined(METHODS["drifters"], length, length / longest)
        chain: Chain | ChainSequence = drift_map(water, flow, step, start=start + begin)
        if strands:
            chain, cell = beaching(chain, at_coast, length, **halves)
        share = push_on_host(chain, share, 1)
        pushed.append(share[: water.cells] + np.bincount(
            cell, share[water.cells :], water.cells))  # fmt: skip
    return np.stack(pushed)
