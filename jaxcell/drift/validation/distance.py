"""The distance of a drift map from simulated drifters in the current itself."""

import dataclasses
import math
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float, Int

from ...mapping import Chain, ChainSequence
from ...mapping.section import bucket
from ...mapping.sequence import as_sequence
from ..advection import carried
from ..flow import Flow, crossing_time, steps_in
from ..maps import diffused_cells, drift_maps
from ..step import DriftStep
from ..water import Water, on_grid
from .drifters import diffuse, nearest_square, total_variation


HOURS = (6.0, 24.0)
"""The times at which maps are compared with drifters, in hours."""
# A comparison is at about one of these times if it is off by less than this part of it.
_NEAR = 0.34
FAR = 0.2
"""The total variation above which a map is far from drifters."""
# Steps in which diffusion spreads drifters over more cells are not tried.
_MAX_DIFFUSED = 2.0
# Runge-Kutta steps in one call.
_SUBSTEPS = 4


@dataclasses.dataclass(frozen=True)
class Sampling:
    """The points at which drifters begin: a square grid in every cell, or in every cell of a
    sample."""

    drifters: int = 1_000_000
    "The largest number of drifters."
    least: int = 3
    "The least number of points along each side of a cell; if needed, fewer cells are sampled."
    most: int = 6
    "The largest number of points along each side of a cell; twice as many if drifters diffuse."
    part: int = 64
    "A sample has whole square parts of the grid, of this side in cells."


SAMPLING = Sampling()
"""The default of [`distances`][jaxcell.drift.distances]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Distance:
    """The distance of a map from drifters that began uniformly in the cells."""

    hours: Float[np.ndarray, "times"]
    "The times of the whole numbers of steps that are nearest to 6 and 24 hours."
    total_variation: Float[np.ndarray, "times"]
    "The share of the drifters that the map has in a wrong cell, 0 to 1."
    drifters_left: Float[np.ndarray, "times"]
    "The share of the drifters that left the grid."
    map_left: Float[np.ndarray, "times"]
    "The share that left the grid by the map."
    cells: int
    "Number of cells in which drifters began: all, or a sample of more than 111,111."

    @property
    def near(self) -> tuple[bool, ...]:
        """True for the times near 6 and 24 hours; the first time of a long step is later."""
        return tuple((np.abs(self.hours / HOURS - 1) < _NEAR).tolist())

    @property
    def worst(self) -> float:
        """The largest total variation."""
        return float(self.total_variation.max())

    @property
    def worst_hours(self) -> float:
        """The time of the largest total variation, in hours."""
        return float(self.hours[self.total_variation.argmax()])


def distances(
    water: Water,
    flow: Flow,
    maps: Sequence[tuple[Chain | ChainSequence, float]],
    sampling: Sampling | None = None,
) -> tuple[Distance, ...]:
    """Compare maps with drifters in the flow itself, as it changes with time.

    Drifters begin on an even grid of points in every cell, and move by the Runge-Kutta method and
    the random walk of the flow's diffusivity. By default 9 to 36 begin in each cell, up to 144 if
    they diffuse. Of more than 111,111 cells, some 100,000 in separate square parts of the grid are
    sampled.

    **Arguments:**

    - `water`, `flow`: as for [`jaxcell.drift.drift_map`][], with all records.
    - `maps`: chains over the cells, or sequences of chains, each with its seconds per step.
    - `sampling`: the points at which drifters begin.

    **Returns:** the [`Distance`][] of each map.

    The surface of the bundled sea at its first record. The rules of the dissertation spread
    drifters over the grid more than the water does:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> steps = [drift.METHODS[name].lasting(7200.0) for name in ("source", "drifters")]
        >>> maps = [(drift.drift_map(water, flow, step), 7200.0) for step in steps]
        >>> source, drifters = drift.distances(water, flow, maps)
        >>> source.total_variation.round(2).tolist(), drifters.total_variation.round(2).tolist()
        ([0.96, 1.0], [0.09, 0.13])
    """
    sampling = sampling or SAMPLING
    counts = [[steps_in(3600 * hour, seconds) for hour in HOURS] for _, seconds in maps]
    times = sorted(
        {n * seconds for steps, (_, seconds) in zip(counts, maps, strict=True) for n in steps}
    )
    begin = _begin(water, sampling)
    share = _shares(water, flow, begin, times, sampling)
    results = []
    for steps, (chain, seconds) in zip(counts, maps, strict=True):
        later = as_sequence(chain).pushed(begin / begin.sum(), steps[-1])
        kept = {count: cells for count, cells in enumerate(later) if count in steps}
        pairs = [(kept[count], share[count * seconds]) for count in steps]
        variation = np.array([total_variation(*pair) for pair in pairs])
        map_left, drifters_left = (
            1 - np.array([[cells.sum() for cells in pair] for pair in pairs]).T
        )
        hours = np.array(steps) * seconds / 3600
        cells = int(begin.sum())
        results.append(Distance(hours, variation, drifters_left, map_left.clip(0, 1), cells))
    return tuple(results)


def nearest_step(waters: Sequence[Water], flows: Sequence[Flow], step: DriftStep) -> DriftStep:
    """Choose the duration of a step so that the maps of layers are nearest to drifters.

    In every step the grid spreads drifters by up to a cell, which favours few steps; but the
    current changes during a long step. Of 1, 2, 4 and 8 times the [`jaxcell.drift.crossing_time`][]
    of the slowest layer, up to a day, the choice has the least total variation. Maps are made of a
    periodic flow as it changes, by the nearest durations that fit its period, and else of the mean
    of its records. Of more than 100,000 cells at all phases nothing is tried, and the duration is
    twice the crossing time.

    **Arguments:**

    - `waters`, `flows`: of each layer, with all records.
    - `step`: the rules of the step; its duration has no effect.

    **Returns:** the step with its duration.

    The surface of the bundled sea at its first record, which is steady:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> step = drift.nearest_step([water], [flow], drift.METHODS["drifters"])
        >>> round(step.duration / drift.crossing_time(water, flow))
        4
    """
    return nearest_maps(waters, flows, [mapped(flow) for flow in flows], step)[0]


def mapped(flow: Flow) -> Flow:
    """Return the flow that maps are made of: a periodic flow itself, and else its mean."""
    return flow if flow.period is not None else flow.mean()


def nearest_maps(
    waters: Sequence[Water],
    flows: Sequence[Flow],
    by: Sequence[Flow],
    step: DriftStep,
    most_cells: int = 100_000,
) -> tuple[DriftStep, list[tuple[Chain | ChainSequence, Distance]] | None]:
    """Choose the step as [`nearest_step`][], and return the map of each layer and its distance.

    **Arguments:**

    - `by`: the flow of each layer that its map is made of; drifters go with the flow in `flows`.
    - `most_cells`: the cells at all phases above which nothing is tried, and `None` returned.
    """
    crossing = max(map(crossing_time, waters, by))
    longest = min(3600 * HOURS[-1], *map(longest_duration, waters, by))
    durations = {
        by[0].fitted(factor * crossing)
        for factor in (1, 2, 4, 8)
        if factor == 1 or factor * crossing <= longest
    }
    cells = sum(water.cells for water in waters)
    tried = [
        step.lasting(seconds)
        for seconds in sorted(durations)
        if cells * by[0].phases(seconds) <= most_cells
    ]
    if not tried:
        return step.lasting(by[0].fitted(2 * crossing)), None
    layers = []
    for water, flow, mean in zip(waters, flows, by, strict=True):
        maps = [(drift_maps(water, mean, one), float(one.duration or 0)) for one in tried]
        chains = [chain for chain, _ in maps]
        layers.append([*zip(chains, distances(water, flow, maps), strict=True)])
    worst = [
        max(distance.worst for _, distance in of_step) for of_step in zip(*layers, strict=True)
    ]
    best = int(np.argmin(worst))
    return tried[best], [layer[best] for layer in layers]


def longest_duration(water: Water, flow: Flow) -> float:
    """Return the longest duration to try, in seconds, so that diffusion does not fill the map."""
    in_a_second = float(diffused_cells(water, flow, 1.0).max())
    return (_MAX_DIFFUSED / in_a_second) ** 2 if in_a_second else math.inf


def _begin(water: Water, sampling: Sampling) -> Float[np.ndarray, "cells"]:
    """Return 1 for the cells in which drifters begin, and 0 for others."""
    every = -(-water.cells * sampling.least**2 // sampling.drifters)
    # Along every diagonal, one in `every` square parts.
    part = water.row // sampling.part + water.column // sampling.part
    return (part % every == 0).astype(float)


def _shares(
    water: Water,
    flow: Flow,
    begin: Float[np.ndarray, "cells"],
    times: Sequence[float],
    sampling: Sampling,
) -> dict[float, Float[np.ndarray, "cells"]]:
    """Simulate drifters, and return the share in each cell at each time."""
    cells = np.flatnonzero(begin)
    most = 2 * sampling.most if flow.diffusivity else sampling.most
    points = min(most, max(sampling.least, math.isqrt(sampling.drifters // cells.size)))
    places = (np.arange(points) + 0.5) / points - 0.5
    right, up = (np.tile(offset.ravel(), cells.size) for offset in np.meshgrid(places, places))
    origin = np.repeat(cells, points**2)
    # Layers of one grid differ in their cells; with rounded sizes one program serves all.
    drifters, size = origin.size, bucket(origin.size)
    origin = np.resize(origin, size)
    x, y = water.column[origin] + np.resize(right, size), water.row[origin] + np.resize(up, size)
    # A substep is at most half a cell long, and not longer than from one record to the next.
    between = np.diff(np.asarray(flow.time)).min(initial=np.inf)
    longest, shares, now = _SUBSTEPS * min(crossing_time(water, flow) / 2, between), {}, 0.0
    sides, wet, gone = np.stack([water.dx, water.dy]), ~water.closed, water.gone
    key = jax.random.key(0)
    for time in times:
        moves = math.ceil((time - now) / longest)
        length = (time - now) / moves
        for start in np.linspace(now, time, moves, endpoint=False).tolist():
            on = on_grid(water.number.shape, water.wraps, x, y)
            on &= ~gone[nearest_square(gone.shape, water.wraps, x, y)]
            after = carried(flow, x, y, length, start, "rk4", _SUBSTEPS)
            if flow.diffusivity:
                key, drawn = jax.random.split(key)
                after = diffuse(drawn, flow, sides, wet, *after, length)
            x, y = (np.where(on, moved, here) for moved, here in zip(after, (x, y), strict=True))
        now = time
        cell: Int[np.ndarray, drifters] = water.landing(
            x[None, :drifters], y[None, :drifters], origin=origin[:drifters], exits=True
        )[0]
        shares[time] = np.bincount(cell[cell >= 0], minlength=water.cells) / cell.size
    return shares
