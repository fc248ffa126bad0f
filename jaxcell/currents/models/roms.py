"""ROMS and CROCO: staggered velocities, and terrain-following levels.

`u` is on the western and eastern faces of a cell and `v` on the southern and northern faces, along
the axes of the grid, which may be rotated relative to East and North. The levels are at fixed
values of a coordinate `s`, from -1 at the sea bed to 0 at the surface.
"""

import dataclasses
import re
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from ..netcdf import OceanFile


_Cells: TypeAlias = Float[np.ndarray, "y x"]
_Levels: TypeAlias = Float[np.ndarray, "levels y x"]

ALONE = 0.1
"""The distance in `s` within which a single level counts as the surface or the sea bed."""


def to_centres(
    sides: Float[np.ndarray, "*sides"], open_sides: Bool[np.ndarray, "*sides"], axis: int
) -> Float[np.ndarray, "..."]:
    """Average the velocity on the cell faces to the cell centres, along an axis.

    No water flows through a coast, so the velocity on a face that is not open is 0. At both ends
    the file lacks the outer face, and the centre gets the velocity of the inner face.
    """
    flow = np.where(open_sides, sides, 0.0)
    before = np.concatenate([flow.take([0], axis), flow], axis)
    after = np.concatenate([flow, flow.take([-1], axis)], axis)
    return (before + after) / 2


@dataclasses.dataclass(frozen=True)
class SLevels:
    """Terrain-following levels, also called s-levels, from the lowest to the highest."""

    s: Float[np.ndarray, " levels"]
    "The coordinate of each level, from -1 (sea bed) to 0 (surface)."
    stretching: Float[np.ndarray, " levels"]
    "The value of the stretching curve C(s) at each level, from -1 to 0."
    critical_depth: float
    "The parameter h_c of the formula for the heights of levels, in metres."
    transform: int
    "The number of the formula for the heights of levels (Vtransform), 1 or 2."
    places: Int[np.ndarray, " levels"]
    "The index of each level in the file."

    def heights(self, depth: _Cells, surface: _Cells) -> _Levels:
        """Compute the height of each level over the mean sea surface in metres.

        `depth` is the depth of the sea bed under the mean surface, positive, and `surface` the
        height of the surface (zeta). On land the height may be NaN.
        """
        s, stretching = self.s[:, None, None], self.stretching[:, None, None]
        with np.errstate(all="ignore"):  # on land the depth is arbitrary
            if self.transform == 1:
                still = self.critical_depth * (s - stretching) + depth * stretching
                heights = still + surface * (1 + still / depth)
            else:
                total = self.critical_depth + depth
                share = (self.critical_depth * s + depth * stretching) / total
                heights = surface + (surface + depth) * share
        return np.where(np.isfinite(heights), heights, np.nan)

    def beyond(self, heights: _Levels, wanted: _Cells) -> tuple[_Cells, _Cells]:
        """Compute how far heights are above the highest level or below the lowest level.

        A level is the middle of a layer of water. So if the file has the top layer, no height
        counts as above the levels; if it has the bottom layer, no height counts as below them.

        **Returns:** the distance in metres, 0 or less for a height between the levels; and the
        thickness of the nearest layer, 0 if there is only one level.
        """
        steps, layers = np.diff(self.s), np.diff(heights, axis=0)
        if len(self.s) == 1:
            steps, layers = np.array([ALONE]), np.zeros((1, *wanted.shape))
        up, down = wanted - heights[-1], heights[0] - wanted
        # In packed files s is rounded.
        if -self.s[-1] <= 1.01 * steps[-1]:
            up = np.zeros_like(up)
        if self.s[0] + 1 <= 1.01 * steps[0]:
            down = np.zeros_like(down)
        return np.maximum(up, down), np.where(up > down, layers[-1], layers[0])


def read_s_levels(file: OceanFile, dim: str) -> tuple[SLevels, str]:
    """Read the levels of a file; return them, and a phrase that names the source of Vtransform."""
    transform, why = _transform(file, dim)
    terms = formula_terms(file, dim)
    s = _levels(file, dim, (dim, "s_rho", "sc_r"))
    places = np.argsort(s)
    if transform == 0:  # the levels are shares of the depth
        return SLevels(s[places], s[places], 0.0, 2, places), why
    stretching = _levels(file, dim, (terms.get("C", "Cs_r"), "Cs_r", "Cs_rho"))
    critical_depth = _read(file, (terms.get("depth_c", "hc"), "hc"))
    if not (critical_depth.size == 1 and 0 <= critical_depth[0] < np.inf):
        raise file.error("hc", f"expected metres, 0 or more, got {critical_depth}")
    depth = float(critical_depth[0])
    return SLevels(s[places], stretching[places], depth, transform, places), why


def formula_terms(file: OceanFile, dim: str | None) -> dict[str, str]:
    """Read the variables of the formula of levels in CF, such as that of `depth`, the sea bed."""
    about = file.dataset[dim].attrs if dim in file.dataset.variables else {}
    terms = re.findall(r"(\w+):\s*(\w+)", str(about.get("formula_terms", "")))
    return {term: name for term, name in terms if name in file.dataset.variables}


def at_height(values: _Levels, heights: _Levels, wanted: _Cells) -> _Cells:
    """Interpolate values at the `wanted` heights, linearly between the levels of each cell.

    Values above the highest level and below the lowest level are the values of these levels.
    """
    levels = len(heights)
    if levels == 1:
        return np.where(np.isfinite(wanted), values[0], np.nan)
    below = np.clip((heights <= wanted).sum(axis=0) - 1, 0, levels - 2)[None]
    low, high = (np.take_along_axis(heights, below + k, axis=0)[0] for k in (0, 1))
    # Without water all levels coincide.
    with np.errstate(invalid="ignore"):
        share = np.clip((wanted - low) / (high - low), 0, 1)
    down, up = (np.take_along_axis(values, below + k, axis=0)[0] for k in (0, 1))
    return down + share * (up - down)


def _levels(file: OceanFile, dim: str, names: tuple[str, ...]) -> Float[np.ndarray, " levels"]:
    values = _read(file, names)
    if len(values) != (size := file.dataset.sizes[dim]):
        raise file.error(names[0], f"expected {size} levels ({dim}), got {len(values)}")
    steps = np.diff(values)
    # In packed files -1 and 0 are rounded.
    ordered = (steps > 0).all() or (steps < 0).all()
    if not (ordered and values.min() >= -1.001 and values.max() <= 0.001):
        raise file.error(names[0], f"expected levels in order between -1 and 0, got {values}")
    return values


def _read(file: OceanFile, names: tuple[str, ...]) -> Float[np.ndarray, " values"]:
    """Read the values of the first of `names` that is a variable or global attribute."""
    for name in names:
        if name in file.dataset.variables:
            return file.read(file.dataset[name]).reshape(-1)
        if name in file.dataset.attrs:
            try:
                return np.asarray(file.dataset.attrs[name], float).reshape(-1)
            except ValueError as error:
                raise file.error(name, f"expected numbers, got {error}") from error
    raise file.error(names[0], "missing; without it the depth of the levels is not known")


def _transform(file: OceanFile, dim: str) -> tuple[int, str]:
    """Read or derive Vtransform, 0 for levels at shares of the depth; name its source in words."""
    variables, attributes = file.dataset.variables, file.dataset.attrs
    standard_name = str(variables[dim].attrs.get("standard_name")) if dim in variables else ""
    if standard_name == "ocean_sigma_coordinate":
        return 0, f"shares of the depth, as {dim} is {standard_name}"
    if "Vtransform" in variables or "Vtransform" in attributes:
        value = _read(file, ("Vtransform",))
        if value.size != 1 or value[0] not in (1, 2):
            raise file.error("Vtransform", f"expected 1 or 2, got {value}")
        return int(value[0]), f"Vtransform {value[0]:g}"
    if match := re.fullmatch("ocean_s_coordinate_g([12])", standard_name):
        return int(match[1]), f"Vtransform {match[1]}, as {dim} is {standard_name}"
    if str(attributes.get("VertCoordType")).upper() == "NEW":
        return 2, "Vtransform 2, as VertCoordType is NEW"
    raise file.error("Vtransform", f"missing, and {dim} does not say it either; expected 1 or 2")
