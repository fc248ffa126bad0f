"""The depths of the velocities in a file, and the choice of layers."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ..conventions import LENGTHS, TERRAIN
from ..models.roms import ALONE, SLevels, read_s_levels
from ..netcdf import OceanFile
from .dimensions import axis_kind


@dataclasses.dataclass(frozen=True)
class Layers:
    """The layers to read from a file, the surface first."""

    depth: Float[np.ndarray, " layers"]
    "The depth of each layer in metres, positive down."
    places: Int[np.ndarray, " levels"] | None
    "The indices of the levels to read; `None` if the file has a single level."
    s_levels: SLevels | None
    "The terrain-following levels from which layers are interpolated; `None` if there are none."
    asked: bool
    "True if the caller chose the depths."
    top: int | None = None
    "The index of the shallowest level if it is not read; dry squares below its water are sea bed."
    note: str = ""


def choose_layers(
    file: OceanFile,
    velocity: str,
    dim: str | None,
    depths: float | int | Sequence[float | int] | None,
) -> Layers:
    """Choose the layers to read for the argument `depths` of [`jaxcell.drift.open_currents`][].

    `dim` is the dimension of depth. A velocity without this dimension has a single level, whose
    depth is the value of a scalar coordinate, or 0 if there is none.
    """
    wanted = None if depths is None else _depths(file, depths)
    if dim is None:
        level, why = _single_level(file, velocity)
        note = f"{velocity} has a single level, {why}"
        if wanted is not None and (len(wanted) > 1 or abs(wanted[0] - level) > 0.01):
            got = ", ".join(f"{value:g}" for value in wanted)
            raise file.error("depths", f"{note}; no layer at {got} m")
        return Layers(np.array([level]), None, None, wanted is not None, note=note)
    if _is_s(file, dim):
        s_levels, why = read_s_levels(file, dim)
        depth = np.zeros(1) if wanted is None else wanted
        text = ", ".join(f"{value:g}" for value in depth)
        note = f"{dim}: {why}; interpolated to {text} m below the surface in each cell"
        return Layers(depth, s_levels.places, s_levels, wanted is not None, note=note)
    levels, note = _z_levels(file, dim)
    if wanted is None:
        places = np.argsort(levels)
        return Layers(levels[places], places, None, False, None, note)
    places = np.abs(levels - wanted[:, None]).argmin(axis=1)
    # To the centimetre, because users name levels such as 0.494025 m by rounded values.
    for other in wanted[np.abs(levels[places] - wanted) > 0.01]:
        known = ", ".join(f"{value:g}" for value in np.sort(levels))
        raise file.error("depths", f"{other:g} m is not one of the levels {known} m")
    top = int(levels.argmin())
    return Layers(levels[places], places, None, True, None if top in places else top, note)


def _single_level(file: OceanFile, velocity: str) -> tuple[float, str]:
    """Return the depth of a velocity with a single level, and a phrase that explains this depth."""
    for name in file.coordinates(velocity):
        alone = name in file.dataset.variables and file.dataset[name].size == 1
        if not alone or axis_kind(file.dataset, name) != "depth":
            continue
        if not _is_s(file, name):
            levels, _ = _z_levels(file, name)
            return float(levels[0]), f"at {levels[0]:g} m, by {name}"
        s = float(file.read(file.dataset[name]).reshape(()))
        if not -ALONE <= s <= 0.001:
            why = f"{velocity} has a single level, and it is not that of the surface: {s:g}"
            raise file.error(name, why)
    return 0.0, "taken as the surface"


def _depths(
    file: OceanFile, depths: float | int | Sequence[float | int]
) -> Float[np.ndarray, " layers"]:
    try:
        values = np.sort(np.atleast_1d(np.asarray(depths, float)))
    except (TypeError, ValueError) as error:
        raise file.error("depths", f"expected metres, got {depths!r}") from error
    if values.ndim != 1 or values.size == 0 or not np.isfinite(values).all() or values[0] < 0:
        raise file.error("depths", f"expected metres, positive down, got {depths!r}")
    if (np.diff(values) == 0).any():
        raise file.error("depths", f"expected different depths, got {depths!r}")
    return values


def _is_s(file: OceanFile, dim: str) -> bool:
    attributes = file.dataset[dim].attrs if dim in file.dataset.variables else {}
    standard_name = str(attributes.get("standard_name", ""))
    return dim in ("s_rho", "sc_r") or standard_name.startswith(TERRAIN)


def _z_levels(file: OceanFile, dim: str) -> tuple[Float[np.ndarray, " levels"], str]:
    """Return depths in metres, positive down, and a note if the file gives them the wrong sign."""
    if dim not in file.dataset.variables:
        way_on = "name them with coords (--coords LON LAT DEPTH)"
        raise file.error(dim, f"the depths of the levels are missing; {way_on}")
    levels = file.read(file.dataset[dim]).reshape(-1)
    attributes = file.dataset[dim].attrs
    units = str(attributes.get("units", "m"))
    if units.lower() not in LENGTHS:
        raise file.error(dim, f"units: expected metres, got {units!r}")
    levels = levels * LENGTHS[units.lower()]
    steps = np.diff(levels)
    if not (np.isfinite(levels).all() and ((steps > 0).all() or (steps < 0).all())):
        raise file.error(dim, f"expected levels in order, got {levels}")
    positive = str(attributes.get("positive", "")).lower()
    if levels.min() < 0 < levels.max():
        if positive not in ("up", "down"):
            raise file.error(dim, f"expected depths on one side of 0, got {levels}")
        return -levels if positive == "up" else levels, ""
    # The sea is below its surface, even if the attribute `positive` says otherwise.
    if not levels.any() or positive != ("down" if levels.min() < 0 else "up"):
        return np.abs(levels), ""
    note = f"{dim}: from {levels[0]:g} to {levels[-1]:g} m, though positive is {positive}"
    return np.abs(levels), f"{note}; taken as below the surface"
