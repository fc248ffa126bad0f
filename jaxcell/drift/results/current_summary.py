"""The currents behind a result: their source, their period, and the ways out of their map."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from ...base.quantities import Result, derived, from_part
from ..layered_cells import Sea
from ..maps import EXITS
from .current_layer import Layer


_squares = functools.partial(derived, "layer y x", kind="flag")


@dataclasses.dataclass(frozen=True, eq=False)
class CurrentSummary(Result):
    """The currents of all layers, with the squares and the probabilities of the ways out."""

    currents: xr.Dataset
    layers: Sequence[Layer]
    sea: Sea

    @derived("", "rule at the coast")
    def coast(self) -> str:
        return self.layers[0].water.coast

    @derived("exit", "way out of the map", kind="text", listed=True)
    def exit(self) -> np.ndarray:
        return np.array(EXITS)

    @derived(
        "layer exit y x",
        "probability of ending off the map, by the way out",
        "1",
        kind="share",
        padding="NaN: no water, or not known",
    )
    def leaving_by_way(self) -> Float[np.ndarray, "layers exits rows columns"]:
        by_way = np.concatenate([layer.leaving_by_way for layer in self.layers], axis=1)
        return np.stack([self.sea.on_squares(way) for way in by_way], axis=1)

    @_squares("land or sea bed")
    def land(self) -> Bool[np.ndarray, "layers rows columns"]:
        return np.stack([layer.water.land for layer in self.layers])

    @_squares("sea without data")
    def sea_without_data(self) -> Bool[np.ndarray, "layers rows columns"]:
        return np.stack([layer.water.gaps for layer in self.layers])

    east_from = from_part("currents.east_from", "", "current towards the East")
    north_from = from_part("currents.north_from", "", "current towards the North")

    @derived("note", "notes on the currents", listed=True)
    def notes(self) -> np.ndarray:
        return np.array(self.currents.attrs["notes"].splitlines(), np.str_)

    @derived("record", "records of the currents", listed=True)
    def records(self) -> np.ndarray:
        return np.datetime_as_string(self.currents.time.values, unit="s")

    @derived("", "period of the current", "h", kind="time")
    def period_hours(self) -> float | None:
        period = self.layers[0].by.period
        return None if period is None else float(period) / 3600

    @derived("", "maps in a period", kind="count")
    def phases(self) -> int | None:
        return None if self.period_hours is None else self.sea.phases

    @derived("entry", "phase of the current, from 0 at the first record", kind="index")
    def entry_phase(self) -> Int[np.ndarray, "entries"] | None:
        if self.phases is None:
            return None
        return (self.sea.entries.row // self.sea.cells).astype(np.int32)

    @derived("", "time that the records cover", "h", kind="time")
    def covered_hours(self) -> float:
        flow = self.layers[0].flow
        if flow.period is not None:
            return float(flow.period) / 3600
        return float(np.ptp(np.asarray(flow.time))) / 3600
