import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.certificate import Outcome
from ..base.quantities import PROBABILITY, Checks, Result, derived
from ..mapping import Chain, ChainSequence
from ..markov import Absorption, absorption_probabilities
from .behaviour import LongTermBehaviour, long_term_behaviour
from .chains import METHODS, drift_maps
from .diagnosis import Diagnosis, diagnose
from .distance import FAR, Distance, distances, longest_step, mapped
from .flow import Flow
from .water import Water


ALMOST_FOR_EVER = 10_000
"""A drifter that takes more steps than this on average is said to take almost for ever."""
# Bytes that the probabilities of all groups of a layer may take.
_MAX_TABLE = 2**28


class Ends(Result):
    """Where drifters of one layer or more end up, and how soon: what is counted of all of them."""

    @property
    def _layers(self) -> "tuple[Layer, ...]":
        raise NotImplementedError

    @functools.cached_property
    def _hours(self) -> Float[np.ndarray, "transient"]:
        """The absorption times of the transient cells."""
        return np.concatenate([np.asarray(one.begins.hours)[one.transient] for one in self._layers])

    @derived("", "cells of water", kind="count")
    def cells(self) -> int:
        return sum(one.water.cells for one in self._layers)

    @derived("", "persistent groups", kind="count")
    def persistent_groups(self) -> int:
        return sum(one.behaviour.groups.count for one in self._layers)

    @derived(
        "", "drifters that the map has in a wrong cell after about 6 h, at worst", kind="share"
    )
    def distance_6h(self) -> float:
        return max(float(one.distance.total_variation[0]) for one in self._layers)

    @derived("", "drifters that it has there after about 24 h", kind="share")
    def distance_24h(self) -> float:
        return max(float(one.distance.total_variation[-1]) for one in self._layers)

    @derived("", "drifters that left the map after about 24 h", kind="share")
    def drifters_left(self) -> float:
        return self._mean([float(one.distance.drifters_left[-1]) for one in self._layers])

    @derived("", "and that left by the map of cells", kind="share")
    def map_left(self) -> float:
        return self._mean([float(one.distance.map_left[-1]) for one in self._layers])

    @derived("", "cells in which drifters that were compared began, of all", kind="count")
    def compared_cells(self) -> int | None:
        count = sum(one.distance.cells for one in self._layers)
        return count if count < self.cells else None

    def _mean(self, of_layers: list[float]) -> float:
        """The mean over all cells of what is known of layers."""
        return float(np.average(of_layers, weights=[one.water.cells for one in self._layers]))

    @derived("", "cells of persistent groups", kind="count")
    def persistent_cells(self) -> int:
        return self.cells - self._hours.size

    @derived("", "transient groups", kind="count")
    def transient_groups(self) -> int:
        return sum(one.begins.transient.count for one in self._layers)

    @derived("", "transient cells with one end", kind="count")
    def single_domicile_cells(self) -> int:
        parts = [one.begins.transient for one in self._layers]
        return sum(int(np.asarray(one.size)[one.single].sum()) for one in parts)

    @derived("", "transient cells with several ends", kind="count")
    def multiple_domicile_cells(self) -> int:
        return self._hours.size - self.single_domicile_cells

    @derived("", "time to the end, transient cells, mean", "h", kind="time")
    def mean_hours(self) -> float:
        return float(self._hours.mean()) if self._hours.size else 0.0

    @derived("", "time to the end, transient cells, median", "h", kind="time")
    def median_hours(self) -> float:
        return float(np.median(self._hours)) if self._hours.size else 0.0

    @derived("", "time to the end, transient cells, longest", "h", kind="time")
    def longest_hours(self) -> float:
        return float(self._hours.max(initial=0.0))

    @derived("", "whether these times are certified", kind="flag")
    def times_certified(self) -> bool:
        solves = [one.behaviour.absorption.certificate for one in self._layers]
        return all(one.outcome is Outcome.CONVERGED for one in solves)

    @derived("", "cells that take almost for ever", kind="count")
    def almost_for_ever_cells(self) -> int:
        return sum(int(one.almost_for_ever.sum()) for one in self._layers)

    @derived(
        "",
        "probability of leaving the map, mean",
        kind="share",
        padding="NaN: not known",
    )
    def mean_leaving(self) -> float:
        return float(np.concatenate([one.leaving for one in self._layers]).mean())


@dataclasses.dataclass(frozen=True, eq=False)
class Layer(Ends):
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
        *("self_image_share", "almost_for_ever_cells"),
    )
    tables: ClassVar[Mapping[str, str]] = {"group_index": "groups", "transient": "transients"}

    water: Water
    flow: Flow
    "At all records; drifters go with it."
    by: Flow
    "What the map is made of: the same if it repeats, or the mean of the records."
    behaviour: LongTermBehaviour
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
        return cls(water, flow, by, behaviour, diagnosis, options, distance)

    @property
    def _layers(self) -> "tuple[Layer, ...]":
        return (self,)

    @functools.cached_property
    def distance(self) -> Distance:
        """How far the map is from drifters in the current, as it changes with time."""
        maps = [(self.behaviour.chain, self.behaviour.duration)]
        return self.measured or distances(self.water, self.flow, maps)[0]

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

    @functools.cached_property
    def group(self) -> Int[np.ndarray, "cells"]:
        """The persistent group of each cell, -1 if it is transient."""
        return np.asarray(self.begins.groups.group)

    @property
    def begins(self) -> LongTermBehaviour:
        """The behaviour of drifters that are released at the first record."""
        return self.behaviour.begins

    @property
    def transient(self) -> Bool[np.ndarray, "cells"]:
        """Whether each cell is in no persistent group."""
        return self.group < 0

    @functools.cached_property
    def ends(self) -> Absorption | None:
        """The probabilities of ending in each group; of a current that repeats, at each phase.

        `None` if they would take more than 256 MiB, or are not good enough to be shown: where the
        current holds drifters nearly for ever in transient cells, 64-bit numbers may not say where
        they end after all.
        """
        behaviour = self.behaviour
        if 8 * behaviour.groups.count * behaviour.unrolled.cells > _MAX_TABLE:
            return None
        found = absorption_probabilities(behaviour.unrolled, behaviour.groups, throw=False)
        return found if found.certificate.outcome is Outcome.CONVERGED else None

    @functools.cached_property
    def leaving(self) -> Float[np.ndarray, "cells"]:
        """The probability of ending off the map from each cell; NaN if not known.

        Where no drifter can leave it is 0, and where none can stay 1, whatever is known of `ends`.
        """
        sure = self.begins.sure_to_leave
        if not np.isnan(sure).any() or self.ends is None:
            return sure
        return np.asarray(self.ends.leaving)[: self.water.cells]

    @property
    def almost_for_ever(self) -> Bool[np.ndarray, "cells"]:
        """The transient cells from which drifters are practically never in a persistent group."""
        return ~(np.asarray(self.begins.absorption.value) <= ALMOST_FOR_EVER)

    @derived("", "depth", "m")
    def depth(self) -> float:
        return self.water.depth

    @derived("piece", "cells of connected pieces", kind="count", listed=True)
    def pieces(self) -> Int[np.ndarray, "pieces"]:
        return self.diagnosis.pieces

    @derived("", "mean drift in a step, in cells")
    def mean_shift_cells(self) -> float:
        return self.diagnosis.mean_shift

    @derived("", "cells that are mapped to themselves", kind="share")
    def self_image_share(self) -> float:
        return self.diagnosis.self_image

    @derived("compared", "time after which the map is compared with drifters", "h", kind="time")
    def compared_hours(self) -> Float[np.ndarray, "times"]:
        return self.distance.hours

    @derived("compared", "drifters that the map has in a wrong cell", kind="share", listed=True)
    def compared_distance(self) -> Float[np.ndarray, "times"]:
        return self.distance.total_variation

    @derived("", "warning")
    def warning(self) -> str | None:
        return self.diagnosis.warning

    @derived("remedy", "parameters that may help", listed=True)
    def remedies(self) -> tuple[str, ...] | None:
        return self.diagnosis.remedies(self.options.get("spread", "turned")) or None

    @derived("group_index", "cells", kind="count")
    def groups_cells(self) -> Int[np.ndarray, "groups"]:
        return np.asarray(self.begins.groups.size)

    @derived("group_index", "others that lead there for sure", kind="count")
    def groups_single_domicile_cells(self) -> Int[np.ndarray, "groups"]:
        basin = np.asarray(self.begins.basin)
        return np.bincount(basin[(basin >= 0) & self.transient], minlength=self.persistent_groups)

    @derived("group_index", "longitude", "degrees_east")
    def groups_lon(self) -> Float[np.ndarray, "groups"]:
        return self.water.lon[self._first]

    @derived("group_index", "latitude", "degrees_north")
    def groups_lat(self) -> Float[np.ndarray, "groups"]:
        return self.water.lat[self._first]

    @property
    def _first(self) -> tuple[Int[np.ndarray, "groups"], Int[np.ndarray, "groups"]]:
        """The row and column of the smallest cell of each persistent group."""
        persistent = np.flatnonzero(~self.transient)
        _, first = np.unique(self.group[persistent], return_index=True)
        return self.water.row[persistent[first]], self.water.column[persistent[first]]

    @derived("transient", "groups that it may end in, -1 for off the map")
    def transients_domiciles(self) -> np.ndarray:
        homes = self.begins.transient.domiciles
        return np.fromiter(homes, object, len(homes))

    @derived("transient", "cells", kind="count")
    def transients_cells(self) -> Int[np.ndarray, "transients"]:
        return np.asarray(self.begins.transient.size)

    @derived("transient", "time to the end, mean", "h", kind="time")
    def transients_mean_hours(self) -> Float[np.ndarray, "transients"]:
        return np.array([hours.mean() for hours in self._hours_of_parts])

    @derived("transient", "time to the end, longest", "h", kind="time")
    def transients_longest_hours(self) -> Float[np.ndarray, "transients"]:
        return np.array([hours.max() for hours in self._hours_of_parts])

    @functools.cached_property
    def _hours_of_parts(self) -> list[Float[np.ndarray, "some"]]:
        """The absorption times of the cells of each transient group."""
        part = np.asarray(self.begins.transient.group)[self.transient]
        order, counts = np.argsort(part, kind="stable"), self.transients_cells
        return np.split(self._hours[order], np.cumsum(counts)[:-1]) if counts.size else []

    @property
    def remarks(self) -> tuple[str, ...]:
        found = []
        if self.warning is not None:
            advice = {"duration": "a longer duration", "spread": 'the spread "sampled"'}
            instead = " or ".join(advice[one] for one in self.remedies or ())
            found.append(f"At {self.depth:g} m: {self.warning}{instead and f'; take {instead}'}.")
        if (far := self.distance).worst > FAR:
            found.append(
                f"At {self.depth:g} m: after {far.worst_hours:.3g} h the map has {far.worst:.0%} "
                f"of drifters in a wrong cell; {_instead(self.closer)}."
            )
        if self.almost_for_ever_cells:
            found.append(
                f"At {self.depth:g} m: from {self.almost_for_ever_cells:,} transient cells it "
                "takes almost for ever; what holds drifters there is as good as a persistent group."
            )
        return tuple(found)

    def checks(self) -> Checks:
        """Relations between the chain, its groups, and where and when drifters end.

        Times are reported only: where drifters stay almost for ever no solve is good.
        """
        P = self.behaviour.chain.to_scipy()
        entries, total = P.tocoo(), np.asarray(P.sum(axis=1)).ravel()
        # Of a current that repeats itself, of the cells at each phase.
        group = np.asarray(self.behaviour.groups.group)
        transient = group < 0
        out = (group[entries.row] >= 0) & (group[entries.row] != group[entries.col])
        gone = ~transient & (total < 1 - PROBABILITY)
        hours, step = np.asarray(self.behaviour.hours), self.behaviour.duration / 3600
        with np.errstate(invalid="ignore"):
            late = np.abs(step + P @ hours - hours)[transient] / np.maximum(hours[transient], step)
        sums = mean = np.zeros(0)
        if self.ends is not None:
            chance = np.asarray(self.ends.value).T
            sums = np.abs(chance.sum(axis=1) + np.asarray(self.ends.leaving) - 1)
            mean = np.abs(P @ chance - chance)[transient]
        return {
            "rows_sum_to_more_than_1": (max(0.0, float(total.max() - 1)), PROBABILITY),
            "steps_out_of_persistent_groups": (int(out.sum() + gone.sum()), 0),
            "absorption_time_residual": (
                float(np.max(late[np.isfinite(late)], initial=0.0)),
                np.inf,
            ),
            "ends_sum_to_1": (float(sums.max(initial=0.0)), PROBABILITY),
            "ends_residual": (float(mean.max(initial=0.0)), PROBABILITY),
        }


def _instead(closer: tuple[str, Distance] | None) -> str:
    if closer is None:
        return "no other duration or method that was tried brings it closer"
    setting, distance = closer
    return f"by {setting} it is {distance.worst:.0%} at most, after {distance.worst_hours:.3g} h"
