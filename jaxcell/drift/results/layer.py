import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ...base.quantities import derived
from ...mapping import Chain, ChainSequence
from ..behaviour import long_term_behaviour
from ..chains import METHODS, drift_maps
from ..ends import Ends, LayerEnds
from ..flow import Flow
from ..truth.diagnosis import Diagnosis, diagnose
from ..truth.distance import FAR, Distance, distances, longest_step, mapped
from ..water import Water


class Compared(Ends):
    """How far the maps of one layer or more are from drifters."""

    @property
    def _distances(self) -> list[Distance]:
        """Of each layer."""
        raise NotImplementedError

    @derived("", "drifters that the map has in a wrong cell after about 6 h", kind="share")
    def distance_6h(self) -> float | None:
        return self._worst(0)

    @derived("", "drifters that the map has in a wrong cell after about 24 h", kind="share")
    def distance_24h(self) -> float | None:
        return self._worst(1)

    @derived("", "drifters that left the map after about 24 h", kind="share")
    def drifters_left(self) -> float | None:
        return self._mean([float(one.drifters_left[1]) for one in self._distances])

    @derived("", "drifters that left it after about 24 h, by the map of cells", kind="share")
    def map_left(self) -> float | None:
        return self._mean([float(one.map_left[1]) for one in self._distances])

    @derived(
        "compared",
        "time after which the map is compared with drifters",
        "h",
        kind="time",
        listed=True,
    )
    def compared_hours(self) -> Float[np.ndarray, "times"]:
        return self._distances[0].hours

    @derived("", "cells in which drifters that were compared began, of all", kind="count")
    def compared_cells(self) -> int | None:
        count = sum(one.cells for one in self._distances)
        return count if count < self.cells else None

    def _worst(self, number: int) -> float | None:
        """The largest distance at 6 h or at 24 h; `None` if steps are too long for it."""
        if not self._distances[0].near[number]:
            return None
        return max(float(one.total_variation[number]) for one in self._distances)

    def _mean(self, of_layers: list[float]) -> float | None:
        """The mean over all cells of what is known of layers at 24 h."""
        if not self._distances[0].near[1]:
            return None
        return float(np.average(of_layers, weights=[one.water.cells for one in self._layers]))


@dataclasses.dataclass(frozen=True, eq=False)
class Layer(LayerEnds, Compared):
    """One layer of the sea: its water, its current, and what becomes of drifters in it.

    The surface of the bundled sea at its first record:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> surface = drift.Layer.of(drift.Water.of(currents), drift.Flow.of(currents), 1800)
        >>> surface.cells, surface.persistent_groups, round(surface.mean_shift_cells, 1)
        (538, 3, 1.0)
    """

    brief: ClassVar[tuple[str, ...]] = (
        *("depth", "cells", "persistent_groups", "distance_24h", "drifters_left", "median_hours"),
    )

    flow: Flow
    "At all records; drifters go with it."
    by: Flow
    "What the map is made of: the same if it repeats, or the mean of the records."
    diagnosis: Diagnosis
    "How far the behaviour can be trusted."
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    "Further ones of the map, such as `spread` and `edge`."
    measured: Distance | None = None
    "The distance of the map from drifters, where it is known."

    @classmethod
    def of(
        cls,
        water: Water,
        flow: Flow,
        duration: float | int,
        *,
        by: Flow | None = None,
        made: tuple[Chain | ChainSequence, Distance] | None = None,
        **options: Any,
    ) -> "Layer":
        """The long-term behaviour in a flow.

        **Arguments:**

        - `water`, `flow`: of the layer.
        - `duration`: of a step of the map, in seconds.
        - `by`: the flow that the map is made of; by default the flow as it changes if it repeats,
            and else the mean of its records.
        - `made`: the map and its distance from drifters, where they are known.
        - `options`: further ones of [`jaxcell.drift.drift_map`][].

        **Raises:** as [`jaxcell.drift.drift_maps`][].
        """
        by = mapped(flow) if by is None else by
        chain, distance = made or (drift_maps(water, by, duration, **options), None)
        # Where drifters stay almost for ever, times are only roughly right; all else is of use.
        behaviour = long_term_behaviour(chain, duration, throw=False)
        rule = {name: options[name] for name in ("method", "steps") if name in options}
        diagnosis = diagnose(water, by, behaviour.begins.groups, duration, **rule)
        return cls(water, behaviour, flow, by, diagnosis, options, distance)

    @functools.cached_property
    def distance(self) -> Distance:
        """How far the map is from drifters in the current, as it changes with time."""
        maps = [(self.behaviour.chain, self.behaviour.duration)]
        return self.measured or distances(self.water, self.flow, maps)[0]

    @property
    def _distances(self) -> list[Distance]:
        return [self.distance]

    @functools.cached_property
    def closer(self) -> tuple[str, Distance] | None:
        """What brings the map closest to drifters, of some settings that were tried, if it is far
        from them; `None` if it is not, or if nothing helps."""
        if self.distance.worst <= FAR:
            return None
        options, step = self.options, self.behaviour.duration
        longer = [self.by.fitted(factor * step) for factor in (2, 4)]
        most = longest_step(self.water, self.by)
        tried = {f"a duration of {one:.0f} s": (one, options) for one in longer if one <= most}
        if options.get("spread", "turned") != "sampled":
            tried['the method "drifters"'] = (step, METHODS["drifters"])
        if not tried:
            return None
        maps = [(drift_maps(self.water, self.by, d, **with_), d) for d, with_ in tried.values()]
        found = zip(tried, distances(self.water, self.flow, maps), strict=True)
        best = min(found, key=lambda one: one[1].worst)
        return best if best[1].worst < self.distance.worst else None

    @derived("piece", "cells of connected pieces", kind="count", listed=True)
    def pieces(self) -> Int[np.ndarray, "pieces"]:
        return self.diagnosis.pieces

    @derived("", "mean drift in a step, in cells")
    def mean_shift_cells(self) -> float:
        return self.diagnosis.mean_shift

    @derived("", "cells that are mapped to themselves", kind="share")
    def self_image_share(self) -> float:
        return self.diagnosis.self_image

    @derived("compared", "drifters that the map has in a wrong cell", kind="share", listed=True)
    def compared_distance(self) -> Float[np.ndarray, "times"]:
        return self.distance.total_variation

    @derived("", "warning")
    def warning(self) -> str | None:
        return self.diagnosis.warning

    @derived("remedy", "parameters that may help", listed=True)
    def remedies(self) -> tuple[str, ...] | None:
        return self.diagnosis.remedies(self.options.get("spread", "turned")) or None

    @property
    def remarks(self) -> tuple[str, ...]:
        found = []
        if self.warning is not None:
            advice = {"duration": "a longer duration", "spread": 'the spread "sampled"'}
            instead = " or ".join(advice[one] for one in self.remedies or ())
            found.append(f"At {self.depth:g} m: {self.warning}{instead and f'; take {instead}'}.")
        if ashore := self.diagnosis.ashore:
            found.append(
                f"At {self.depth:g} m: the current runs ashore at {ashore} of "
                f"{self.persistent_groups} persistent groups: there drifters strand."
            )
        if (far := self.distance).worst > FAR:
            found.append(
                f"At {self.depth:g} m: after {far.worst_hours:.3g} h the map has {far.worst:.0%} "
                f"of drifters in a wrong cell; {_instead(self.closer)}."
            )
        return (*found, *super().remarks)


def _instead(closer: tuple[str, Distance] | None) -> str:
    if closer is None:
        return "no other duration or method that was tried brings it closer"
    setting, distance = closer
    return f"by {setting} it is {distance.worst:.0%} at most, after {distance.worst_hours:.3g} h"
