"""The distances between maps and simulated drifters: totals over layers, by layer, and by cell."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ...base.quantities import Result, derived
from ..sea import Sea
from ..validation.distance import Distance
from ..validation.release import ReleaseDistance
from .layer_ends import mean_over_cells


if TYPE_CHECKING:
    from .current_layer import Layer


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
