"""The *ends* of drifters: persistent groups or exits of the map, with probabilities and times."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ...base.quantities import PROBABILITY, Checks, Result, derived, from_part
from ...mapping import Chain
from ...mapping.generalized import leaving_rows
from ...markov import Absorption, absorption_probabilities
from ...markov.hitting import absorption
from ...markov.transient import Transient
from ..long_term import LongTermBehaviour
from ..maps import EXITS
from ..water import Water
from .flattened import flattened


ALMOST_FOREVER = 10_000
"""The expected number of steps to a group or exit that counts as almost forever."""
LARGEST_TABLE = 2**28
"""The largest number of bytes for the probabilities of all groups of a layer."""
LARGE, LARGEST_SOLVE = 200_000, 2_000_000
"""On maps of more than `LARGE` states (cells times phases) a linear solve takes seconds. There
probabilities are computed only if states times ends (groups or exits) are at most
`LARGEST_SOLVE`."""

_probability = functools.partial(derived, kind="share", padding="NaN: not known")
_time = functools.partial(derived, units="h", kind="time")


@dataclasses.dataclass(frozen=True, eq=False)
class EndTotals(Result):
    """Totals over one or more layers: groups, transient cells, and absorption times."""

    layers: "Sequence[LayerEnds]"

    @functools.cached_property
    def transient_hours(self) -> Float[np.ndarray, "transient"]:
        """The absorption times of the transient cells, in hours."""
        return np.concatenate([layer.transient_hours for layer in self.layers])

    @derived("", "cells of water", kind="count")
    def cells(self) -> int:
        return sum(layer.water.cells for layer in self.layers)

    @derived("", "persistent groups", kind="count")
    def persistent_groups(self) -> int:
        return sum(layer.behaviour.groups.count for layer in self.layers)

    @derived("", "cells of persistent groups", kind="count")
    def persistent_cells(self) -> int:
        return self.cells - self.transient_hours.size

    @derived("", "transient groups", kind="count")
    def transient_groups(self) -> int:
        return sum(layer.begins.transient.count for layer in self.layers)

    @derived("", "transient cells with one end", kind="count")
    def single_domicile_cells(self) -> int:
        parts = [layer.begins.transient for layer in self.layers]
        return sum(int(np.asarray(part.size)[part.single].sum()) for part in parts)

    @derived("", "transient cells with several ends", kind="count")
    def multiple_domicile_cells(self) -> int:
        return self.transient_hours.size - self.single_domicile_cells

    @_time("", "in the long run: time to a group or off the map, mean")
    def mean_hours(self) -> float:
        return float(self.transient_hours.mean()) if self.transient_hours.size else 0.0

    @_time("", "in the long run: time to a group or off the map, median")
    def median_hours(self) -> float:
        return float(np.median(self.transient_hours)) if self.transient_hours.size else 0.0

    @_time("", "in the long run: time to a group or off the map, longest")
    def longest_hours(self) -> float:
        return float(self.transient_hours.max(initial=0.0))

    @derived("", "whether these times are certified", kind="flag")
    def times_certified(self) -> bool:
        solves = [layer.behaviour.absorption.certificate for layer in self.layers]
        return all(solve.converged for solve in solves)

    @derived("", "cells that take almost forever", kind="count")
    def almost_for_ever_cells(self) -> int:
        return sum(int(layer.almost_forever.sum()) for layer in self.layers)

    @_probability("", "in the long run: share that leaves the map")
    def mean_leaving(self) -> float:
        leaving = [layer.mean_by_way.sum() for layer in self.layers]
        return float(mean_over_cells(self.layers, leaving))

    @_probability("", "in the long run: share that leaves into sea without data")
    def mean_leaving_into_gaps(self) -> float | None:
        return self._left_by(0) if self.gap_squares else None

    @_probability("", "in the long run: share that leaves off the edge of the grid")
    def mean_leaving_off_edge(self) -> float | None:
        return self._left_by(slice(2, None))

    @_probability("", "in the long run: share that strands on land")
    def mean_stranding(self) -> float | None:
        strand = any(layer.water.coast == "strand" for layer in self.layers)
        return self._left_by(1) if strand else None

    @_probability("exit", "share that ever leaves by it", listed=True)
    def mean_leaving_by_way(self) -> Float[np.ndarray, "exits"] | None:
        by_way = [layer.mean_by_way for layer in self.layers]
        return mean_over_cells(self.layers, by_way) if self._knows_exits else None

    @derived("", "squares of land or sea bed", kind="count")
    def land_squares(self) -> int | None:
        count = sum(int(layer.water.land.sum()) for layer in self.layers)
        return count if self._knows_exits else None

    @derived("", "squares of sea without data", kind="count")
    def gap_squares(self) -> int | None:
        count = sum(int(layer.water.gaps.sum()) for layer in self.layers)
        return count if self._knows_exits else None

    @property
    def _knows_exits(self) -> bool:
        """True if the probability of leaving is known for each exit, and not only in total."""
        return all(len(layer.exits) == len(EXITS) for layer in self.layers)

    def _left_by(self, ways: slice | int) -> float | None:
        by_way = self.mean_leaving_by_way
        return None if by_way is None else float(by_way[ways].sum())


def mean_over_cells(layers: "Sequence[LayerEnds]", values: npt.ArrayLike) -> Any:
    """Average values of layers, each weighted by the number of cells of its layer."""
    return np.average(np.asarray(values), 0, [layer.water.cells for layer in layers])


@dataclasses.dataclass(frozen=True, eq=False)
class LayerEnds(Result):
    """The groups or exits in which drifters of one layer end, with probabilities and times."""

    brief: ClassVar[tuple[str, ...]] = ("cells", "persistent_groups")
    tables: ClassVar[Mapping[str, str]] = {"group_index": "groups", "transient": "transients"}

    water: Water
    behaviour: LongTermBehaviour

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return a quantity of a part, which [`flattened`][] makes an attribute."""

    @flattened()
    def end_totals(self) -> EndTotals:
        return EndTotals((self,))

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
        """The mask of the cells that belong to no persistent group."""
        return self.group < 0

    @functools.cached_property
    def transient_hours(self) -> Float[np.ndarray, "transient"]:
        """The absorption times of the transient cells, in hours."""
        return np.asarray(self.begins.hours)[self.transient]

    @functools.cached_property
    def ends(self) -> Absorption | None:
        """The probabilities of ending in each group, at each phase of a periodic current.

        The result is `None` if it would take more than 256 MiB or minutes to compute, or if it is
        not accurate enough: 64-bit numbers may not suffice if transient cells almost trap drifters.
        """
        behaviour, count = self.behaviour, self.behaviour.groups.count
        if 8 * count * behaviour.unrolled.cells > LARGEST_TABLE or not self._solvable(count):
            return None
        ends = absorption_probabilities(behaviour.unrolled, behaviour.groups, throw=False)
        return ends if ends.certificate.converged else None

    @functools.cached_property
    def exits(self) -> Float[np.ndarray, "exits states"]:
        """The probability of leaving the map in a step through each exit.

        If the current is unknown, as for observed drifters, there is a single row for all exits.
        """
        return leaving_rows(self.behaviour.unrolled.to_scipy())[None]

    @functools.cached_property
    def leaving(self) -> Float[np.ndarray, "cells"]:
        """The probability of ending off the map from each cell; NaN if unknown."""
        if self._solvable(self._possible_exits):
            return self.leaving_by_way.sum(axis=0)
        return self._leaving_by(self.exits.sum(axis=0, keepdims=True))[0]

    @functools.cached_property
    def leaving_by_way(self) -> Float[np.ndarray, "exits cells"]:
        """The probability of ever leaving the map through each exit, from each cell.

        On large maps with several exits it is NaN unless known to be 0, because solves take long.
        """
        if self._solvable(self._possible_exits):
            return self._leaving_by(self.exits)
        possible = np.any(self.exits, axis=1)[:, None]
        return np.where(possible & (self.begins.sure_to_leave != 0), np.nan, 0.0)

    @property
    def _possible_exits(self) -> int:
        return int(np.count_nonzero(self.exits.any(axis=1)))

    def _solvable(self, count: int) -> bool:
        """Return whether the probabilities of `count` ends can be computed within seconds."""
        states = self.behaviour.unrolled.cells
        return count <= 1 or states <= LARGE or count * states <= LARGEST_SOLVE

    def _leaving_by(
        self, in_a_step: Float[np.ndarray, "exits states"]
    ) -> Float[np.ndarray, "exits cells"]:
        """Compute the probabilities of ever leaving, from those `in_a_step`; NaN if inaccurate."""
        behaviour, cells = self.behaviour, self.water.cells
        possible, sure = np.any(in_a_step, axis=1), self.begins.sure_to_leave
        # No solve is needed if from each cell no drifter (0) or every drifter (1) leaves.
        if possible.sum() <= 1 and not np.isnan(sure).any():
            return np.where(possible[:, None], sure, 0.0)
        # All persistent groups are one end, and each way out is another.
        matrix, count = behaviour.unrolled.to_scipy(), len(in_a_step)
        out = scipy.sparse.csr_array(in_a_step.T)
        stay = scipy.sparse.eye_array(count)
        chain = Chain.from_scipy(scipy.sparse.block_array([[matrix, out], [None, stay]]))
        group = np.append(np.asarray(behaviour.groups.group).clip(-1, 0), 1 + np.arange(count))
        solved = absorption(chain, group, 1 + count, throw=False)
        if not solved.certificate.converged:
            return np.where(possible[:, None] & (sure != 0), np.nan, 0.0)
        return np.asarray(solved.value)[1:, :cells]

    @functools.cached_property
    def mean_by_way(self) -> Float[np.ndarray, "exits"]:
        """The mean of `leaving_by_way` over the cells; NaN if unknown."""
        by_cell = self.leaving_by_way.mean(axis=1)
        behaviour, cells = self.behaviour, self.water.cells
        if not np.isnan(by_cell).any():
            return by_cell
        transient = np.asarray(behaviour.groups.group) < 0
        part = Transient.of(behaviour.unrolled.to_scipy(), transient)
        visits = part.visits((part.cells < cells) / cells).value
        mean = self.exits[:, part.cells] @ visits
        # If an eddy almost traps drifters, 64-bit numbers are too inaccurate.
        known = np.isfinite(mean).all() and mean.sum() <= 1 + PROBABILITY
        return mean if known else np.full(mean.size, np.nan)

    @property
    def almost_forever(self) -> Bool[np.ndarray, "cells"]:
        """The mask of the cells whose absorption time exceeds `ALMOST_FOREVER` steps."""
        return ~(np.asarray(self.begins.absorption.value) <= ALMOST_FOREVER)

    depth = from_part("water.depth", "", "depth", "m")

    @derived("group_index", "cells", kind="count")
    def groups_cells(self) -> Int[np.ndarray, "groups"]:
        return np.asarray(self.begins.groups.size)

    @derived("group_index", "other cells that lead there for sure", kind="count")
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
        """The row and column of the first cell of each persistent group."""
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

    @_time("transient", "time to the end, mean")
    def transients_mean_hours(self) -> Float[np.ndarray, "transients"]:
        return np.array([hours.mean() for hours in self._hours_of_parts])

    @_time("transient", "time to the end, longest")
    def transients_longest_hours(self) -> Float[np.ndarray, "transients"]:
        return np.array([hours.max() for hours in self._hours_of_parts])

    @functools.cached_property
    def _hours_of_parts(self) -> list[Float[np.ndarray, "cells"]]:
        """The absorption times of the cells of each transient group, in hours."""
        part = np.asarray(self.begins.transient.group)[self.transient]
        order, counts = np.argsort(part, kind="stable"), self.transients_cells
        return np.split(self.transient_hours[order], np.cumsum(counts)[:-1]) if counts.size else []

    @property
    def remarks(self) -> tuple[str, ...]:
        if not self.almost_for_ever_cells:
            return ()
        return (
            f"At {self.depth:g} m: from {self.almost_for_ever_cells:,} transient cells it "
            "takes almost forever; what holds drifters there is as good as a persistent group.",
        )

    def checks(self) -> Checks:
        """Return checks that groups, probabilities and absorption times agree with the chain.

        Absorption times may have any residual: no solve is accurate if cells almost trap drifters.
        """
        P = self.behaviour.chain.to_scipy()
        entries, total = P.tocoo(), np.asarray(P.sum(axis=1)).ravel()
        # In a periodic current these are over the cells at each phase.
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
            "absorption_time_residual": (float(late[np.isfinite(late)].max(initial=0.0)), np.inf),
            "ends_sum_to_1": (float(sums.max(initial=0.0)), PROBABILITY),
            "ends_residual": (float(mean.max(initial=0.0)), PROBABILITY),
        }
