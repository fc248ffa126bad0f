import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ...base.formatting import in_time
from ...base.quantities import Result, derived, from_part
from ...currents.holes import MOST, holes
from ...mapping import Chain, ChainSequence
from ..drift_step import METHODS, DriftStep
from ..flow import Flow
from ..layered_cells import Sea
from ..long_term import long_term_behaviour
from ..maps import drift_maps, exit_shares
from ..validation.diagnosis import Diagnosis, diagnose
from ..validation.distance import (
    FAR,
    MOST_CELLS,
    Distance,
    compared_hours,
    distances,
    distances_by_cell,
    longest_duration,
    mapped,
    whole_days,
)
from ..validation.markov_test import MarkovTest
from ..validation.release import ReleaseDistance, release_distance, typical_cells
from ..water import Water
from .flattened import flattened
from .layer_ends import LayerEnds, mean_over_cells


_at_times = functools.partial(derived, "compared", listed=True)
_of_cells = functools.partial(
    derived, "layer y x", units="1", kind="share", padding="NaN: no water, or not known"
)


@dataclasses.dataclass(frozen=True, eq=False)
class DistanceTotals(Result):
    """The largest distances of one or more layers between maps and simulated drifters."""

    layers: "Sequence[Layer]"

    @property
    def _distances(self) -> list[Distance]:
        return [layer.compared for layer in self.layers]

    @derived("", "time that the answer is about", "h", kind="time")
    def asked_hours(self) -> float:
        return float(self.compared_hours[-1])

    @derived("", "in a wrong cell of the map then, released everywhere", kind="share")
    def distance(self) -> float:
        return float(self.distance_by_time[-1])

    @derived("", "the same by chance, because drifters are finite", kind="share")
    def distance_noise(self) -> float:
        return max(float(distance.noise[-1]) for distance in self._distances)

    @property
    def _releases(self) -> list[ReleaseDistance]:
        started = [layer for layer in self.layers if layer.release is not None]
        return [layer.by_release for layer in started or self.layers]

    @derived("", "the same, released in one cell (start, or median of nine)", kind="share")
    def release_distance(self) -> float:
        return float(self.release_distance_by_time[-1])

    @derived("", "the same by chance, released in one cell", kind="share")
    def release_distance_noise(self) -> float:
        return max(float(np.median(one.noise[:, -1])) for one in self._releases)

    @_at_times(
        "drifters that the map has in a wrong cell after these times, released in one cell",
        kind="share",
    )
    def release_distance_by_time(self) -> Float[np.ndarray, "times"]:
        return np.max([np.median(one.total_variation, axis=0) for one in self._releases], axis=0)

    @derived("", "drifters that left the map then", kind="share")
    def drifters_left(self) -> float:
        left = [distance.drifters_left[-1] for distance in self._distances]
        return float(mean_over_cells(self.layers, left))

    @derived("", "drifters that left it then, by the map of cells", kind="share")
    def map_left(self) -> float:
        left = [distance.map_left[-1] for distance in self._distances]
        return float(mean_over_cells(self.layers, left))

    @_at_times("times after which the map is compared with drifters", "h", kind="time")
    def compared_hours(self) -> Float[np.ndarray, "times"]:
        return self._distances[0].hours

    @_at_times(
        "drifters that the map has in a wrong cell after these times, released everywhere",
        kind="share",
    )
    def distance_by_time(self) -> Float[np.ndarray, "times"]:
        return np.max([distance.total_variation for distance in self._distances], axis=0)

    @derived("", "cells in which the compared drifters began", kind="count")
    def compared_cells(self) -> int | None:
        count = sum(distance.cells for distance in self._distances)
        return count if count < sum(layer.water.cells for layer in self.layers) else None

    @derived("", "diffusivity of drifters, as requested", "m2 s-1")
    def diffusivity(self) -> float | None:
        return self.layers[0].by.diffusivity or None

    @derived("", "diffusivity that the grid adds", "m2 s-1")
    def grid_diffusivity(self) -> float:
        # In a step a drifter gets a random place in its cell, which adds a variance of side^2 / 6.
        side = np.concatenate([layer.water.sides.ravel() for layer in self.layers])
        return float((side**2).mean()) / (12 * self.layers[0].behaviour.duration)


def _by_time(name: str, meaning: str) -> Any:
    """Build a property, described by `meaning`: the array `name` of each layer's [`Distance`][]."""
    return derived("layer compared", meaning, "1", kind="share")(
        lambda part: np.stack([getattr(layer.compared, name) for layer in part.layers])
    )


@dataclasses.dataclass(frozen=True, eq=False)
class DistancesOfLayers(Result):
    """The distances between maps and simulated drifters, layer by layer and cell by cell."""

    layers: "Sequence[Layer]"
    sea: Sea

    @_of_cells("drifters from the cell that the map has in a wrong part of 36 at the time asked")
    def distance_by_cell(self) -> Float[np.ndarray, "layers rows columns"] | None:
        return self._by_cell(0)

    @_of_cells("the same by chance, because drifters are finite")
    def distance_by_cell_noise(self) -> Float[np.ndarray, "layers rows columns"] | None:
        return self._by_cell(1)

    def _by_cell(self, number: int) -> Float[np.ndarray, "layers rows columns"] | None:
        known = [layer.by_cell[number] for layer in self.layers if layer.by_cell is not None]
        if len(known) < len(self.layers):
            return None
        return self.sea.on_squares(np.concatenate(known))

    compared_distance = _by_time(
        "total_variation", "drifters that the map has in a wrong cell, released everywhere"
    )
    compared_noise = _by_time("noise", "the same by chance, because drifters are finite")
    compared_drifters_left = _by_time("drifters_left", "drifters that left the map")
    compared_map_left = _by_time("map_left", "drifters that left, by the map of cells")


@dataclasses.dataclass(frozen=True, eq=False)
class Layer(LayerEnds):
    """A layer of the sea: its water, its current, and the long-term behaviour of drifters.

    The surface of the bundled sea at its first record:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> surface = drift.Layer.of(water, flow, drift.DriftStep(1800))
        >>> surface.cells, surface.persistent_groups, round(surface.mean_shift_cells, 1)
        (538, 3, 1.0)
    """

    brief: ClassVar = (
        *("depth", "cells", "distance", "release_distance"),
        *("persistent_groups", "median_hours"),
    )

    _ashore: ClassVar[Mapping[str, str]] = {
        "hold": "are held at the coast",
        "slip": "stay at the coast",
        "strand": "strand",
    }

    flow: Flow
    "The current at all records, in which simulated drifters move."
    by: Flow
    """The flow from which the map is computed: `flow` if it is periodic, otherwise the mean of its
    records."""
    step: DriftStep
    diagnosis: Diagnosis
    "Signs that the grid, rather than the flow, determines the groups."
    measured: Distance | None = None
    "The distance between the map and simulated drifters; `None` to compute it when needed."
    asked: float | int | None = None
    "The time of interest, in hours; by default the median absorption time, in whole days."
    release: int | None = None
    "The cell in which drifters are released; `None` for some cells, spread evenly."

    @classmethod
    def of(
        cls,
        water: Water,
        flow: Flow,
        step: DriftStep,
        *,
        by: Flow | None = None,
        made: tuple[Chain | ChainSequence, Distance] | None = None,
        asked: float | int | None = None,
        say: Callable[..., None] = lambda *_: None,
    ) -> "Layer":
        """Compute the long-term behaviour in a flow.

        The map is made from the flow `by`: by default the flow itself if it is periodic, and
        otherwise the mean of its records. `made` contains the map and its distance from drifters if
        the caller has computed them. `asked` is the time of interest in hours. `say` is called
        with the name of a stage, the number of maps that are done, and their total.
        """
        by = mapped(flow) if by is None else by
        step = step.lasting(step.seconds(water, by))
        duration = float(step.duration or 0)
        chain, distance = made or (drift_maps(water, by, step, say=say), None)
        behaviour = long_term_behaviour(chain, duration)
        diagnosis = diagnose(water, by, behaviour.begins.groups, step)
        return cls(water, behaviour, flow, by, step, diagnosis, distance, asked)

    @flattened()
    def distance_totals(self) -> DistanceTotals:
        return DistanceTotals((self,))

    @functools.cached_property
    def exits(self) -> Float[np.ndarray, "exits states"]:
        """The probability of leaving the map in a step through each of the `EXITS`."""
        return exit_shares(self.water, self.by, self.step, self.behaviour.chain)

    @functools.cached_property
    def compared(self) -> Distance:
        """The distance between the map and drifters in the current, as it changes with time."""
        return self.measured or self._compared([(self.behaviour.chain, self.behaviour.duration)])[0]

    def _compared(
        self, maps: Sequence[tuple[Chain | ChainSequence, float]]
    ) -> tuple[Distance, ...]:
        return distances(self.water, self.flow, maps, hours=self._times)

    @property
    def _times(self) -> tuple[float, ...]:
        asked = whole_days(self.transient_hours) if self.asked is None else self.asked
        return compared_hours(asked)

    @functools.cached_property
    def by_release(self) -> ReleaseDistance:
        """The distance between the map and drifters that are released in single cells."""
        cells = typical_cells(self.water) if self.release is None else np.array([self.release])
        chain, duration = self.behaviour.chain, self.behaviour.duration
        times = self.compared.hours.tolist()
        return release_distance(self.water, self.flow, chain, duration, cells, times)

    @functools.cached_property
    def by_cell(self) -> Float[np.ndarray, "2 cells"] | None:
        """The results of [`jaxcell.drift.distances_by_cell`][]; `None` for large maps."""
        if self._large:
            return None
        chain, duration = self.behaviour.chain, self.behaviour.duration
        return np.stack(distances_by_cell(self.water, chain, duration, self.compared))

    @functools.cached_property
    def closer(self) -> tuple[str, Distance] | None:
        """The best other duration or method, in words, and the distance of its map from drifters.

        It is `None` if this map agrees well enough or is large, or if no other agrees better.
        """
        if self.compared.worst <= FAR or self._large:
            return None
        duration, most = self.behaviour.duration, longest_duration(self.water, self.by)
        longer = [self.by.fitted(factor * duration) for factor in (2, 4)]
        tried = {
            f"a duration of {seconds:.0f} s": self.step.lasting(seconds)
            for seconds in longer
            if seconds <= most
        }
        if self.step.spread != "sampled":
            tried['the method "drifters"'] = METHODS["drifters"].lasting(duration)
        if not tried:
            return None
        maps = [
            (drift_maps(self.water, self.by, step), float(step.duration or 0))
            for step in tried.values()
        ]
        best = min(zip(tried, self._compared(maps), strict=True), key=lambda pair: pair[1].worst)
        return best if best[1].worst < self.compared.worst else None

    def tested(self, sets: Int[np.ndarray, "cells"], first: int = 0) -> MarkovTest:
        """Test the map on sets of cells, with the times and the drifters of `compared`.

        **Arguments:**

        - `sets`: the number of the set that contains each cell, or -1 if no set does.
        - `first`: the number that the result gives to set 0; sets 1, 2, ... get the next numbers.
        """
        replay, duration = self.compared.replay, self.behaviour.duration
        seen = [
            (round(3600 * hours / duration), replay.origin, replay.at(hours))
            for hours in self.compared.hours.tolist()
        ]
        return MarkovTest.of(self.behaviour.chain, sets, duration, seen, self.depth, first)

    pieces = from_part(
        "diagnosis.pieces", "piece", "cells of connected pieces", kind="count", listed=True
    )
    mean_shift_cells = from_part("diagnosis.mean_shift", "", "mean drift in a step, in cells")
    self_image_share = from_part(
        "diagnosis.self_image", "", "cells that are mapped to themselves", kind="share"
    )

    compared_distance = from_part(
        "compared.total_variation",
        "compared",
        "drifters that the map has in a wrong cell, released everywhere",
        kind="share",
        listed=True,
    )

    warning = from_part("diagnosis.warning", "", "warning")

    @derived("remedy", "parameters that may help", listed=True)
    def remedies(self) -> tuple[str, ...] | None:
        return self.diagnosis.remedies(self.step.spread) or None

    @property
    def remarks(self) -> tuple[str, ...]:
        remarks = []
        at = f"At {self.depth:g} m:"
        if self.warning is not None:
            advice = {"duration": "a longer duration", "spread": 'the spread "sampled"'}
            instead = " or ".join(advice[name] for name in self.remedies or ())
            remarks.append(f"{at} {self.warning}{instead and f'; take {instead}'}.")
        _, size = holes(self.water.gaps, self.water.number >= 0)
        if size.size:
            small = int(size[size <= MOST].sum())
            fill = f"--gaps fill fills {small:,} of them, and " if small else ""
            remarks.append(
                f"{at} drifters leave the map through {size.sum():,} squares without data inside "
                f"the water, in {size.size:,} holes; {fill}--gaps land takes all for land."
            )
        if ashore := self.diagnosis.ashore:
            remarks.append(
                f"{at} the current runs ashore at {ashore} of {self.persistent_groups} persistent "
                f"groups, where drifters {self._ashore[self.water.coast]}."
            )
        if (far := self.compared).worst > FAR:
            remarks.append(
                f"{at} after {in_time(far.worst_hours)} the map has {far.worst:.0%} of drifters "
                f"that are released everywhere in a wrong cell; {self._instead}."
            )
        return (*remarks, *super().remarks)

    @property
    def _large(self) -> bool:
        """True if the map is so large that other maps take too long to try."""
        return self.behaviour.unrolled.cells > MOST_CELLS

    @property
    def _instead(self) -> str:
        if self._large:
            return "a longer duration may bring it closer"
        if self.closer is None:
            return "no other duration or method that was tried brings it closer"
        setting, distance = self.closer
        when = in_time(distance.worst_hours)
        return f"by {setting} it is {distance.worst:.0%} at most, after {when}"
