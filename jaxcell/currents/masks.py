"""The mask of a file: the variable that separates water from land."""

import dataclasses
import re
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from .conventions import Convention, table
from .netcdf import OceanFile


_LAND, _WATER = {"land", "dry"}, {"water", "sea", "ocean", "wet"}


@dataclasses.dataclass(frozen=True)
class Mask:
    """A mask of the water, read from a variable of a file."""

    name: str
    water: Bool[np.ndarray, "#levels y x"]
    "True for water: a mask per level, or a single mask for all levels."
    why: str
    "The meaning of a value, and how it is known, such as `1 is water, by its name`."


def read_mask(
    file: OceanFile,
    dims: tuple[str, str],
    rows: Int[np.ndarray, " y"],
    columns: Int[np.ndarray, " x"],
    places: Int[np.ndarray, " levels"] | None = None,
    depth: str | None = None,
) -> Mask | None:
    """Read the mask of a file at `rows` and `columns`; return `None` if it has no mask.

    The mask is, in this order of preference, a variable with a name that ROMS, CROCO or NEMO uses,
    in which 1 is water; a variable whose `flag_values` and `flag_meanings`, or attributes such as
    `option_0`, name land and water; or a variable with a CF standard name. `dims` are the
    dimensions of y and x, and `places` the levels to read along a dimension `depth`.
    """
    candidates = {
        str(name): variable
        for name, variable in file.dataset.variables.items()
        if set(dims) <= set(variable.dims)
        and all(size == 1 for dim, size in variable.sizes.items() if dim not in (*dims, depth))
    }

    def read(name: str) -> Float[np.ndarray, "#levels y x"]:
        block: dict[str, object] = {dims[0]: rows, dims[1]: columns}
        if depth in file.dataset[name].dims:
            block[str(depth)] = places
        return file.read(part(file, name, block), (depth or "", *dims))

    if file.land is not None:
        name, value = file.land
        array = file.dataset[name]
        if set(dims) <= set(array.dims):
            extra = [dim for dim in array.dims if dim not in (*dims, depth)]
            here: dict[str, Any] = {dims[0]: rows, dims[1]: columns, str(depth): places}
            array = array.isel({dim: at for dim, at in here.items() if dim in array.dims})
            wet: Any = False
            for record in np.ndindex(*(array.sizes[dim] for dim in extra)):
                one = array.isel(dict(zip(extra, record, strict=True)))
                wet = wet | (file.read(one, (depth or "", *dims)) != value)
            return Mask(name, wet, f"{value:g} is land, as asked")
    for row in table("mask"):
        for name in row.names:
            if name in candidates:
                return _as_named(name, read(name), row, "its name")
    for name, variable in candidates.items():
        meanings = flag_meanings(variable.attrs)
        land = [value for value, words in meanings.items() if _about(words, _LAND, _WATER)]
        water = [value for value, words in meanings.items() if _about(words, _WATER, _LAND)]
        if land and water:
            rest = [value for value in meanings if value not in land]
            # In packed files values are rounded, so the nearest flag counts.
            away = (np.abs(np.subtract.outer(flags, read(name))) for flags in (rest, land))
            wet = np.less(*(distance.min(axis=0) for distance in away))
            listed = ", ".join(f"{value:g}" for value in land)
            return Mask(name, wet, f"{listed} is land, by its flags")
    for name, variable in candidates.items():
        standard_name = variable.attrs.get("standard_name")
        for row in table("mask"):
            if standard_name in row.standard_names:
                return _as_named(name, read(name), row, f"the standard name {standard_name}")
    return None


def _as_named(
    name: str, values: Float[np.ndarray, "#levels y x"], row: Convention, known: str
) -> Mask:
    why = f"1 is {'water' if row.water else 'land'}, by {known}"
    # In packed files 1 may be stored as 0.99999.
    return Mask(name, values > 0.5 if row.water else values < 0.5, why)


def part(file: OceanFile, name: str, block: dict[str, object]) -> xr.DataArray:
    """Select a `block` of indices of a variable; dimensions not in the block must have length 1."""
    array = file.dataset[name]
    others = {str(dim): 0 for dim in array.dims if dim not in block}
    for dim in others:
        if array.sizes[dim] > 1:
            raise file.error(
                name,
                f"dimension {dim} of length {array.sizes[dim]}: the velocity has no such dimension",
            )
    if absent := [dim for dim in block if dim not in array.dims]:
        raise file.error(
            name, f"expected the dimensions {', '.join(map(str, block))}; it has no {absent[0]}"
        )
    return array.isel(others | block)


def flag_meanings(attributes: dict[str, Any]) -> dict[float, str]:
    """Read the meanings of the values of a variable, from CF flags or from ROMS options."""
    texts = re.split(r"[\s,]+", str(attributes.get("flag_meanings", "")).strip())
    values = np.atleast_1d(attributes.get("flag_values", ()))
    if len(values) == len(texts) and values.dtype.kind in "iuf":
        return {float(value): text for value, text in zip(values, texts, strict=True)}
    options = ((re.fullmatch(r"option_?\(?(\d+)\)?", name), name) for name in attributes)
    return {float(match[1]): str(attributes[name]) for match, name in options if match}


def _about(words: str, expected: set[str], others: set[str]) -> bool:
    present = set(re.findall("[a-z]+", words.lower()))
    return bool(present & expected) and not present & others
