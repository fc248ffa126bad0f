import dataclasses
import functools

import numpy as np
import numpy.typing as npt
import xarray as xr
from jaxtyping import Bool, Float, Int

from ..certificate import Outcome
from ..drift import (
    CoverageCurve,
    Deployment,
    Diagnosis,
    Flow,
    LongTermBehaviour,
    Sea,
    VisibleDeployment,
    Voyage,
    Water,
    reachable_at_depth,
    reachable_by_layer,
)
from ..markov import Absorption, absorption_probabilities


ALMOST_FOR_EVER = 10_000
"""A drifter that takes more steps than this on average is said to take almost for ever."""
# Bytes that the probabilities of all groups of a layer may take.
_LARGEST_TABLE = 2**28


@dataclasses.dataclass(frozen=True, eq=False)
class SeaDrift:
    """What becomes of drifters in some layers of the sea: what is kept and shown together.

    The surface of the bundled sea at its first record:

        >>> from jaxcell import drift, record
        >>> from jaxcell.bundled import bundled
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> water, flow = drift.Water.of(currents), drift.Flow.of(currents)
        >>> chain, duration = drift.drift_map(water, flow), drift.crossing_time(water, flow)
        >>> behaviour = drift.long_term_behaviour(chain, duration)
        >>> diagnosis = drift.diagnose(water, flow, behaviour.groups)
        >>> deployment, minimum = drift.deployment_cells(behaviour), drift.minimum_deployment(chain)
        >>> found = record.SeaDrift(currents, (behaviour,), (diagnosis,), deployment, minimum)
        >>> found.sea.cells, found.depths, round(found.duration / 60)
        (538, [0.0], 31)
    """

    currents: xr.Dataset
    "As from [`jaxcell.drift.open_currents`][]."
    behaviours: tuple[LongTermBehaviour, ...]
    "The long-term behaviour of each layer, the surface first, by steps of one duration."
    diagnoses: tuple[Diagnosis, ...]
    "How far it can be trusted in each layer."
    deployment: Deployment
    "Where to drop drifters at the surface."
    minimum: Int[np.ndarray, "drifters"]
    "The fewest cells from which all those of the surface may be visited."
    curve: CoverageCurve | None = None
    "How many cells a number of drifters may visit."
    views: VisibleDeployment | None = None
    "Where to drop drifters that look at the sea bed."
    reach: float | None = None
    "How far these see, in metres."
    start: int | None = None
    "The cell of the surface where a drifter is dropped."
    voyage: Voyage | None = None
    "Its way to a goal."
    surest: Voyage | None = None
    "The way that most likely arrives."

    def __post_init__(self) -> None:
        """**Raises:** `ValueError` for parts that are not of the same cells or layers."""
        layers = self.currents.sizes["layer"]
        for name, given in (("behaviours", self.behaviours), ("diagnoses", self.diagnoses)):
            if len(given) != layers:
                raise ValueError(f"{name}: expected {layers}, one a layer, got {len(given)}")
        durations = {one.duration for one in self.behaviours}
        if len(durations) > 1:
            raise ValueError(f"behaviours: expected steps of one duration, got {sorted(durations)}")
        surface = self.waters[0].cells
        if self.start is not None and not 0 <= self.start < surface:
            raise ValueError(f"start: expected a cell of the surface, 0 to {surface - 1}")
        for name, voyage in (("voyage", self.voyage), ("surest", self.surest)):
            if voyage is not None and voyage.goal.size != self.sea.cells:
                raise ValueError(
                    f"{name}: expected that of {self.sea.cells} cells, got {voyage.goal.size}"
                )
        if self.views is not None and self.reach is None:
            raise ValueError("views: expected their reach too")

    @property
    def duration(self) -> float:
        """Seconds that a step takes."""
        return self.behaviours[0].duration

    @functools.cached_property
    def waters(self) -> tuple[Water, ...]:
        """The water cells of each layer."""
        return tuple(Water.of(self.currents, k) for k in range(self.currents.sizes["layer"]))

    @functools.cached_property
    def flows(self) -> tuple[Flow, ...]:
        """The flow of each layer at all records."""
        return tuple(Flow.of(self.currents, k) for k in range(len(self.waters)))

    @functools.cached_property
    def sea(self) -> Sea:
        """The cells of all layers."""
        return Sea.of(self.waters, [one.chain for one in self.behaviours])

    @property
    def depths(self) -> list[float]:
        """Of each layer, in metres."""
        return [water.depth for water in self.waters]

    @functools.cached_property
    def reached(self) -> tuple[Bool[np.ndarray, "cells"], Bool[np.ndarray, "cells"]] | None:
        """What drifters from the start may come to: those that stay in their layers, and those that
        go up and down."""
        if self.start is None:
            return None
        return reachable_by_layer(self.sea, self.start), reachable_at_depth(self.sea, self.start)

    @functools.cached_property
    def ends(self) -> tuple[Absorption | None, ...]:
        """The probabilities of ending in each group of each layer.

        `None` if they would take more than 256 MiB, or are not good enough to be told: where the
        current holds drifters nearly for ever in transient cells, 64-bit numbers may not say where
        they end after all.
        """
        return tuple(map(_ends, self.behaviours))

    def leaving(self, layer: int) -> Float[np.ndarray, "cells"]:
        """The probability of ending off the grid from each cell of a layer; NaN if not known.

        Where no drifter can leave it is 0, and where none can stay 1, whatever is known of `ends`.
        """
        ends = self.ends[layer]
        return self.behaviours[layer].sure_to_leave if ends is None else np.asarray(ends.leaving)

    def almost_for_ever(self, layer: int) -> Bool[np.ndarray, "cells"]:
        """The transient cells from which drifters are practically never in a persistent group."""
        return ~(np.asarray(self.behaviours[layer].absorption.value) <= ALMOST_FOR_EVER)

    def of_layer(self, values: npt.ArrayLike, layer: int) -> np.ndarray:
        """The part of values over all cells that is of one layer."""
        return np.asarray(values)[self.sea.layer == layer]

    @functools.cached_property
    def squares(
        self,
    ) -> tuple[
        Int[np.ndarray, "cells"],
        Int[np.ndarray, "cells"],
        Int[np.ndarray, "cells"],
    ]:
        """The layer, row and column of every cell of the sea."""
        row = np.concatenate([water.row for water in self.waters])
        column = np.concatenate([water.column for water in self.waters])
        return self.sea.layer, row, column

    def places(self, cells: npt.ArrayLike) -> list[tuple[float, float, float]]:
        """The longitudes and latitudes of cells in degrees, and their depths in metres."""
        layer, row, column = (one[np.asarray(cells, int)] for one in self.squares)
        water = self.waters[0]
        lon, lat, depth = water.lon[row, column], water.lat[row, column], np.array(self.depths)
        return list(zip(lon.tolist(), lat.tolist(), depth[layer].tolist(), strict=True))

    def place(self, cell: int) -> tuple[float, float, float]:
        """The longitude and latitude of a cell in degrees, and its depth in metres."""
        return self.places([cell])[0]


def _ends(behaviour: LongTermBehaviour) -> Absorption | None:
    if 8 * behaviour.groups.count * behaviour.chain.cells > _LARGEST_TABLE:
        return None
    found = absorption_probabilities(behaviour.chain, behaviour.groups, throw=False)
    return found if found.certificate.outcome is Outcome.CONVERGED else None
