import dataclasses
import functools
from typing import Any

import numpy as np
import scipy.ndimage
import xarray as xr
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csgraph
from scipy.spatial import cKDTree

from ..base.shown import Shown
from ..currents.sphere import distances, goes_round, on_sphere


# Water is connected along sides and at corners, because drifters move both ways.
_AROUND = np.ones((3, 3), int)
# Offsets of the eight neighbours of a cell, in rows and columns.
NEIGHBORS = tuple((r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if (r, c) != (0, 0))
# Coordinates in cells are rounded to this number of decimals, so that ties are exact everywhere.
_DECIMALS = 9
# This number of nearest cells, by mean sides, is compared by the sides of the cell at the origin.
_CANDIDATES = 8
COASTS = ("hold", "slip", "strand")
"""The rules for drifters that run ashore, which [`Water`][] explains."""


@dataclasses.dataclass(frozen=True, eq=False)
class Water(Shown):
    """The water cells of one layer of the sea, numbered row by row.

    Each square of the grid is a water cell, land, or sea without data. The surface of the
    bundled sea:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> water = drift.Water.of(currents)
        >>> water.cells, int(water.boundary.sum()), water.on_grid(water.row, -1).shape
        (538, 144, (21, 29))
    """

    number: Int[np.ndarray, "rows columns"]
    "The number of the cell in each square of the grid; -1 where there is no water."
    dx: Float[np.ndarray, "rows columns"]
    "Length of each square along the x axis of the grid, in metres."
    dy: Float[np.ndarray, "rows columns"]
    angle: Float[np.ndarray, "rows columns"]
    "Angle from East to the x axis, counter-clockwise, in radians."
    lon: Float[np.ndarray, "rows columns"]
    "Longitude of each centre in degrees."
    lat: Float[np.ndarray, "rows columns"]
    depth: float
    "The depth of the layer below the surface, in metres."
    wraps: bool = False
    "True if the last column is beside the first, as on a grid that goes round the Earth."
    land: Bool[np.ndarray, "rows columns"] = None  # type: ignore[assignment]
    """Squares of land or of the sea bed, by default all squares without a cell. Other squares
    without a cell are sea without data, which is an open edge."""
    coast: str = "hold"
    """The rule for drifters that run ashore. With `"hold"`, water slows down towards land, and
    drifters stay in the nearest cell at the coast until the current carries them off. With `"slip"`
    they stay too, but water beside land flows along it without friction. With `"strand"`, water
    slows down, and a drifter that ends on land strands, and so leaves the map."""

    def __post_init__(self) -> None:
        if self.coast not in COASTS:
            raise ValueError(f"coast: expected 'hold', 'slip' or 'strand', got {self.coast!r}")
        if self.land is None:
            object.__setattr__(self, "land", self.number < 0)
        if (self.land & (self.number >= 0)).any():
            raise ValueError("land: expected squares without a cell, got some with one")

    @classmethod
    def of(cls, currents: xr.Dataset, layer: int = 0, coast: str = "hold") -> "Water":
        """Number the water cells of one layer.

        If the grid goes round the Earth, the last column is beside the first.

        **Arguments:**

        - `currents`: the currents, from [`jaxcell.drift.open_currents`][]; without `land`, all
            squares that are not water are land.
        - `layer`: number of the layer, from 0 at the surface.
        - `coast`: the rule for drifters that run ashore: `"hold"`, `"slip"` or `"strand"`.
        """
        layers = currents.sizes["layer"]
        if not 0 <= layer < layers:
            raise ValueError(f"layer {layer} does not exist; there are {layers}")
        wet = np.asarray(currents["water"].isel(layer=layer), bool)
        if not wet.any():
            raise ValueError(f"layer {layer} has no water")
        number = np.where(wet, np.cumsum(wet.ravel()).reshape(wet.shape) - 1, -1)
        names = ("dx", "dy", "angle", "lon", "lat")
        grid = {name: np.asarray(currents[name], np.float64) for name in names}
        return cls(
            number.astype(np.int32),
            **grid,
            depth=float(currents["depth"][layer]),
            wraps=goes_round(grid["lon"], grid["lat"]),
            land=np.asarray(currents["land"][layer], bool) if "land" in currents else ~wet,
            coast=coast,
        )

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.row.size

    @functools.cached_property
    def row(self) -> Int[np.ndarray, "cells"]:
        """The row of each cell; row 0 is the first of the file, usually in the South."""
        return np.nonzero(self.number >= 0)[0].astype(np.int32)

    @functools.cached_property
    def column(self) -> Int[np.ndarray, "cells"]:
        """The column of each cell; column 0 is the first of the file, usually in the West."""
        return np.nonzero(self.number >= 0)[1].astype(np.int32)

    @functools.cached_property
    def piece(self) -> Int[np.ndarray, "cells"]:
        """The number of the connected piece of sea that contains each cell.

        Pieces are numbered from 0 in the order of their first cells. Sea without data connects
        cells, too.
        """
        label, count = scipy.ndimage.label(~self.land, structure=_AROUND)
        if self.wraps:
            label = _joined(label, count)
        _, first, piece = np.unique(
            label[self.row, self.column], return_index=True, return_inverse=True
        )
        return np.argsort(np.argsort(first))[piece].astype(np.int32)

    @property
    def closed(self) -> Bool[np.ndarray, "rows columns"]:
        """The mask of the squares that drifters cannot enter: land, unless they strand there."""
        return self.land & (self.coast != "strand")

    @property
    def gaps(self) -> Bool[np.ndarray, "rows columns"]:
        """The mask of the squares of sea without data."""
        return (self.number < 0) & ~self.land

    @property
    def gone(self) -> Bool[np.ndarray, "rows columns"]:
        """The mask of the squares off the map: a drifter has left when it enters such a square."""
        return (self.number < 0) & ~self.closed

    @functools.cached_property
    def neighbor(self) -> Int[np.ndarray, "8 cells"]:
        """The eight neighbours of each cell, in the order of `NEIGHBORS`; -1 for no water."""
        around = np.pad(self.number, ((1, 1), (0, 0)), constant_values=-1)
        beside = {"mode": "wrap"} if self.wraps else {"constant_values": -1}
        around = np.pad(around, ((0, 0), (1, 1)), **beside)
        return np.stack([around[self.row + 1 + r, self.column + 1 + c] for r, c in NEIGHBORS])

    @functools.cached_property
    def boundary(self) -> Bool[np.ndarray, "cells"]:
        """The mask of cells with fewer than eight neighbours, at a coast or an edge of the grid."""
        return np.any(self.neighbor < 0, axis=0)

    @property
    def sides(self) -> Float[np.ndarray, "axes cells"]:
        """The sides of each cell along the x and y axes of the grid, in metres."""
        return np.stack([side[self.row, self.column] for side in (self.dx, self.dy)])

    @property
    def reach(self) -> Float[np.ndarray, "rows columns"]:
        """The largest distance from the centre of a square to a point in it, in metres.

        It is 1.01 times half the diagonal, because the Earth is not a sphere.
        """
        return np.hypot(self.dx, self.dy) / 2 * 1.01

    def cell(self, lon: float | int, lat: float | int) -> int:
        """Find the cell whose centre is nearest to a point in degrees.

        The longitude may be in any range, such as -180 to 180 or 0 to 360 degrees.
        """
        if not (np.isfinite(lon) and -90 <= lat <= 90):
            raise ValueError(f"place: expected a longitude and a latitude, got ({lon}, {lat})")
        place = on_sphere(*np.array([lon, lat], float)[:, None, None])
        away = distances(on_sphere(self.lon, self.lat), place)
        row, column = np.unravel_index(np.nanargmin(away), away.shape)
        if away[row, column] > self.reach[row, column]:
            raise ValueError(
                f"place ({lon:g}, {lat:g}) is off the grid: the nearest square is "
                f"{away[row, column] / 1000:.3g} km away, at ({self.lon[row, column]:g}, "
                f"{self.lat[row, column]:g})"
            )
        if self.number[row, column] < 0:
            wet = np.where(self.number >= 0, away, np.inf)
            nearest = np.unravel_index(np.argmin(wet), wet.shape)
            raise ValueError(
                f"place ({lon:g}, {lat:g}) is not in the water at {self.depth:g} m; the nearest "
                f"water is {wet[nearest] / 1000:.3g} km away, at ({self.lon[nearest]:g}, "
                f"{self.lat[nearest]:g})"
            )
        return int(self.number[row, column])

    def centre(self, weight: Float[np.ndarray, "cells"]) -> tuple[float, float]:
        """Compute the longitude and latitude of the mean of the cells on the sphere, in degrees.

        `weight` has the weight of each cell, such as its share of the drifters.
        """
        x, y, z = on_sphere(*(on[self.row, self.column] for on in (self.lon, self.lat))) @ weight
        return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arctan2(z, np.hypot(x, y))))

    def on_grid(self, values: np.ndarray, fill: float | int = np.nan) -> np.ndarray:
        """Arrange values of the cells on the grid; squares without water get `fill`."""
        grid = np.full(self.number.shape, fill, np.result_type(values, type(fill)))
        grid[self.row, self.column] = values
        return grid

    def at(
        self, row: Int[np.ndarray, "*points"], column: Int[np.ndarray, "*points"]
    ) -> tuple[Int[np.ndarray, "*points"], Bool[np.ndarray, "*points"]]:
        """Return the cell of each square, -1 if it is not water, and the mask of land squares."""
        rows, columns = self.number.shape
        if self.wraps:
            column = column % columns
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        at = row.clip(0, rows - 1), column.clip(0, columns - 1)
        return np.where(inside, self.number[at], np.int32(-1)), inside & self.land[at]

    def left(
        self, x: Float[np.ndarray, "*points"], y: Float[np.ndarray, "*points"]
    ) -> Bool[np.ndarray, "*points"]:
        """Mark the points off the grid, in sea without data or, if drifters strand, on land."""
        cell, land = self.at(*square(x, y))
        return (cell < 0) & ~(land & (self.coast != "strand"))

    def on_columns(self, x: Float[np.ndarray, "*points"]) -> Float[np.ndarray, "*points"]:
        """Wrap x coordinates onto the grid, if its columns go round the Earth."""
        return (x + 0.5) % self.number.shape[1] - 0.5 if self.wraps else x

    def landing(
        self,
        x: Float[np.ndarray, "branches points"],
        y: Float[np.ndarray, "branches points"],
        *,
        origin: Int[np.ndarray, "points"] | None = None,
        exits: bool = False,
    ) -> Int[np.ndarray, "branches points"]:
        """Find the cells in which drifters end.

        A drifter ends in the cell that contains its end point, if this cell is in the connected
        piece of water of its origin. Otherwise it ends in the nearest cell of that piece; distances
        are in metres, computed with the sides of the origin, and of equally near cells the cell
        with the smallest number is chosen.

        **Arguments:**

        - `x`, `y`: the end points, in columns and rows of the grid.
        - `origin`: the cell where each column of drifters began; by default 0, 1, 2, ...
        - `exits`: whether a drifter that ends off the grid or in sea without data leaves the map,
            so that its cell is -1. With the coast `"strand"`, drifters that end on land leave too.
        """
        origin = np.arange(self.cells) if origin is None else origin
        cell, _ = self.at(*square(x, y))
        ashore = (cell < 0) | (self.piece[cell] != self.piece[origin])
        if exits:
            ashore &= ~self.left(x, y)
        branch, point = np.nonzero(ashore)
        came = origin[point]
        for piece in np.unique(self.piece[came]):
            of_piece = self.piece[came] == piece
            at = branch[of_piece], point[of_piece]
            cell[at] = self._nearest(piece, came[of_piece], x[at], y[at])
        return cell

    def _nearest(
        self,
        piece: np.integer,
        origin: Int[np.ndarray, "points"],
        x: Float[np.ndarray, "points"],
        y: Float[np.ndarray, "points"],
    ) -> Int[np.ndarray, "points"]:
        """Find the cells of a piece of water that are nearest to points outside it."""
        # A cell with eight neighbours is not the nearest cell: one of its neighbours is nearer.
        shore = np.flatnonzero((self.piece == piece) & self.boundary)
        row, column = self.row[shore], self.column[shore]
        side = self.sides
        scale = side[:, shore].mean(axis=1)
        # On a grid that goes round the Earth, cells are repeated a turn to the West and the East.
        x = self.on_columns(x)
        turns = np.arange(-1, 2) if self.wraps else np.zeros(1, int)
        column = (column + turns[:, None] * self.number.shape[1]).ravel()
        shore, row = np.tile(shore, turns.size), np.tile(row, turns.size)
        tree = cKDTree(np.stack([column * scale[0], row * scale[1]], axis=1))
        candidates = min(_CANDIDATES, shore.size)
        _, near = tree.query(np.stack([x * scale[0], y * scale[1]], axis=1), candidates)
        near = near.reshape(x.size, candidates)
        east = (column[near] - x[:, None]) * side[0, origin, None]
        north = (row[near] - y[:, None]) * side[1, origin, None]
        away = np.hypot(east, north)
        tied = away <= away.min(axis=1, keepdims=True) * (1 + 1e-9)
        return np.where(tied, shore[near], self.cells).min(axis=1)


def on_grid(shape: tuple[int, ...], wraps: bool, x: Any, y: Any) -> Any:
    """Mark the points inside a grid of `shape`, which goes round the Earth if `wraps` is true."""
    rows, columns = shape
    on = (y >= -0.5) & (y < rows - 0.5)
    return on if wraps else on & (x >= -0.5) & (x < columns - 0.5)


def square(
    x: Float[Any, "*points"], y: Float[Any, "*points"]
) -> tuple[Int[Any, "*points"], Int[Any, "*points"]]:
    """Find the row and column of the square of each point.

    A point on the edge between two squares belongs to the later row or column.
    """
    xp = x.__array_namespace__()
    row, column = (xp.floor(xp.round(v + 0.5, _DECIMALS)).astype(np.int64) for v in (y, x))
    return row, column


def _joined(label: Int[np.ndarray, "rows columns"], count: int) -> Int[np.ndarray, "rows columns"]:
    """Give one label to pieces of water that meet where the last column is beside the first."""
    first, last = np.pad(label[:, 0], 1), np.tile(label[:, -1], 3)
    beside = np.concatenate([first[k : k + label.shape[0]] for k in range(3)])
    meet = (beside > 0) & (last > 0)
    graph = coo_array((meet[meet], (last[meet], beside[meet])), shape=(count + 1, count + 1))
    _, piece = csgraph.connected_components(graph, directed=False)
    _, smallest = np.unique(piece, return_index=True)
    return np.argsort(np.argsort(smallest))[piece][label]
