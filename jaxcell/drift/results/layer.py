import dataclasses
import functools
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ...base.quantities import derived, from_part
from ...mapping import Chain, ChainSequence
from ..behaviour import long_term_behaviour
from ..flow import Flow
from ..maps import drift_maps, exit_shares
from ..step import METHODS, DriftStep
from ..validation.diagnosis import Diagnosis, diagnose
from ..validation.distance import FAR, Distance, distances, longest_duration, mapped
from ..water import Water
from .ends import Ends, LayerEnds


class Compared(Ends):
    """The distance of the maps of one layer or more from drifters."""

    @property
    def _distances(self) -> list[Distance]:
        """The distance of each layer."""
        raise NotImplementedError

    @derived("", "drifters that the map has in a wrong cell after about 6 h", kind="share")
    def distance_6h(self) -> float | None:
        return self._worst(0)

    @derived("", "drifters that the map has in a wrong cell after about 24 h", kind="share")
    def distance_24h(self) -> float | None:
        return self._worst(1)

    @derived("", "drifters that left the map after about 24 h", kind="share")
    def drifters_left(self) -> float | None:
        return self._mean([float(distance.drifters_left[1]) for distance in self._distances])

    @derived("", "drifters that left it after about 24 h, by the map of cells", kind="share")
    def map_left(self) -> float | None:
        return self._mean([float(distance.map_left[1]) for distance in self._distances])

    @derived(
        "compared",
        "time after which the map is compared with drifters",
        "h",
        kind="time",
        listed=True,
    )
    def compared_hours(self) -> Float[np.ndarray, "times"]:
        return self._distances[0].hours

    @derived("", "cells in which the compared drifters began", kind="count")
    def compared_cells(self) -> int | None:
        count = sum(distance.cells for distance in self._distances)
        return count if count < self.cells else None

    def _worst(self, number: int) -> float | None:
        """Return the largest distance at 6 h or at 24 h, or `None` if no time is near."""
        if not self._distances[0].near[number]:
            return None
        return max(float(distance.total_variation[number]) for distance in self._distances)

    def _mean(self, of_layers: list[float]) -> float | None:
        """Average numbers of the layers at 24 h over all cells; `None` if no time is near."""
        if not self._distances[0].near[1]:
            return None
        return float(np.average(of_layers, weights=[layer.water.cells for layer in self._layers]))


@dataclasses.dataclass(frozen=True, eq=False)
class Layer(LayerEnds, Compared):
    """One layer of the sea: its water, its current, and the ends of drifters in it.

    The surface of the bundled sea at its first record:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> water, flow = drift.Water.of(currents), drift.Flow.of(currents)
        >>> surface = drift.Layer.of(water, flow, drift.DriftStep(1800))
        >>> surface.cells, surface.persistent_groups, round(surface.mean_shift_cells, 1)
        (538, 3, 1.0)
    """

    brief: ClassVar[tuple[str, ...]] = (
        *("depth", "cells", "persistent_groups", "distance_24h", "drifters_left", "median_hours"),
    )

    _ashore: ClassVar[Mapping[str, str]] = {
        "hold": "are held at the coast",
        "slip": "stay at the coast",
        "strand": "strand",
    }

    flow: Flow
    "The current at all records, in which simulated drifters move."
    by: Flow
    "The flow that the map is made of: the same if it is periodic, or the mean of the records."
    step: DriftStep
    "The step of the map."
    diagnosis: Diagnosis
    "Signs that the grid, rather than the flow, made the groups."
    measured: Distance | None = None
    "The distance of the map from drifters, if it is known."

    @classmethod
    def of(
        cls,
        water: Water,
        flow: Flow,
        step: DriftStep,
        *,
        by: Flow | None = None,
        made: tuple[Chain | ChainSequence, Distance] | None = None,
    ) -> "Layer":
        """Compute the long-term behaviour in a flow.

        By default the map is made of the flow itself if it is periodic, and else of the mean of its
        records; `made` is the map and its distance from drifters, if they are known.
        """
        by = mapped(flow) if by is None else by
        step = step.lasting(step.seconds(water, by))
        duration = float(step.duration or 0)
        chain, distance = made or (drift_maps(water, by, step), None)
        # Where cells almost trap drifters, times are inaccurate; all other results are useful.
        behaviour = long_term_behaviour(chain, duration, throw=False)
        diagnosis = diagnose(water, by, behaviour.begins.groups, step)
        return cls(water, behaviour, flow, by, step, diagnosis, distance)

    @functools.cached_property
    def exits(self) -> Float[np.ndarray, "ways states"]:
        """The probability of leaving the map in a step, for each of `EXITS`."""
        return exit_shares(self.water, self.by, self.step, self.behaviour.chain)

    @functools.cached_property
    def distance(self) -> Distance:
        """The distance of the map from drifters in the current, as it changes with time."""
        maps = [(self.behaviour.chain, self.behaviour.duration)]
        return self.measured or distances(self.water, self.flow, maps)[0]

    @property
    def _distances(self) -> list[Distance]:
        return [self.distance]

    @functools.cached_property
    def closer(self) -> tuple[str, Distance] | None:
        """The setting whose map is nearest to drifters, among a few others.

        `None` if the map is not far from drifters, or no setting is nearer.
        """
        if self.distance.worst <= FAR:
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
        pairs = zip(tried, distances(self.water, self.flow, maps), strict=True)
        best = min(pairs, key=lambda pair: pair[1].worst)
        return best if best[1].worst < self.distance.worst else None

    pieces = from_part(
        "diagnosis.pieces", "piece", "cells of connected pieces", kind="count", listed=True
    )
    mean_shift_cells = from_part("diagnosis.mean_shift", "", "mean drift in a step, in cells")
    self_image_share = from_part(
        "diagnosis.self_image", "", "cells that are mapped to themselves", kind="share"
    )
    compared_distance = from_part(
        "distance.total_variation",
        "compared",
        "drifters that the map has in a wrong cell",
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
        if ashore := self.diagnosis.ashore:
            remarks.append(
                f"{at} the current runs ashore at {ashore} of {self.persistent_groups} persistent "
                f"groups, where drifters {self._ashore[self.water.coast]}."
            )
        if (far := self.distance).worst > FAR:
            remarks.append(
                f"{at} after {far.worst_hours:.3g} h the map has {far.worst:.0%} of drifters in a "
                f"wrong cell; {_instead(self.closer)}."
            )
        return (*remarks, *super().remarks)


def _instead(closer: tuple[str, Distance] | None) -> str:
    if closer is None:
        return "no other duration or method that was tried brings it closer"
    setting, distance = closer
    return f"by {setting} it is {distance.worst:.0%} at most, after {distance.worst_hours:.3g} h"
