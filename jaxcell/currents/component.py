"""A component of the velocity, read record by record at the centres of the cells."""

import dataclasses
import re
from typing import TypeAlias

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from .axes.dimensions import Axes
from .axes.times import SECONDS
from .conventions import LENGTHS
from .flags import Flag, read_flags
from .grid import OceanGrid
from .masks import Mask, read_mask, read_part
from .models.roms import to_centres
from .netcdf import OceanFile


_Levels: TypeAlias = Float[np.ndarray, "levels y x"]

FASTEST_CURRENT = 10.0
"""The largest accepted speed in m/s; faster currents come from undeclared fill values or units."""

_SPEEDS = {"kn": 1852 / 3600, "mph": 1609.344 / 3600, "kph": 1 / 3.6, "kmh": 1 / 3.6}
_PER = r" */ *({0})| +per +({0})|[ .*·]*({0}) *(?:\^|\*\*)?[{{(]?-1[)}}]?"
_SPEED = re.compile(
    rf"([\d.]+(?:e[+-]?\d+)?)?[ *]*({'|'.join(map(re.escape, LENGTHS))})"
    rf"(?:{_PER.format('|'.join(SECONDS))})"
)


@dataclasses.dataclass(frozen=True)
class Component:
    """A reader of one component of the velocity, on a block of cells."""

    file: OceanFile
    name: str
    axes: Axes
    places: Int[np.ndarray, " levels"] | None
    "The indices of the levels to read, or `None` if there is only one level."
    rows: Int[np.ndarray, " y"]
    columns: Int[np.ndarray, " x"]
    """The rows and columns of the values to read. For values on cell faces they extend beyond the
    block, so that both faces of each cell are read, except at the edges of the file."""
    inner: Int[np.ndarray, " block"]
    "The indices of the block's cells in the averages over faces, which extend beyond the block."
    mask: Mask | None
    "The mask of the values; `None` if the file has no mask, so that all values are used."
    factor: float
    "The factor from the unit of the file to metres per second."
    flags: list[Flag]
    valid: tuple[float, float]
    "The least and the largest valid value, in the unit of the file."

    @property
    def valid_note(self) -> str:
        """A note on the range of valid values, or ""."""
        least, most = self.valid
        if not np.isfinite(self.valid).any():
            return ""
        return f"{self.name}: values outside {least:g} to {most:g}, the valid range, are left out"

    def at(self, record: int) -> tuple[_Levels, Bool[np.ndarray, "levels y x"], _Levels]:
        """Read the velocity at the centres of the cells, at a record.

        **Returns:** the velocity in m/s; the mask of the cells with water on at least one face;
        and the velocity as it would be if the file had no mask.
        """
        axes = self.axes
        dims = (axes.depth or "", axes.y, axes.x)
        block = {axes.time: record, axes.depth: self.places, dims[1]: self.rows}
        block[axes.x] = self.columns
        values = read_part(self.file, self.name, block, dims)
        for flag in self.flags:
            values = np.where(flag.at(self.file, block, dims), np.nan, values)
        least, most = self.valid
        values = np.where((values < least) | (values > most), np.nan, values)
        values = unmasked = values * self.factor
        open_sides = np.isfinite(values)
        if self.mask is not None:
            open_sides = np.broadcast_to(self.mask.water, values.shape)
            values = np.where(open_sides, values, np.nan)
        for level, row, column in np.argwhere(np.abs(values) > FASTEST_CURRENT):
            place = 0 if self.places is None else self.places[level]
            raise self.file.error(
                self.name,
                f"expected currents up to {FASTEST_CURRENT:g} m/s, got "
                f"{values[level, row, column]:g} at record {record}, level {place}, "
                f"row {self.rows[row]}, column {self.columns[column]}; a fill value or unit that "
                "is not declared?",
            )
        if (axis := axes.between) is None:
            return values, open_sides, unmasked
        centres = to_centres(values, open_sides, axis)
        beside = to_centres(open_sides.astype(float), open_sides, axis) > 0
        unmasked = to_centres(unmasked, np.isfinite(unmasked), axis)
        inner = self.inner
        return centres.take(inner, axis), beside.take(inner, axis), unmasked.take(inner, axis)


def component(
    file: OceanFile,
    name: str,
    axes: Axes,
    grid: OceanGrid,
    places: Int[np.ndarray, " levels"] | None,
) -> Component:
    """Build the reader of the component `name` on the cells of `grid`, at the levels `places`."""
    factor = metres_per_second(file, name)
    dims, rho = (axes.y, axes.x), axes.rho
    cells = [grid.rows, grid.columns]
    inner = np.arange(0)
    if (between := axes.between) is not None:
        length = file.dataset.sizes[rho[between]]
        first, last = int(cells[between][0]), int(cells[between][-1])
        outer = np.arange(max(first - 1, 0), min(last + 2, length))
        inner = cells[between] - outer[0]
        # On other grids without a repeated column the file lacks the side at the seam.
        at_seam = last + 1 < length or file.dataset.sizes[axes.x] == length
        if grid.wraps and between == -1 and first == 0 and at_seam:
            # The western side of the first column is the eastern side of the last column.
            after = last + 1 if last + 1 < length else 0
            outer, inner = np.concatenate([[last], cells[-1], [after]]), inner + 1
        cells[between] = outer
    mask = read_mask(file, rho, cells[0], cells[1], places, axes.depth)
    if between is not None:
        cells[between] = cells[between][:-1]
        of_sides = read_mask(file, dims, cells[0], cells[1], places, axes.depth)
        if of_sides is None and mask is not None:
            before = np.arange(len(cells[between]))
            wet = mask.water.take(before, between) & mask.water.take(before + 1, between)
            of_sides = dataclasses.replace(mask, water=wet)
        mask = of_sides
    flags = read_flags(file, name)
    return Component(
        file, name, axes, places, cells[0], cells[1], inner, mask, factor, flags,
        _valid(file.dataset[name].variable),
    )  # fmt: skip


def _valid(variable: xr.Variable) -> tuple[float, float]:
    """Return the range of valid values by `valid_range`, or `valid_min` and `valid_max`.

    In a packed file they are packed too if they have the type of the stored values.
    """
    about, packed = variable.attrs, variable.encoding
    both = about.get("valid_min", -np.inf), about.get("valid_max", np.inf)
    names = ("scale_factor", 1.0), ("add_offset", 0.0)
    scale, offset = (np.asarray(packed.get(*name)).item() for name in names)
    least, most = (
        float(one) * scale + offset if np.asarray(one).dtype == packed.get("dtype") else float(one)
        for one in about.get("valid_range", both)
    )
    return least, most


def metres_per_second(file: OceanFile, name: str) -> float:
    """Return the factor from the unit of a velocity to m/s; raise `ValueError` if it is unknown."""
    units = str(file.dataset[name].attrs.get("units", "m/s")).strip()
    spelt = units.lower().replace("⁻¹", "-1")
    known = _SPEEDS.get(re.sub("^(kt|kn|knot)s?$", "kn", spelt))
    if known is None and (match := _SPEED.fullmatch(spelt)):
        known = float(match[1] or 1) * LENGTHS[match[2]] / SECONDS[match[3] or match[4] or match[5]]
    if not known:
        way_on = "name it with units (--units cm/s)"
        raise file.error(name, f"units: expected a unit of speed, got {units!r}; {way_on}")
    return known


def read_cells(
    file: OceanFile, name: str, axes: Axes, grid: OceanGrid, record: int | None = None
) -> Float[np.ndarray, "y x"]:
    """Read a variable without levels at the cell centres, at `record` if it depends on time."""
    y, x = axes.rho
    if absent := [dim for dim in (y, x) if dim not in file.dataset[name].dims]:
        raise file.error(name, f"expected the dimensions {y}, {x}; it has no {absent[0]}")
    return read_part(file, name, {axes.time: record, y: grid.rows, x: grid.columns}, (y, x))
