"""The depths at which a file has a current, and which of them are asked for."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from .netcdf import OceanFile
from .roms import SLevels, read_s_levels


@dataclasses.dataclass(frozen=True)
class Layers:
    """The chosen depths, the surface first.

    **Attributes:**

    - `depth`: in metres, positive down.
    - `places`: where the levels to be read stand in the file; `None` if it has one level.
    - `s_levels`: how the levels lie, if they follow the sea bed and each depth is interpolated.
    - `asked`: whether the depths were asked for.
    - `note`: how they were had; may be empty.
    """

    depth: Float[np.ndarray, " layers"]
    places: Int[np.ndarray, " levels"] | None
    s_levels: SLevels | None
    asked: bool
    note: str = ""


def choose_layers(
    file: OceanFile,
    velocity: str,
    dim: str | None,
    depths: float | int | Sequence[float | int] | None,
) -> Layers:
    """Finds the depths that are asked for.

    **Arguments:**

    - `file`: an open file.
    - `velocity`: the name of u.
    - `dim`: its dimension of depth, or `None` if it has a single level, taken as the surface.
    - `depths`: as for [`jaxcell.drift.open_currents`][].

    **Raises:** `ValueError` for a depth that the file does not have, and for levels whose depth is
    not known.
    """
    wanted = None if depths is None else _depths(file, depths)
    if dim is None:
        if wanted is not None and (len(wanted) > 1 or wanted[0] != 0):
            raise file.error(
                "depths", f"{velocity} has a single level, taken as 0 m; got {depths!r}"
            )
        note = f"{velocity} has a single level, taken as the surface"
        return Layers(np.zeros(1), None, None, wanted is not None, note)
    if _is_s(file, dim):
        s_levels, why = read_s_levels(file, dim)
        depth = np.zeros(1) if wanted is None else wanted
        text = ", ".join(f"{value:g}" for value in depth)
        note = f"{dim}: {why}; interpolated to {text} m below the surface in each cell"
        return Layers(depth, s_levels.places, s_levels, wanted is not None, note)
    levels = _z_levels(file, dim)
    if wanted is None:
        places = np.argsort(levels)
        return Layers(levels[places], places, None, False)
    places = np.abs(levels - wanted[:, None]).argmin(axis=1)
    # A centimetre: levels such as 0.494025 m are known by their rounded values.
    wrong = np.abs(levels[places] - wanted) > 0.01
    if wrong.any():
        known = ", ".join(f"{value:g}" for value in np.sort(levels))
        raise file.error("depths", f"{wanted[wrong][0]:g} m is not one of the levels {known} m")
    return Layers(levels[places], places, None, True)


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
    if dim not in file.dataset.variables:
        return dim in ("s_rho", "sc_r")
    standard_name = str(file.dataset[dim].attrs.get("standard_name", ""))
    return dim in ("s_rho", "sc_r") or standard_name.startswith("ocean_s_coordinate")


def _z_levels(file: OceanFile, dim: str) -> Float[np.ndarray, " levels"]:
    """The depth of each level in metres, positive down."""
    if dim not in file.dataset.variables:
        raise file.error(dim, "the depths of the levels are missing")
    levels = file.read(file.dataset[dim])
    attributes = file.dataset[dim].attrs
    units = str(attributes.get("units", "m"))
    if units.lower() not in ("m", "meter", "meters", "metre", "metres"):
        raise file.error(dim, f"units: expected metres, got {units!r}")
    steps = np.diff(levels)
    if not (np.isfinite(levels).all() and ((steps > 0).all() or (steps < 0).all())):
        raise file.error(dim, f"expected levels in order, got {levels}")
    # Without a word on it, levels below 0 count upward from the surface.
    up = str(attributes.get("positive", "up" if levels.max() <= 0 else "down")).lower() == "up"
    return np.where(levels == 0, 0.0, -levels if up else levels)
