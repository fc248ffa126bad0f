"""The distance between a drift map and drifters that are simulated without cells."""

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...base.shown import Pictured
from ...mapping import Chain, ChainSequence
from ...mapping.sequence import as_sequence
from ..drift_step import DriftStep
from ..flow import Flow, crossing_time, steps_in
from ..long_term import long_term_behaviour
from ..maps import diffused_cells, drift_maps
from ..water import Water
from .replay import SAMPLING, Replay, Sampling


HOURS = (6.0, 24.0)
"""Times at which maps are compared with drifters, in hours, in addition to the time of interest."""
FAR = 0.2
"""The total variation above which a map is said to differ from simulated drifters."""
MOST_CELLS = 100_000
"""The largest number of cells times phases for which several durations are tried."""
# The longest default time of interest, in hours.
_MONTH = 30 * 24.0
# The least number of steps in the time of interest: the agreement of one step proves nothing.
_LEAST_STEPS = 4
# Durations are not tried if diffusion spreads drifters over more cells in a step.
_MAX_DIFFUSED = 2.0
_FACTORS = (1, 2, 4, 8, 16, 32)
# The number of parts along each side of the grid, among which drifters of one cell are compared.
_PARTS = 6


@dataclasses.dataclass(frozen=True, eq=False)
class Distance(Pictured):
    """The total variation between the distributions of drifters in a map and in a simulation."""

    hours: Float[np.ndarray, "times"]
    "The times of the comparison, in hours."
    total_variation: Float[np.ndarray, "times"]
    "The share of the drifters for which the map predicts a wrong cell, from 0 to 1."
    noise: Float[np.ndarray, "times"]
    "The total variation that this number of drifters would give even if the map were exact."
    drifters_left: Float[np.ndarray, "times"]
    "The share of the simulated drifters that left the grid."
    map_left: Float[np.ndarray, "times"]
    "The probability, according to the map, that a drifter left the grid."
    replay: Replay
    "The simulated drifters."

    @property
    def cells(self) -> int:
        """Number of cells in which drifters began."""
        return np.unique(self.replay.origin).size

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
    hours: Sequence[float | int] = HOURS,
) -> tuple[Distance, ...]:
    """Compare maps with drifters that are simulated without cells, in the flow as it changes.

    Drifters begin on an even grid of points in every cell. They move with the Runge-Kutta method,
    plus a random walk with the diffusivity of the flow: see [`Replay.of`][jaxcell.drift.Replay.of].

    **Arguments:**

    - `water`, `flow`: the cells, and the flow of the same layer at all records.
    - `maps`: chains over the cells, or sequences of chains, each with its seconds per step.
    - `sampling`: the points at which drifters begin; by default `Sampling()`.
    - `hours`: the times of the comparison, each rounded to whole steps of the map, at least one.
        `Distance.replay` has the simulated drifters at the exact times, too.

    **Returns:** the [`Distance`][] of each map.

    The surface of the bundled sea at its first record. The rules of the dissertation spread
    drifters more than the water does:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> steps = [drift.METHODS[name].lasting(7200.0) for name in ("source", "drifters")]
        >>> maps = [(drift.drift_map(water, flow, step), 7200.0) for step in steps]
        >>> source, drifters = drift.distances(water, flow, maps)
        >>> source.total_variation.round(2).tolist(), drifters.total_variation.round(2).tolist()
        ([0.96, 1.0], [0.09, 0.13])
    """
    counts = [sorted({steps_in(3600 * hour, seconds) for hour in hours}) for _, seconds in maps]
    times = [n * seconds for steps, (_, seconds) in zip(counts, maps, strict=True) for n in steps]
    times += [3600 * hour for hour in hours]
    replay = Replay.of(water, flow, [time / 3600 for time in times], sampling or SAMPLING)
    begin = replay.begin(water.cells)
    results = []
    for steps, (chain, seconds) in zip(counts, maps, strict=True):
        at = np.array(steps) * seconds / 3600
        later = as_sequence(chain).pushed(begin, steps[-1])
        mapped = [cells for count, cells in enumerate(later) if count in steps]
        variation, noise = np.transpose([*map(replay.variation, at, mapped)])
        left = np.array([1 - replay.share(hour, water.cells).sum() for hour in at])
        map_left = np.array([1 - cells.sum() for cells in mapped]).clip(0, 1)
        results.append(Distance(at, variation, noise, left, map_left, replay))
    return tuple(results)


def distances_by_cell(
    water: Water, chain: Chain | ChainSequence, seconds: float | int, distance: Distance
) -> tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "cells"]]:
    """Compute the distance for the drifters from each cell, at the last of `distance.hours`.

    Few drifters begin in each cell, so the map and the drifters are compared in about 36 blocks of
    the grid instead of in every cell.

    **Arguments:**

    - `water`, `chain`, `seconds`: the cells, the map and its seconds per step.
    - `distance`: the distance of the map, from [`distances`][].

    **Returns:** the total variation of each cell, and the total variation to expect if the map were
    exact; NaN for cells in which no drifter began.

    In almost still water drifters stay in their cells, but the map moves the drifters of cell 0:

        >>> import numpy as np
        >>> import jax.numpy as jnp
        >>> from jaxcell import drift, examples, mapping
        >>> water = examples.water([[1, 1, 1, 1]])
        >>> flow = drift.Flow(jnp.full((1, 2, 1, 4), 1e-9), jnp.zeros(1))
        >>> away = mapping.Chain(np.int32([[1, 1, 2, 3]]), np.ones((1, 4)))
        >>> (one,) = drift.distances(water, flow, [(away, 3600.0)])
        >>> drift.distances_by_cell(water, away, 3600.0, one)[0].tolist()
        [1.0, 0.0, 0.0, 0.0]
    """
    sizes = zip((water.row, water.column), water.number.shape, strict=True)
    row, column = (_PARTS * place // size for place, size in sizes)
    _, part = np.unique(row * _PARTS + column, return_inverse=True)
    parts = int(part.max()) + 1
    replay, hours = distance.replay, float(distance.hours[-1])
    end = replay.at(hours)
    stays = end >= 0
    began = np.bincount(replay.origin, minlength=water.cells).astype(float)
    began[began == 0] = np.nan
    place = replay.origin[stays] * parts + part[end[stays]]
    seen = np.bincount(place, minlength=water.cells * parts).reshape(-1, parts) / began[:, None]
    within = (part[:, None] == np.arange(parts)).astype(float)
    by_map = _pulled(chain, within, round(3600 * hours / seconds))
    apart = np.abs(by_map - seen).sum(axis=1) + np.abs(by_map.sum(axis=1) - seen.sum(axis=1))
    every = np.column_stack([by_map, (1 - by_map.sum(axis=1)).clip(0)])
    spread = np.sqrt(2 / math.pi * every * (1 - every).clip(0) / began[:, None]).sum(axis=1)
    return apart / 2, spread / 2


def _pulled(
    chain: Chain | ChainSequence, values: Float[np.ndarray, "cells parts"], steps: int
) -> Float[np.ndarray, "cells parts"]:
    """Compute the mean of `values` after some steps, for drifters from each cell at phase 0."""
    sequence = as_sequence(chain)
    matrices = [sequence.at(phase).to_scipy() for phase in range(sequence.phases)]
    for step in reversed(range(steps)):
        values = matrices[step % sequence.phases] @ values
    return values


def nearest_step(
    waters: Sequence[Water],
    flows: Sequence[Flow],
    step: DriftStep,
    hours: float | int | None = None,
) -> DriftStep:
    """Choose the duration of a step whose maps of the layers agree best with simulated drifters.

    In every step the grid spreads drifters by up to a cell, which favours few long steps. But in a
    long step the current changes, and a few points do not represent a whole cell. The durations
    tried are 1, 2, 4 ... times the [`jaxcell.drift.crossing_time`][] of the slowest layer, up to a
    quarter of the time of interest. The choice minimizes the largest total variation after 6 hours,
    24 hours and the time of interest. In a periodic flow there is a map per phase, and durations
    are changed to fit the period; otherwise the map is made from the mean of the records. If cells
    times phases exceed 100,000, the duration is twice the crossing time, without a search.

    **Arguments:**

    - `waters`, `flows`: water and flow of each layer, with all records.
    - `step`: the rules of the step; its duration has no effect.
    - `hours`: the time of interest; by default [`asked_hours`][jaxcell.drift.asked_hours] of the
        map for twice the crossing time.

    **Returns:** the step with its duration.

    The surface of the bundled sea at its first record, which is steady:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> step = drift.nearest_step([water], [flow], drift.METHODS["drifters"])
        >>> round(step.duration / drift.crossing_time(water, flow))
        8
    """
    return nearest_maps(waters, flows, [mapped(flow) for flow in flows], step, hours)[0]


def mapped(flow: Flow) -> Flow:
    """Return the flow from which maps are made: the flow if it is periodic, otherwise its mean."""
    return flow if flow.period is not None else flow.mean()


def asked_hours(chains: Sequence[Chain | ChainSequence], seconds: float | int) -> float:
    """Return the default time of interest, in hours.

    It is the median time until drifters from a transient cell are in a persistent group or off the
    map, rounded up to whole days, from 1 to 30.

    **Arguments:** the map of each layer, and the duration of their steps in seconds.
    **Returns:** the time.

    Drifters leave the map in ten steps of six hours on average:

        >>> import numpy as np
        >>> from jaxcell import drift, mapping
        >>> drift.asked_hours([mapping.Chain.from_scipy(np.array([[0.9]]))], 6 * 3600)
        72.0
    """
    begins = [long_term_behaviour(chain, seconds).begins for chain in chains]
    hours = [np.asarray(one.hours)[np.asarray(one.groups.group) < 0] for one in begins]
    return whole_days(np.concatenate(hours))


def whole_days(hours: Float[np.ndarray, "transient"]) -> float:
    """Return the median of `hours`, rounded up to 24, 48, 72, ... hours, but at most 720."""
    median = float(np.median(hours)) if hours.size else 0.0
    return 24.0 * min(max(1, math.ceil(median / 24 - 1e-6)), round(_MONTH / 24))


def compared_hours(asked: float | int) -> tuple[float, ...]:
    """Return the hours of the comparison: 6 and 24, if they are less than `asked`; and `asked`."""
    return (*(hour for hour in HOURS if hour < asked), float(asked))


def nearest_maps(
    waters: Sequence[Water],
    flows: Sequence[Flow],
    by: Sequence[Flow],
    step: DriftStep,
    hours: float | int | None = None,
) -> tuple[DriftStep, list[tuple[Chain | ChainSequence, Distance]] | None]:
    """Choose the step as [`nearest_step`][] does; return it with each layer's map and `Distance`.

    Maps are made from the flows in `by`, and drifters move with the flows in `flows`. If cells
    times phases exceed `MOST_CELLS`, no durations are tried, and `None` is returned for the maps.
    """
    crossing = max(map(crossing_time, waters, by))
    usual = by[0].fitted(2 * crossing)
    cells = sum(water.cells for water in waters)

    @functools.cache
    def chains(seconds: float) -> list[Chain | ChainSequence]:
        return [*map(drift_maps, waters, by, [step.lasting(seconds)] * len(waters))]

    if cells * by[0].phases(usual) > MOST_CELLS:
        return step.lasting(usual), None
    asked = asked_hours(chains(usual), usual) if hours is None else float(hours)
    spread = min(map(longest_duration, waters, by))
    longest = min(3600 * asked / _LEAST_STEPS, spread)
    factors = [factor for factor in _FACTORS if factor == 1 or factor * crossing <= longest]
    if by[0].period is None:
        # The durations divide the time of interest.
        counts = {steps_in(3600 * asked, factor * crossing) for factor in factors}
        durations = sorted(3600 * asked / count for count in counts)
    else:
        durations = sorted({by[0].fitted(factor * crossing) for factor in factors})
    tried = [one for one in durations if cells * by[0].phases(one) <= MOST_CELLS] or [usual]
    layers = []
    for number, (water, flow) in enumerate(zip(waters, flows, strict=True)):
        maps = [(chains(seconds)[number], seconds) for seconds in tried]
        made = [chain for chain, _ in maps]
        compared = distances(water, flow, maps, hours=compared_hours(asked))
        layers.append([*zip(made, compared, strict=True)])
    worst = [
        max(distance.worst for _, distance in of_step) for of_step in zip(*layers, strict=True)
    ]
    best = int(np.argmin(worst))
    return step.lasting(tried[best]), [layer[best] for layer in layers]


def longest_duration(water: Water, flow: Flow) -> float:
    """Return the longest step in seconds in which diffusion spreads drifters by at most 2 cells."""
    in_a_second = float(diffused_cells(water, flow, 1.0).max())
    return (_MAX_DIFFUSED / in_a_second) ** 2 if in_a_second else math.inf
