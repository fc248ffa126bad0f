"""Read floor plans in GeoJSON."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import shapely

from ...base.doubts import Doubt, warn


_EARTH_RADIUS = 6_371_000.0
# A plan of fewer metres is rather in degrees.
_SMALLEST = 0.1


def plan_fields(document: Mapping[str, Any], file: str) -> dict[str, Any]:
    """Return arguments of `Workspace` for a plan; empty if the document of a `file` is no GeoJSON.

    The largest polygon is the boundary, and its holes and the polygons within it are obstacles.
    Coordinates are metres, or degrees of longitude and latitude if the plan would be smaller than
    10 cm in metres.
    """
    if "type" not in document or not {"features", "coordinates", "geometry"} & document.keys():
        return {}
    try:
        found = list(_geometries(document))
    except (RecursionError, TypeError):
        raise ValueError("expected GeoJSON: features, geometries, and lists of positions") from None
    try:
        polygons = [
            shapely.Polygon(part[0], part[1:])
            for kind, coordinates in found
            if kind in ("Polygon", "MultiPolygon")
            for part in (coordinates if kind == "MultiPolygon" else [coordinates])
        ]
    except (ValueError, TypeError, IndexError):
        raise ValueError("coordinates: expected rings of at least 4 positions") from None
    if not polygons:
        raise ValueError("expected GeoJSON with polygons, whose largest is the boundary")
    if other := sum(kind not in ("Polygon", "MultiPolygon") for kind, _ in found):
        warn(f"{file}: geometries that are no polygons, and are left out: {other:,}", Doubt)
    polygons.sort(key=lambda polygon: -polygon.area)
    west, south, east, north = polygons[0].bounds
    if max(east - west, north - south) < _SMALLEST:
        middle = np.array([(west + east) / 2, (south + north) / 2])
        scale = np.radians(_EARTH_RADIUS) * np.array([np.cos(np.radians(middle[1])), 1.0])
        polygons = shapely.transform(polygons, lambda xy: (xy - middle) * scale).tolist()
        warn(f"{file}: x and y are taken as degrees, as metres they are below 10 cm", Doubt)
    outer, *inner = polygons
    if outside := sum(not outer.envelope.covers(polygon.envelope) for polygon in inner):
        raise ValueError(
            f"{outside:,} of {len(polygons):,} polygons are outside the largest; expected one "
            "around all others, such as the outline of the building; of rooms that touch, save the "
            "union (in Python: shapely.union_all)"
        )
    if inner:
        warn(f"{file}: polygons within the largest, taken as obstacles: {len(inner):,}")
    rings = [ring.coords for ring in outer.interiors]
    return {
        "boundary": outer.exterior.coords,
        "obstacles": [*rings, *(polygon.exterior.coords for polygon in inner)],
    }


def _geometries(part: Any) -> Iterator[tuple[str, Any]]:
    """Yield the type and the coordinates of each geometry, with x and y alone."""
    if not isinstance(part, dict):
        raise ValueError("expected GeoJSON, whose features are objects with a geometry")
    for below in part.get("features") or part.get("geometries") or ():
        yield from _geometries(below)
    if isinstance(part.get("geometry"), dict):
        yield from _geometries(part["geometry"])
    if "coordinates" in part:
        yield str(part.get("type")), _plain(part["coordinates"])


def _plain(numbers: Any) -> Any:
    """Leave out the heights of nested lists of positions."""
    if not isinstance(numbers, list) or not numbers:
        raise ValueError(f"coordinates: expected lists of pairs of numbers, got {numbers!r:.60}")
    if isinstance(numbers[0], list):
        return [_plain(below) for below in numbers]
    if len(numbers) < 2 or not all(type(one) in (int, float) for one in numbers[:2]):
        raise ValueError(f"coordinates: expected pairs of numbers, got {numbers!r:.60}")
    return numbers[:2]
