"""The choice of the two variables of a file that contain the current."""

import dataclasses
from collections.abc import Sequence
from typing import Literal, NamedTuple

from .axes.dimensions import (
    Axes,
    find_axes,
    is_rectangular,
    on_nodes,
    unstructured,
    without_outer_faces,
)
from .conventions import find_pairs, table
from .models import mitgcm, nemo, plane, polar
from .netcdf import OceanFile


_NAME_THEM = "name u and v with variables (--variables U V)"


@dataclasses.dataclass(frozen=True)
class Velocity:
    """The variables of the two components of the current, and their axes."""

    u: str
    v: str
    along: Literal["earth", "grid"]
    "The directions of the components: East and North, or x and y of the grid."
    why: str
    "The reason for the choice of directions, in words."
    u_axes: Axes
    v_axes: Axes


class _Pair(NamedTuple):
    """The variables of a [`Velocity`][]; `why` is `None` if only their names identified them."""

    u: str
    v: str
    along: Literal["earth", "grid", "dims"]
    why: str | None = None


def choose_velocity(
    file: OceanFile, variables: Sequence[str] | None = None
) -> tuple[OceanFile, Velocity]:
    """Choose the variables of the current by standard name, or else by the names of ocean models.

    A variable `u` without a standard name is accepted only if its dimensions determine its axes:
    the cell faces of a C-grid, or longitude and latitude. Alam 2018 calls u the northing in section
    5.4.1 and the easting in section 5.4.2; here u is towards the East.

    **Returns:** the file, with dimensions of ROMS if it is from NEMO or MITgcm; and the velocity.
    """
    pair = None if variables is not None else _known(file)
    if pair is None:
        file = polar.on_components(file, variables)
        if polar.NAMES[0] in file.dataset.variables and polar.NAMES[0] not in (variables or ()):
            pair = _Pair(*polar.NAMES, "earth", "by a speed and a direction")
        elif variables is not None:
            pair = _as_asked(file, variables)
        else:
            raise _no_velocity(file)
    file = nemo.on_points(mitgcm.on_points(file, pair.u, pair.v), pair.u, pair.v)
    file = plane.on_earth(without_outer_faces(file), pair.u)
    u_axes, v_axes = find_axes(file, pair.u), find_axes(file, pair.v)
    if (u_axes.time, u_axes.depth, u_axes.rho) != (v_axes.time, v_axes.depth, v_axes.rho):
        ours, theirs = (file.dataset[name].dims for name in (pair.u, pair.v))
        raise file.error(pair.v, f"expected the dimensions of {pair.u}, {ours}, got {theirs}")
    along, why = _along(file, pair, u_axes)
    return file, Velocity(pair.u, pair.v, along, why, u_axes, v_axes)


def _as_asked(file: OceanFile, variables: Sequence[str]) -> _Pair:
    if isinstance(variables, str) or len(variables) != 2:
        raise file.error("variables", f"expected the names of u and v, got {variables!r}")
    for name in variables:
        if name not in file.dataset.variables:
            raise file.error("variables", f"{name!r} is not in the file, which has {_all(file)}")
    u, v = variables
    standard_name = str(file.dataset[u].attrs.get("standard_name"))
    known = (row.along for row in table("velocity") if standard_name in row.standard_names[:1])
    return _Pair(u, v, next(known, "dims"), "as asked")


def _known(file: OceanFile) -> _Pair | None:
    """Find u and v by standard names, or else by the names that ocean models use."""
    for row, found in find_pairs(file.dataset, "velocity"):
        for name, variables in zip(row.standard_names, found, strict=False):
            if len(variables) != 1:
                got = f"got {', '.join(variables) or 'none'}; {_NAME_THEM}"
                raise file.error("standard_name", f"expected one variable that is {name}, {got}")
        named = " and ".join(row.standard_names)
        why = f"by the standard names {named}" if named else None
        return _Pair(found[0][-1], found[1][-1], row.along, why)
    return None


def _no_velocity(file: OceanFile) -> ValueError:
    variables = file.dataset.variables.items()
    meshes = [str(name) for name, v in variables if v.attrs.get("cf_role") == "mesh_topology"]
    meshes += [str(name) for name, v in variables if on_nodes(v.dims)]
    if meshes:
        return unstructured(file, meshes[0])
    return file.error("variables", f"no velocity found; the file has {_all(file)}; {_NAME_THEM}")


def _along(file: OceanFile, pair: _Pair, axes: Axes) -> tuple[Literal["earth", "grid"], str]:
    """Decide on the directions of a velocity; return them, and a phrase that gives the reason."""
    dims = f"by their dimensions ({axes.y}, {axes.x})"
    if axes.staggered and (pair.why is None or pair.along == "dims"):
        return "grid", pair.why or f"{dims}, the sides of the cells of a C-grid"
    if pair.along != "dims":
        return pair.along, pair.why or "by their names"
    if pair.why is not None:
        return "earth", pair.why
    if axes.lon == plane.LON:
        return "earth", "by the axes of the plane"
    if axes.lon.lower() in ("ulon", "ulong"):
        return "grid", "by the positions of POP"
    if is_rectangular(file, axes):
        return "earth", f"{dims}, on a grid of latitude and longitude"
    way_on = f"name {pair.u} and {pair.v} with variables (--variables {pair.u} {pair.v})"
    raise file.error(
        pair.u,
        f"ambiguous: on the dimensions ({axes.y}, {axes.x}) it may be towards the East or along "
        f"the grid, and it has no standard name; to take it as towards the East, {way_on}",
    )


def _all(file: OceanFile) -> str:
    """List the variables with two dimensions or more, in words."""
    fields = [str(name) for name, variable in file.dataset.data_vars.items() if variable.ndim > 1]
    return ", ".join(fields) or "no variables of two dimensions or more"
