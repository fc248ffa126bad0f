"""A release: simulated drifters from one place or from cells, tick by tick, and what they meet."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence

import jax
import numpy as np
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


# The longest time in seconds between two looks at where drifters are.
_TICK = 3600.0


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


def release_drifters(
    water: Water,
    flow: Flow,
    points: Float[np.ndarray, "2 drifters"],
    start: float,
    times: Sequence[float],
    targets: Bool[np.ndarray, "targets cells"],
    *,
    afloat: float = math.inf,
    stranded: float = math.inf,
    seed: int = 0,
    say: Callable[..., None] = lambda *_: None,
) -> Release:
    """Simulate drifters with the Runge-Kutta method, and look each hour where they are.

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
    random, longest = np.random.default_rng(seed), longest_step(water, flow)
    x, y = points
    key, at_coast = jax.random.key(seed), np.append(coast(water), False)
    origin = water.at(*square(x, y))[0]
    cell, ashore = origin, np.zeros(x.size, bool)
    strands, masks = water.coast == "strand", np.pad(targets, ((0, 0), (0, 1)))
    reached = np.where(masks[:, cell], 0.0, np.inf)
    shore, kept = np.where(at_coast[cell], cell, -1), []
    edges = [0.0, *times]
    for number, (since, until) in enumerate(itertools.pairwise(edges)):
        say("following drifters", number, len(times))
        ticks = np.linspace(since, until, max(1, math.ceil((until - since) / _TICK - 1e-9)) + 1)
        for now, after in itertools.pairwise(ticks.tolist()):
            key, drawn = jax.random.split(key)
            to = drifted(water, flow, x, y, start + now, start + after, longest, drawn)
            x, y = np.where(ashore, (x, y), to)
            if strands:
                ashore |= water.at(*square(x, y))[1]
            cell = water.landing(x[None], y[None], origin=origin, exits=True)[0]
            if strands:
                beached = water.landing(x[None, ashore], y[None, ashore], origin=origin[ashore])
                cell[ashore] = beached[0]
            sinks, floats = (
                random.random(x.size) < -math.expm1(-math.log(2) * (after - now) / half)
                for half in (afloat, stranded)
            )
            ashore = np.where(ashore, strands | ~floats, at_coast[cell] & sinks)
            reached = np.minimum(reached, np.where(masks[:, cell], after, np.inf))
            shore = np.where((shore < 0) & at_coast[cell], cell, shore)
        kept.append((x, y, cell, ashore))
    if strands or np.isfinite(afloat):
        shore = np.where(ashore, cell, -1)
    columns, rows, cells, beached = map(np.stack, zip(*kept, strict=True))
    return Release(columns, rows, cells, beached, reached, shore)


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
