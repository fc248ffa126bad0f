import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from ...base.formatting import in_time
from ...base.quantities import derived, from_part
from ...mapping import Chain, ChainSequence
from ..behaviour import long_term_behaviour
from ..currents.holes import MOST, holes
from ..flow import Flow
from ..maps import drift_maps, exit_shares
from ..step import METHODS, DriftStep
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
from .distance_results import DistanceTotals
from .flattened import flattened
from .layer_ends import LayerEnds


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
