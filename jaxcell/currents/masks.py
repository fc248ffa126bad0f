"""The mask of a file: the variable that separates water from land."""

import dataclasses
import functools
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
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

    The mask is the variable that the caller named; or one with a known name; or one whose flags or
    options, such as `option_0`, name land and water; or one with a CF standard name. `dims` are the
    dimensions of y and x, and `places` the levels to read along a dimension `depth`.
    """
    candidates = {
        str(name): variable
        for name, variable in file.dataset.variables.items()
        if set(dims) <= set(variable.dims)
        and all(size == 1 for dim, size in variable.sizes.items() if dim not in (*dims, depth))
    }

    block, order = {depth: places, dims[0]: rows, dims[1]: columns}, (depth or "", *dims)

    def read(name: str) -> Float[np.ndarray, "#levels y x"]:
        return read_part(file, name, block, order)

    if file.land is not None and set(dims) <= set(file.dataset[file.land[0]].dims):
        name, value = file.land
        extra = {dim: size for dim, size in file.dataset[name].sizes.items() if dim not in block}
        records = (dict(zip(extra, at, strict=True)) for at in np.ndindex(*extra.values()))
        wet = (read_part(file, name, block | record, order) != value for record in records)
        return Mask(name, functools.reduce(np.logical_or, wet), f"{value:g} is land, as asked")
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


def read_part(
    file: OceanFile, name: str, block: Mapping[Any, Any], dims: Sequence[str]
) -> Float[np.ndarray, "..."]:
    """Read a `block` of indices of a variable, in the order `dims`; other lengths must be 1."""
    array = file.dataset[name]
    for dim, size in array.sizes.items():
        if dim not in block and size > 1:
            why = f"dimension {dim} of length {size}: the velocity has no such dimension"
            raise file.error(name, why)
    return file.read(array.isel({dim: block.get(dim, 0) for dim in array.dims}), dims)


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
