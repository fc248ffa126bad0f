"""How far a drift map is from drifters in the current itself."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from ...mapping import Chain, ChainSequence
from ...mapping.section import bucket
from ...mapping.sequence import as_sequence
from ..advection import carried
from ..chains import diffused_cells, drift_maps, phases
from ..flow import Flow, crossing_time, steps_in
from ..water import Water, on_grid
from .drifters import diffuse, total_variation


HOURS = (6.0, 24.0)
"""When drifters and maps are compared, in hours."""
# A time that is off by less than this part of one of these is about that.
_NEAR = 0.34
FAR = 0.2
"""A map with a larger total variation is far from drifters."""
# So many drifters are followed, from each cell at least as many as so many on either axis, without
# which their number in a cell says little, and at most; twice that of those that diffuse, which
# differ by chance.
_DRIFTERS = 1_000_000
_LEAST_POINTS, _POINTS = 3, 6
_MAX_FOR_TRIALS = 100_000
# No longer steps are tried than in which diffusion spreads drifters over so many cells.
_MAX_DIFFUSED = 2.0
# Of more cells than can have so many points a sample has them, in square parts of that side.
_PART = 64
_DAY = 3600 * HOURS[-1]
# Runge-Kutta steps in one call.
_STEPS = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Distance:
    """How far a map is from drifters that began everywhere alike."""

    hours: Float[np.ndarray, "times"]
    "When: after the whole numbers of steps that are nearest to 6 and 24 hours."
    total_variation: Float[np.ndarray, "times"]
    "The share of the drifters that the map has in a wrong cell, 0 to 1."
    drifters_left: Float[np.ndarray, "times"]
    "The share of them that left the grid."
    map_left: Float[np.ndarray, "times"]
    "That of the map."
    cells: int
    "Number of cells in which they began: all, or of more than 111,111 a sample."

    @property
    def near(self) -> tuple[bool, ...]:
        """Whether these are about 6 and 24 hours: of long steps the first is later."""
        return tuple((np.abs(self.hours / HOURS - 1) < _NEAR).tolist())

    @property
    def worst(self) -> float:
        """The largest total variation."""
        return float(self.total_variation.max())

    @property
    def worst_hours(self) -> float:
        """When it is the largest."""
        return float(self.hours[self.total_variation.argmax()])


def distances(
    water: Water, flow: Flow, maps: Sequence[tuple[Chain | ChainSequence, float]]
) -> tuple[Distance, ...]:
    """Compare maps with drifters in the flow itself, as it changes with time.

    Drifters begin at an even grid of points in every cell, 9 to 36 of them, or up to 144 where they
    diffuse, and are followed by the Runge-Kutta method and the random walk of the flow's
    diffusivity. Of more than 111,111 cells, they begin in some 100,000, which are square parts of
    the grid apart from each other; and so do the maps.

    **Arguments:**

    - `water`, `flow`: as for [`jaxcell.drift.drift_map`][], with all records.
    - `maps`: chains over the cells, or sequences of them, each with the seconds that a step takes.

    **Returns:** [`Distance`][] of each map.

    The surface of the bundled sea at its first record. The rules of the dissertation spread
    drifters over the grid more than the water does:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> maps = [
        ...     (drift.drift_map(water, flow, 7200.0, **drift.METHODS[name]), 7200.0)
        ...     for name in ("source", "drifters")
        ... ]
        >>> source, drifters = drift.distances(water, flow, maps)
        >>> source.total_variation.round(2).tolist(), drifters.total_variation.round(2).tolist()
        ([0.96, 1.0], [0.09, 0.13])
    """
    wanted = [[steps_in(3600 * hour, step) for hour in HOURS] for _, step in maps]
    times = sorted(
        {count * step for counts, (_, step) in zip(wanted, maps, strict=True) for count in counts}
    )
    begin = _begin(water)
    share = _shares(water, flow, begin, times)
    found = []
    for counts, (chain, step) in zip(wanted, maps, strict=True):
        later = as_sequence(chain).pushed(begin / begin.sum(), counts[-1])
        kept = {count: one for count, one in enumerate(later) if count in counts}
        of_map = [kept[count] for count in counts]
        of_drifters = [share[count * step] for count in counts]
        found.append(
            Distance(
                np.array(counts) * step / 3600,
                np.array(
                    [total_variation(*both) for both in zip(of_map, of_drifters, strict=True)]
                ),
                np.array([1 - one.sum() for one in of_drifters]),
                np.array([1 - one.sum() for one in of_map]).clip(0, 1),
                int(begin.sum()),
            )
        )
    return tuple(found)


def nearest_step(waters: Sequence[Water], flows: Sequence[Flow], **options: Any) -> float:
    """The duration of a step, in seconds, by which maps of layers are nearest to drifters.

    In every step the grid spreads drifters by up to a cell, so that few steps are better; and the
    current changes meanwhile. Of 1, 2, 4 and 8 times the [`jaxcell.drift.crossing_time`][] of the
    slowest layer, up to a day, it is the one whose maps have the least total variation. Maps are of
    a flow that repeats itself as it changes, by the nearest step that fits its period, and else of
    its mean. For more than 100,000 cells at all phases nothing is tried, and it is twice the
    crossing time.

    **Arguments:**

    - `waters`, `flows`: of each layer, with all records.
    - `options`: further ones of [`jaxcell.drift.drift_map`][].

    **Returns:** the duration.

    **Raises:** as [`jaxcell.drift.drift_map`][].

    The surface of the bundled sea at its first record, which is steady:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> step = drift.nearest_step([water], [flow], **drift.METHODS["drifters"])
        >>> round(step / drift.crossing_time(water, flow))
        4
    """
    return nearest_maps(waters, flows, [mapped(flow) for flow in flows], **options)[0]


def mapped(flow: Flow) -> Flow:
    """The flow that maps are made of: as it changes if it repeats, else its mean."""
    return flow if flow.period is not None else flow.mean()


def nearest_maps(
    waters: Sequence[Water], flows: Sequence[Flow], by: Sequence[Flow], **options: Any
) -> tuple[float, list[tuple[Chain | ChainSequence, Distance]] | None]:
    """[`nearest_step`][], with the map of each layer and its distance if they were made for it.

    **Arguments:**

    - `by`: the flow of each layer that its map is made of; drifters go with that in `flows`.
    """
    crossing = max(map(crossing_time, waters, by))
    longest = min(_DAY, *map(longest_step, waters, by))
    steps = {by[0].fitted(f * crossing) for f in (1, 2, 4, 8) if f == 1 or f * crossing <= longest}
    cells = sum(water.cells for water in waters)
    tried = [step for step in sorted(steps) if cells * phases(by[0], step) <= _MAX_FOR_TRIALS]
    if not tried:
        return by[0].fitted(2 * crossing), None
    found = []
    for water, flow, one in zip(waters, flows, by, strict=True):
        maps = [(drift_maps(water, one, step, **options), step) for step in tried]
        chains = [chain for chain, _ in maps]
        found.append([*zip(chains, distances(water, flow, maps), strict=True)])
    worst = [max(one.worst for _, one in layers) for layers in zip(*found, strict=True)]
    best = int(np.argmin(worst))
    return tried[best], [layer[best] for layer in found]


def longest_step(water: Water, flow: Flow) -> float:
    """The longest duration that is tried, in seconds: diffusion may fill the map in longer ones."""
    in_a_second = float(diffused_cells(water, flow, 1.0).max())
    return (_MAX_DIFFUSED / in_a_second) ** 2 if in_a_second else math.inf


def _begin(water: Water) -> Float[np.ndarray, "cells"]:
    """1 for the cells in which drifters begin."""
    every = -(-water.cells * _LEAST_POINTS**2 // _DRIFTERS)
    # Along every diagonal of square parts one in so many.
    part = water.row // _PART + water.column // _PART
    return (part % every == 0).astype(float)


def _shares(
    water: Water, flow: Flow, begin: Float[np.ndarray, "cells"], times: Sequence[float]
) -> dict[float, Float[np.ndarray, "cells"]]:
    """The share of drifters in each cell at some times."""
    cells = np.flatnonzero(begin)
    most = 2 * _POINTS if flow.diffusivity else _POINTS
    points = min(most, max(_LEAST_POINTS, math.isqrt(_DRIFTERS // cells.size)))
    places = (np.arange(points) + 0.5) / points - 0.5
    right, up = (np.tile(one.ravel(), cells.size) for one in np.meshgrid(places, places))
    origin = np.repeat(cells, points**2)
    # Layers of one grid differ in their cells; of one size, they are compiled once.
    drifters, size = origin.size, bucket(origin.size)
    origin = np.resize(origin, size)
    x, y = water.column[origin] + np.resize(right, size), water.row[origin] + np.resize(up, size)
    # Half a cell at a time, and no longer than from one record to the next.
    between = np.diff(np.asarray(flow.time)).min(initial=np.inf)
    longest, found, now = _STEPS * min(crossing_time(water, flow) / 2, between), {}, 0.0
    sides, wet = np.stack([water.dx, water.dy]), water.number >= 0
    key = jax.random.key(0)
    for time in times:
        moves = math.ceil((time - now) / longest)
        for start in np.linspace(now, time, moves, endpoint=False).tolist():
            on = on_grid(water.number.shape, water.wraps, x, y)
            after = carried(flow, x, y, (time - now) / moves, start, "rk4", _STEPS)
            if flow.diffusivity:
                key, drawn = jax.random.split(key)
                after = diffuse(drawn, flow, sides, wet, *after, (time - now) / moves)
            x, y = (np.where(on, moved, here) for moved, here in zip(after, (x, y), strict=True))
        now = time
        cell: Int[np.ndarray, drifters] = water.landing(
            x[None, :drifters], y[None, :drifters], origin=origin[:drifters], exits=True
        )[0]
        found[time] = np.bincount(cell[cell >= 0], minlength=water.cells) / cell.size
    return found
