"""Where drifters end up, and how soon: what one says of any layer of water and its chain."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.certificate import Outcome
from ..base.quantities import PROBABILITY, Checks, Result, derived
from ..markov import Absorption, absorption_probabilities
from .behaviour import LongTermBehaviour
from .water import Water


ALMOST_FOR_EVER = 10_000
"""A drifter that takes more steps than this on average is said to take almost for ever."""
# Bytes that the probabilities of all groups of a layer may take.
_MAX_TABLE = 2**28


class Ends(Result):
    """Where drifters of one layer or more end up, and how soon: what is counted of all of them."""

    @property
    def _layers(self) -> "tuple[LayerEnds, ...]":
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

    @derived("", "time to a group or off the map, transient cells, mean", "h", kind="time")
    def mean_hours(self) -> float:
        return float(self._hours.mean()) if self._hours.size else 0.0

    @derived("", "time to a group or off the map, transient cells, median", "h", kind="time")
    def median_hours(self) -> float:
        return float(np.median(self._hours)) if self._hours.size else 0.0

    @derived("", "time to a group or off the map, transient cells, longest", "h", kind="time")
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
class LayerEnds(Ends):
    """Where drifters of one layer end up, and when."""

    brief: ClassVar[tuple[str, ...]] = ("cells", "persistent_groups")
    tables: ClassVar[Mapping[str, str]] = {"group_index": "groups", "transient": "transients"}

    water: Water
    behaviour: LongTermBehaviour

    @property
    def _layers(self) -> "tuple[LayerEnds, ...]":
        return (self,)

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
        if not self.almost_for_ever_cells:
            return ()
        return (
            f"At {self.depth:g} m: from {self.almost_for_ever_cells:,} transient cells it "
            "takes almost for ever; what holds drifters there is as good as a persistent group.",
        )

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
