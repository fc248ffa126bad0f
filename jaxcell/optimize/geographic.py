"""Positions on the Earth: longitudes and latitudes as metres, and distances between them."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int


_EARTH_RADIUS = 6_371_000.0
"The mean radius of the Earth in metres; distances by it are within 0.6 % of those on an ellipsoid."
_NAMES = {"lon": ("lon", "lng", "long", "longitude"), "lat": ("lat", "latitude")}
# Coordinate reference systems with longitudes and latitudes, as street networks name them.
_GEOGRAPHIC = re.compile(r"(?i)(^|\D)(4326|4269|4258)$|crs:?84$|longlat|^wgs ?84$")


def degrees(attributes: Mapping[str, Any]) -> tuple[Any, Any] | None:
    """Find the longitude and latitude among the attributes of a vertex, by their names."""
    lower = {str(name).lower(): value for name, value in attributes.items()}
    found = [[lower[name] for name in names if name in lower] for names in _NAMES.values()]
    return (found[0][0], found[1][0]) if all(found) else None


def positioned(attributes: Mapping[str, Any], crs: object) -> Mapping[str, Any]:
    """Rename `x` and `y` of a vertex to `lon` and `lat` if the reference system is geographic."""
    if not (_GEOGRAPHIC.search(str(crs)) and {"x", "y"} <= attributes.keys()):
        return attributes
    return {"lon": attributes["x"], "lat": attributes["y"]}


def in_metres(places: Float[np.ndarray, "vertices 2"]) -> Float[np.ndarray, "vertices 2"]:
    """Convert longitudes and latitudes to metres East and North of the middle of all places."""
    around = (places - places[0] + 180) % 360 - 180
    away = around - (around.min(axis=0) + around.max(axis=0)) / 2
    middle = (places[:, 1].min() + places[:, 1].max()) / 2
    return _EARTH_RADIUS * np.radians(away) * [np.cos(np.radians(middle)), 1.0]


def great_circles(
    places: Float[np.ndarray, "vertices 2"], edges: Int[np.ndarray, "edges 2"]
) -> Float[np.ndarray, "edges"]:
    """Compute the distance in metres along the Earth between the two ends of each edge."""
    (x, y), (p, q) = (np.radians(places[edges[:, side]]).T for side in (0, 1))
    half = np.sin((q - y) / 2) ** 2 + np.cos(y) * np.cos(q) * np.sin((p - x) / 2) ** 2
    return 2 * _EARTH_RADIUS * np.arcsin(np.sqrt(half))
