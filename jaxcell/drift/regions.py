"""Regions of the sea, and the exchange of drifters between them."""

import dataclasses
import functools
import os
from pathlib import Path
from typing import Annotated, ClassVar

import jax
import numpy as np
import numpy.typing as npt
import scipy.sparse
import shapely
from jaxtyping import Bool, Float, Int

from ..base.documents import decode_json, read_text
from ..base.doubts import Doubt, warn
from ..base.intervals import clopper_pearson
from ..base.quantities import Result, derived, quantity
from ..mapping import Chain, ChainSequence
from ..mapping.classes import reaching
from ..mapping.generalized import leaving_rows
from ..mapping.sequence import as_sequence, push_on_host
from ..markov.hitting import leaving_times
from .advection import drifted, longest_step
from .flow import Flow, steps_in
from .long_term import LongTermBehaviour
from .water import Water


TURNS = (0.0, -360.0, 360.0)
"""Longitudes of polygons may differ from those of cells and drifters by these degrees."""
# The errors of a damaged geometry.
_DAMAGE = (ValueError, KeyError, TypeError, AttributeError, shapely.errors.ShapelyError)
_share = functools.partial(derived, "region to_region", kind="share", listed=True)


@dataclasses.dataclass(frozen=True, eq=False)
class Exchange(Result):
    """The exchange of drifters between regions, after a uniform release in each region.

    A strait of six cells, in which water moves by one cell per step to the East:

        >>> import numpy as np
        >>> from jaxcell import drift, mapping
        >>> strait = mapping.Chain.from_scipy(np.eye(6, k=1))
        >>> west = np.array([True, True, True, False, False, False])
        >>> names, halves = np.array(["west", "east"]), np.stack([west, ~west])
        >>> exchange = drift.Exchange(names, halves, strait, hours=1, steps=2)
        >>> exchange.share.round(2).tolist(), exchange.residence_hours.tolist()
        ([[0.33, 0.67], [0.0, 0.33]], [2.0, 2.0])
    """

    tables: ClassVar[dict[str, str]] = {"region": "regions"}

    name: Annotated[np.ndarray, quantity("region", "name", kind="text")]
    inside: Bool[np.ndarray, "regions cells"]
    "The mask of the cells of each region."
    chain: Chain | ChainSequence
    "The drift map of the layer, or the sequence of maps of a periodic current."
    hours: float | int
    "The duration of a step, in hours."
    steps: int
    "The number of steps from the release until the arrivals are counted."
    arrived: Int[np.ndarray, "regions regions"] | None = None
    "The number of simulated drifters from each region (row) that arrive in each region (column)."
    released: int = 0
    "The number of simulated drifters that are released in each region."

    @classmethod
    def of(
        cls,
        behaviour: LongTermBehaviour,
        names: npt.ArrayLike,
        inside: Bool[np.ndarray, "regions cells"],
        seconds: float | int,
    ) -> "Exchange":
        """Compute where drifters from each region are after `seconds` (rounded to whole steps)."""
        steps = steps_in(seconds, behaviour.duration)
        return cls(np.asarray(names), inside, behaviour.chain, behaviour.duration / 3600, steps)

    def with_drifters(self, water: Water, flow: Flow, count: int, seed: int = 0) -> "Exchange":
        """Add confidence intervals from simulated drifters, which are at points instead of cells.

        **Arguments:**

        - `water`, `flow`: water and flow of the surface.
        - `count`: the number of drifters from each region, released uniformly in its cells.
        - `seed`: seed of the points of release, and of diffusion.
        """
        random = np.random.default_rng(seed)
        origin = np.concatenate(
            [random.choice(np.flatnonzero(region), count) for region in self.inside]
        )
        off = random.uniform(-0.5, 0.5, (2, origin.size))
        x, y = water.column[origin] + off[0], water.row[origin] + off[1]
        end, key = 3600 * self.after_hours, jax.random.key(seed)
        x, y = drifted(water, flow, x, y, 0.0, end, longest_step(water, flow), key)
        cell = water.landing(x[None], y[None], origin=origin, exits=True)[0]
        # The last column is for drifters that have left.
        within = np.pad(self.inside, ((0, 0), (0, 1)))[:, cell].reshape(len(self.inside), -1, count)
        return dataclasses.replace(self, arrived=within.sum(axis=2).T, released=count)

    @derived("", "time between release and arrival", "h", kind="time")
    def after_hours(self) -> float:
        return float(self.steps * self.hours)

    @derived("region", "cells", kind="count")
    def cell_count(self) -> Int[np.ndarray, "regions"]:
        return self.inside.sum(axis=1)

    @derived("region", "mean time until a drifter first leaves it", "h", kind="time")
    def residence_hours(self) -> Float[np.ndarray, "regions"]:
        matrix = self.chain.to_scipy()
        phases = as_sequence(self.chain).phases
        times = [
            _leaving_times(matrix, np.tile(region, phases))[: region.sum()].mean()
            for region in self.inside
        ]
        return np.array(times) * self.hours

    @_share("share of its drifters in each region then")
    def share(self) -> Float[np.ndarray, "regions regions"]:
        return self.after @ self.inside.T

    @_share("the same of simulated drifters")
    def share_of_drifters(self) -> Float[np.ndarray, "regions regions"] | None:
        return None if self.arrived is None else self.arrived / self.released

    @_share("1 in 40 below")
    def low(self) -> Float[np.ndarray, "regions regions"] | None:
        return None if self.arrived is None else clopper_pearson(self.arrived, self.released)[0]

    @_share("1 in 40 above")
    def high(self) -> Float[np.ndarray, "regions regions"] | None:
        return None if self.arrived is None else clopper_pearson(self.arrived, self.released)[1]

    @derived("region", "share of its drifters that are off the map then", kind="share")
    def left(self) -> Float[np.ndarray, "regions"]:
        return np.clip(1 - self.after.sum(axis=1), 0, 1)

    @functools.cached_property
    def after(self) -> Float[np.ndarray, "regions cells"]:
        """The share of each region's drifters in each cell, `steps` steps after the release."""
        begin = self.inside / self.inside.sum(axis=1, keepdims=True)
        return np.stack([push_on_host(self.chain, share, self.steps) for share in begin])


def read_polygons(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray]:
    """Read polygons in degrees from a GeoJSON file.

    **Returns:** the name of each polygon, which is the property `name` of its feature, or its
    number if the feature has no name; and the polygons or multipolygons of shapely. A feature that
    is no polygon is left out with a warning.

    **Raises:** `ValueError` for a file that is not GeoJSON, has no polygon, or repeats a name;
    `OSError` if the file does not exist.
    """
    try:
        features = list(decode_json(read_text(Path(path)), "a GeoJSON file")["features"])
        named = [
            (str((feature.get("properties") or {}).get("name", number)), feature.get("geometry"))
            for number, feature in enumerate(features)
        ]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        got = f"no {error}" if isinstance(error, KeyError) else error
        raise ValueError(
            f"{path}: expected a GeoJSON FeatureCollection of polygons, got {got}"
        ) from None
    names, shapes, wrong = [], [], "expected one or more, got none"
    for name, geometry in named:
        try:
            shape = shapely.geometry.shape(geometry)
            kind = "an empty one" if shape.is_empty else shape.geom_type
        except _DAMAGE as error:
            kind = f"{type(error).__name__}: {error}"
        if kind in ("Polygon", "MultiPolygon"):
            names.append(name)
            shapes.append(shapely.make_valid(shape))
        else:
            wrong = f"{path}: feature {name!r}: expected a polygon, got {kind}"
            warn(f"{wrong}; it is left out", Doubt)
    if not names:
        raise ValueError(wrong if named else f"{path}: features: {wrong}")
    if len(set(names)) < len(names):
        raise ValueError(f"{path}: features: expected different names, got {names}")
    return np.array(names), np.array(shapes)


def read_regions(
    path: str | os.PathLike[str], water: Water
) -> tuple[np.ndarray, Bool[np.ndarray, "regions cells"]]:
    """Read regions from polygons in a GeoJSON file.

    **Arguments:**

    - `path`: a collection of features, polygons or multipolygons, in degrees.
    - `water`: the cells; a region consists of the cells whose centre is within its polygon.

    **Returns:** the names as in `read_polygons`; and the mask of the cells of each region. A
    polygon without such a cell is left out with a warning.

    **Raises:** the errors of `read_polygons`; and `ValueError` if no polygon has a cell.

    A square in the middle of the bundled sea:

        >>> import json, pathlib, tempfile
        >>> import shapely
        >>> from jaxcell import drift, examples
        >>> water, _ = examples.gyres()
        >>> place = float(water.lon.mean()), float(water.lat.mean())
        >>> square = shapely.Point(place).buffer(0.05, cap_style="square")
        >>> feature = {"type": "Feature", "properties": {"name": "middle"},
        ...            "geometry": shapely.geometry.mapping(square)}
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "regions.geojson"
        >>> _ = path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
        >>> names, inside = drift.read_regions(path, water)
        >>> names.tolist(), inside.shape, bool(inside.any())
        (['middle'], (1, 538), True)
    """
    names, shapes = read_polygons(path)
    lon, lat = water.lon[water.row, water.column], water.lat[water.row, water.column]
    inside = np.stack([within(shape, lon, lat) for shape in shapes])
    found = inside.any(axis=1)
    for name in names[~found].tolist():
        wrong = f"{path}: feature {name!r}: no centre of a water cell is within it"
        if not found.any():
            raise ValueError(wrong)
        warn(f"{wrong}; it is left out", Doubt)
    return names[found], inside[found]


def within(
    shape: shapely.Geometry, lon: Float[np.ndarray, "points"], lat: Float[np.ndarray, "points"]
) -> Bool[np.ndarray, "points"]:
    """Mark the points in a polygon, in degrees."""
    inside = [shapely.contains_xy(shape, lon + turn, lat) for turn in TURNS]
    return np.logical_or.reduce(inside)


def _leaving_times(
    matrix: scipy.sparse.csr_array, inside: Bool[np.ndarray, "states"]
) -> Float[np.ndarray, "inside"]:
    """Compute the expected number of steps until a drifter leaves a set, for each state in it.

    It is `inf` for a state from which a drifter may stay in the set forever.
    """
    can_leave = (matrix @ (~inside).astype(float) > 0) | (leaving_rows(matrix) > 0)
    inner = matrix[inside][:, inside].tocsr()
    stuck = reaching(inner, ~reaching(inner, can_leave[inside]))
    time, passed = np.where(stuck, np.inf, 0.0), inside.copy()
    passed[inside] = ~stuck
    time[~stuck], _ = leaving_times(matrix, passed)
    return time
