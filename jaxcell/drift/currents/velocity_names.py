"""Which variables of a file are the current towards the East and towards the North."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

from .dimensions import Axes, find_axes, is_rectangular
from .netcdf import OceanFile


# Pairs in the order in which they are preferred: three-dimensional fields before the surface.
_EARTH_STANDARD_NAMES = (
    ("eastward_sea_water_velocity", "northward_sea_water_velocity"),
    ("surface_eastward_sea_water_velocity", "surface_northward_sea_water_velocity"),
)
_GRID_STANDARD_NAMES = (
    ("sea_water_x_velocity", "sea_water_y_velocity"),
    ("x_sea_water_velocity", "y_sea_water_velocity"),
    ("sea_water_surface_x_velocity", "sea_water_surface_y_velocity"),
)
_EARTH_NAMES = (
    ("u_eastward", "v_northward"),
    ("water_u", "water_v"),
    ("uo", "vo"),
    ("u_sur_eastward", "v_sur_northward"),
)
# Along the grid where they stand on the sides of its cells; otherwise the names say nothing.
_BARE_NAMES = (("u", "v"), ("u_sur", "v_sur"), ("ubar", "vbar"))


@dataclasses.dataclass(frozen=True)
class Velocity:
    """The two components of the current.

    **Attributes:**

    - `u`, `v`: names of the variables; u towards the East or along x, v towards the North or y.
    - `along`: the axes that they are measured along: those of the `"earth"` or of the `"grid"`.
    - `why`: what this was decided on, in words.
    - `u_axes`, `v_axes`: the dimensions of each.
    """

    u: str
    v: str
    along: Literal["earth", "grid"]
    why: str
    u_axes: Axes
    v_axes: Axes


def choose_velocity(file: OceanFile, variables: Sequence[str] | None = None) -> Velocity:
    """Decide which variables are the current.

    By standard name, then by the names that ocean models use; a bare `u` only where its dimensions
    say which axes it is along: the sides of the cells of a C-grid, or longitude and latitude. The
    source calls u the northing in one place and the easting in another (Alam 2018, sections 5.4.1
    and 5.4.2); everywhere else u is towards the East, and so it is here.

    **Arguments:**

    - `file`: an open file.
    - `variables`: the names of u and v, where the choice is not to be made here. They are along
        the grid if their standard names say so or they stand on the sides of its cells, and
        otherwise towards the East and North.

    **Raises:** `ValueError` if no velocity is found, or it is not clear what u is.
    """
    if variables is not None:
        return _as_asked(file, variables)
    standard_names: dict[str, list[str]] = {}
    for name, variable in file.dataset.data_vars.items():
        standard_names.setdefault(str(variable.attrs.get("standard_name")), []).append(str(name))
    for pair in _EARTH_STANDARD_NAMES + _GRID_STANDARD_NAMES:
        names = [standard_names.get(standard_name, []) for standard_name in pair]
        if not any(names):
            continue
        for standard_name, candidates in zip(pair, names, strict=True):
            if len(candidates) != 1:
                raise file.error(
                    "standard_name",
                    f"expected one variable that is {standard_name}, got "
                    f"{', '.join(candidates) or 'none'}; name u and v with variables",
                )
        along: Literal["earth", "grid"] = "earth" if pair in _EARTH_STANDARD_NAMES else "grid"
        why = f"by the standard names {pair[0]} and {pair[1]}"
        return _velocity(file, names[0][0], names[1][0], along, why)
    return _by_name(file)


def _as_asked(file: OceanFile, variables: Sequence[str]) -> Velocity:
    if isinstance(variables, str) or len(variables) != 2:
        raise file.error("variables", f"expected the names of u and v, got {variables!r}")
    for name in variables:
        if name not in file.dataset.variables:
            raise file.error("variables", f"{name!r} is not in the file, which has {_all(file)}")
    u, v = variables
    standard_name = str(file.dataset[u].attrs.get("standard_name"))
    grid = find_axes(file, u).staggered
    if standard_name in (pair[0] for pair in _EARTH_STANDARD_NAMES + _GRID_STANDARD_NAMES):
        grid = standard_name in (pair[0] for pair in _GRID_STANDARD_NAMES)
    return _velocity(file, u, v, "grid" if grid else "earth", "as asked")


def _by_name(file: OceanFile) -> Velocity:
    """By the names that ocean models use, in any case of letters."""
    names = {str(name).lower(): str(name) for name in file.dataset.data_vars}
    for u, v in _EARTH_NAMES:
        if u in names and v in names:
            return _velocity(file, names[u], names[v], "earth", "by their names")
    for u, v in _BARE_NAMES:
        if u not in names or v not in names:
            continue
        u, v = names[u], names[v]
        axes = find_axes(file, u)
        if axes.staggered:
            why = f"by their dimensions ({axes.y}, {axes.x}), the sides of the cells of a C-grid"
            return _velocity(file, u, v, "grid", why)
        if is_rectangular(file, axes):
            why = f"by their dimensions ({axes.y}, {axes.x}), on a grid of latitude and longitude"
            return _velocity(file, u, v, "earth", why)
        raise file.error(
            u,
            f"ambiguous: on the dimensions ({axes.y}, {axes.x}) it may be towards the East or "
            "along the grid, and it has no standard name; to take it as towards the East, name "
            f"{u} and {v} with variables",
        )
    raise file.error("variables", f"no velocity found; the file has {_all(file)}")


def _velocity(
    file: OceanFile, u: str, v: str, along: Literal["earth", "grid"], why: str
) -> Velocity:
    u_axes, v_axes = find_axes(file, u), find_axes(file, v)
    if (u_axes.time, u_axes.depth, u_axes.rho) != (v_axes.time, v_axes.depth, v_axes.rho):
        raise file.error(
            v,
            f"expected the dimensions of {u}, {file.dataset[u].dims}, got {file.dataset[v].dims}",
        )
    return Velocity(u, v, along, why, u_axes, v_axes)


def _all(file: OceanFile) -> str:
    """The names of the variables that may be fields."""
    fields = [str(name) for name, variable in file.dataset.data_vars.items() if variable.ndim > 1]
    return ", ".join(fields) or "no variables of two dimensions or more"
