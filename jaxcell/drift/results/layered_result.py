import dataclasses
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt
from jaxtyping import Float, Int

from ...base.quantities import Checks, derived
from ..layered_cells import Sea
from ..matched_ranks import basin_ranks
from ..water import Water
from .flattened import flattened
from .layer_ends import EndTotals, LayerEnds
from .on_map import OnMap


_SQUARES = "layer y x"
_number = functools.partial(derived, _SQUARES, kind="index", padding="-2: no water")
_PADDING = "NaN: no such group, no water, or not known"
_share = functools.partial(derived, units="1", kind="share", padding=_PADDING)


@dataclasses.dataclass(frozen=True, eq=False)
class LayeredResult(OnMap):
    """The long-term behaviour of drifters in layers of the sea, on the squares of the grid."""

    picture: ClassVar[str] = "basin"

    layers: tuple[LayerEnds, ...]
    "The layers, the surface first, all with steps of the same duration."

    def __post_init__(self) -> None:
        durations = {layer.behaviour.duration for layer in self.layers}
        if len(durations) > 1:
            raise ValueError(f"layers: expected steps of one duration, got {sorted(durations)}")

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return a quantity of a part, which [`flattened`][] makes an attribute."""

    @flattened()
    def end_totals(self) -> EndTotals:
        return EndTotals(self.layers)

    @property
    def waters(self) -> tuple[Water, ...]:
        """The water cells of each layer."""
        return tuple(layer.water for layer in self.layers)

    @functools.cached_property
    def sea(self) -> Sea:
        """The cells of all layers."""
        return Sea.of(self.waters, [layer.behaviour.chain for layer in self.layers])

    @property
    def depths(self) -> list[float]:
        """The depth of each layer, in metres."""
        return [water.depth for water in self.waters]

    def of_layer(self, values: npt.ArrayLike, layer: int) -> np.ndarray:
        """Select the values of one layer from values over all cells."""
        return np.asarray(values)[self.sea.layer == layer]

    def places(self, cells: npt.ArrayLike) -> list[tuple[float, float, float]]:
        """Return the longitudes and latitudes of cells in degrees, and their depths in metres."""
        lon, lat = self._lon_lat(cells)
        depth = np.array(self.depths)[self.sea.layer[np.asarray(cells, int)]]
        return list(zip(lon.tolist(), lat.tolist(), depth.tolist(), strict=True))

    def place(self, cell: int) -> tuple[float, float, float]:
        """Return the longitude and latitude of a cell in degrees, and its depth in metres."""
        return self.places([cell])[0]

    def _lon_lat(self, cells: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        _, row, column = (place[np.asarray(cells, int)] for place in self.sea.squares)
        return self.waters[0].lon[row, column], self.waters[0].lat[row, column]

    def _on_squares(
        self, values: Callable[[LayerEnds], npt.ArrayLike], fill: float | int = np.nan
    ) -> Any:
        """Arrange values of each layer's cells on the grid; squares without water get `fill`."""
        return self.sea.on_squares(
            np.concatenate([np.asarray(values(layer)) for layer in self.layers]), fill
        )

    @functools.cached_property
    def group_ranks(self) -> list[Int[np.ndarray, "_groups"]]:
        """The label of each group in pictures, by layer; groups one above another share a label."""
        return basin_ranks(
            [layer.water.on_grid(np.asarray(layer.begins.basin), -1) for layer in self.layers]
        )

    @derived(
        "layer group_index",
        "number of the group on maps, as of the matching group above",
        kind="index",
        padding="-1: no such group",
    )
    def group_number(self) -> Int[np.ndarray, "layers groups"]:
        most = max(rank.size for rank in self.group_ranks)
        padded = [np.pad(r, (0, most - r.size), constant_values=-1) for r in self.group_ranks]
        return np.stack(padded)

    @derived("layer", "depth", "m", kind="coordinate", standard_name="depth", positive="down")
    def depth(self) -> Float[np.ndarray, "layers"]:
        return np.array(self.depths)

    @derived("", "duration of a step", "s")
    def step(self) -> float:
        return self.layers[0].behaviour.duration

    @_number("number of the cell")
    def cell(self) -> Int[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(np.arange(self.cells, dtype=np.int32), -2)

    @_number("persistent group, -1 if transient")
    def group(self) -> Int[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda layer: layer.group, -2)

    @_number("transient group, -1 if persistent")
    def transient_group(self) -> Int[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda layer: layer.begins.transient.group, -2)

    @_number("group in which a drifter ends for sure, -1 if there is none")
    def basin(self) -> Int[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda layer: layer.begins.basin, -2)

    @derived(
        _SQUARES, "expected time until a drifter is in a group or off the map", "h", kind="time"
    )
    def absorption_time(self) -> Float[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda layer: layer.begins.hours)

    @_share(_SQUARES, "probability of ending off the map")
    def leaving(self) -> Float[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda layer: layer.leaving)

    @_share("layer group_index y x", "probability of ending in the group")
    def probability(self) -> Float[np.ndarray, "layers groups rows columns"] | None:
        known = {k: one.ends for k, one in enumerate(self.layers) if one.ends is not None}
        if not known:
            return None
        groups = max(len(ends.value) for ends in known.values())
        squares = np.full((len(self.layers), groups, *self.waters[0].number.shape), np.nan)
        for layer, ends in known.items():
            water = self.waters[layer]
            for group, row in enumerate(np.asarray(ends.value)):
                squares[layer, group] = water.on_grid(row[: water.cells])
        return squares

    @derived("transient", "layer of a transient group", kind="index")
    def transient_layer(self) -> Int[np.ndarray, "transients"]:
        counts = [one.begins.transient.count for one in self.layers]
        return np.repeat(np.arange(len(counts), dtype=np.int32), counts)

    @derived("transient", "number of the group in transient_group", kind="index")
    def transient_number(self) -> Int[np.ndarray, "transients"]:
        counts = [one.begins.transient.count for one in self.layers]
        return np.concatenate([np.arange(count, dtype=np.int32) for count in counts])

    @derived("transient_bound", "first entry of a transient group in domicile", kind="index")
    def domicile_offset(self) -> Int[np.ndarray, "bounds"]:
        return np.cumsum([0, *map(len, self._domiciles)], dtype=np.int64)

    @derived("domicile_entry", "groups that it may end in, -1 for off the map", kind="index")
    def domicile(self) -> Int[np.ndarray, "entries"]:
        return np.array([home for homes in self._domiciles for home in homes], np.int32)

    @property
    def _domiciles(self) -> list[tuple[int, ...]]:
        """For each transient group, the groups where its drifters may end; -1 is off the map."""
        return [homes for one in self.layers for homes in one.begins.transient.domiciles]

    @derived("entry", "cell", kind="index")
    def from_cell(self) -> Int[np.ndarray, "entries"]:
        return (self.sea.entries.row % self.cells).astype(np.int32)

    @derived("entry", "cell one step later", kind="index")
    def to_cell(self) -> Int[np.ndarray, "entries"]:
        return (self.sea.entries.col % self.cells).astype(np.int32)

    @derived("entry", "probability; the rest to 1 leaves the map", "1", kind="share")
    def transition(self) -> Float[np.ndarray, "entries"]:
        return self.sea.entries.data

    def checks(self) -> Checks:
        """Return the worst value of each check over the layers."""
        of_layers = [layer.checks() for layer in self.layers]
        return {
            name: (np.max([checks[name][0] for checks in of_layers]).item(), limit)
            for name, (_, limit) in of_layers[0].items()
        }
