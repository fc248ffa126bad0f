import dataclasses
import functools
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from ...base.quantities import derived, from_part
from ..behaviour import long_term_behaviour
from ..maps import EXITS, drift_maps
from ..validation.diagnosis import group_counts
from ..validation.distance import MOST_CELLS
from .ends import LayerEnds
from .layer import Compared, Layer
from .sea_layers import SeaLayers


# The factors by which the durations of other steps differ.
_FACTORS = (0.5, 1.0, 2.0)
_PADDING = "NaN: no water, or not known"
_share = functools.partial(derived, units="1", kind="share", padding=_PADDING)


def _by_time(name: str, meaning: str) -> Any:
    """Build a property, described by `meaning`: the array `name` of each layer's [`Distance`][]."""
    return derived("layer compared", meaning, "1", kind="share")(
        lambda sea: np.stack([getattr(layer.compared, name) for layer in sea.layers])
    )


@dataclasses.dataclass(frozen=True, eq=False)
class SeaCurrents(SeaLayers, Compared):
    """The long-term behaviour of drifters in a current, and the distance of maps from drifters."""

    layers: tuple[Layer, ...]
    currents: xr.Dataset
    "The currents, a dataset of [`jaxcell.drift.open_currents`][]."

    def __post_init__(self) -> None:
        super().__post_init__()
        layers = self.currents.sizes["layer"]
        if len(self.layers) != layers:
            raise ValueError(f"layers: expected {layers}, got {len(self.layers)}")

    @derived("", "rule at the coast")
    def coast(self) -> str:
        return self.waters[0].coast

    @derived("exit", "way out of the map", kind="text", listed=True)
    def exit(self) -> np.ndarray:
        return np.array(EXITS)

    @_share("layer exit y x", "probability of ending off the map, by the way out")
    def leaving_by_way(self) -> Float[np.ndarray, "layers exits rows columns"]:
        by_way = [layer.leaving_by_way for layer in self.layers]
        ways = (np.concatenate([shares[way] for shares in by_way]) for way in range(len(EXITS)))
        return np.stack([self.sea.on_squares(way) for way in ways], axis=1)

    @derived("layer y x", "land or sea bed", kind="flag")
    def land(self) -> Bool[np.ndarray, "layers rows columns"]:
        return np.stack([water.land for water in self.waters])

    @derived("layer y x", "sea without data", kind="flag")
    def sea_without_data(self) -> Bool[np.ndarray, "layers rows columns"]:
        return np.stack([water.gaps for water in self.waters])

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
        return (self._entries.row // self.cells).astype(np.int32)

    @derived("other_step", "duration of another step", "s")
    def sensitivity_duration(self) -> Float[np.ndarray, "steps"] | None:
        return None if self._counts is None else np.array(self._other_steps)

    @derived("other_step", "persistent groups at the surface", kind="count")
    def sensitivity_groups(self) -> Int[np.ndarray, "steps"] | None:
        return None if self._counts is None else self._counts[0]

    @derived("other_step", "persistent groups, by the centres of cells alone", kind="count")
    def sensitivity_groups_if_known(self) -> Int[np.ndarray, "steps"] | None:
        return None if self._counts is None else self._counts[1]

    @derived(
        "other_step", "in the long run: time to a group or off the map, median", "h", kind="time"
    )
    def sensitivity_median_hours(self) -> Float[np.ndarray, "steps"] | None:
        if self._by_other_steps is None:
            return None
        return np.array([ends.median_hours for ends in self._by_other_steps])

    @functools.cached_property
    def _by_other_steps(self) -> list[LayerEnds] | None:
        """The ends of surface drifters for each step in `_other_steps`; `None` for large maps."""
        surface = self.layers[0]
        if surface.cells * surface.by.phases(self._other_steps[0]) > MOST_CELLS:
            return None

        def ends(seconds: float) -> LayerEnds:
            if np.isclose(seconds, self.step):
                return surface
            chain = drift_maps(surface.water, surface.by, surface.step.lasting(seconds))
            return LayerEnds(surface.water, long_term_behaviour(chain, seconds))

        return [*map(ends, self._other_steps)]

    @functools.cached_property
    def _counts(self) -> Int[np.ndarray, "2 steps"] | None:
        """The number of groups by duration: row 0 for the maps, row 1 if only cell centres move."""
        surface = self.layers[0]
        # With diffusion each piece of water is one group.
        if self._by_other_steps is None or surface.by.diffusivity:
            return None
        # With `rho` = 1 there is no disturbance, and each cell has one image.
        centres = dataclasses.replace(surface.step, rho=1.0, spread="turned")
        steps = [centres.lasting(seconds) for seconds in self._other_steps]
        by_centres = group_counts(surface.water, surface.by, steps)
        return np.stack([[one.persistent_groups for one in self._by_other_steps], by_centres])

    @property
    def _other_steps(self) -> list[float]:
        """The durations of steps to compare, in seconds; the second is the duration of the maps."""
        return [self.layers[0].by.fitted(factor * self.step) for factor in _FACTORS]

    @derived("", "time that the records cover", "h", kind="time")
    def covered_hours(self) -> float:
        flow = self.layers[0].flow
        if flow.period is not None:
            return float(flow.period) / 3600
        return float(np.ptp(np.asarray(flow.time))) / 3600

    @_share(
        "layer y x",
        "drifters from the cell that the map has in a wrong part of 36 at the time asked",
    )
    def distance_by_cell(self) -> Float[np.ndarray, "layers rows columns"] | None:
        return self._by_cell(0)

    @_share("layer y x", "the same by chance, because drifters are finite")
    def distance_by_cell_noise(self) -> Float[np.ndarray, "layers rows columns"] | None:
        return self._by_cell(1)

    def _by_cell(self, number: int) -> Any:
        if any(layer.by_cell is None for layer in self.layers):
            return None
        return self._on_squares(lambda layer: layer.by_cell[number])  # type: ignore[attr-defined]

    compared_distance = _by_time(
        "total_variation", "drifters that the map has in a wrong cell, released everywhere"
    )
    compared_noise = _by_time("noise", "the same by chance, because drifters are finite")
    compared_drifters_left = _by_time("drifters_left", "drifters that left the map")
    compared_map_left = _by_time("map_left", "drifters that left, by the map of cells")
