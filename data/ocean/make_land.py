"""Make the coastline of this folder: `python data/ocean/make_land.py land-10m.json [FOLDER]`.

The argument is a file of the npm package world-atlas 2.0.2 (`npm pack world-atlas`): the land of
Natural Earth 4.1.0 at 1:10 million, as TopoJSON. README.md describes the result.
"""

import json
import sys
from pathlib import Path

import numpy as np
import shapely


# In degrees. Half a kilometre is less than the error of a coastline at 1:10 million.
TOLERANCE, DIGITS = 0.005, 0.001


def rings(topology: dict) -> list[list[np.ndarray]]:
    """List the rings of each polygon in degrees; longitudes may exceed 180."""
    scale, first = (np.array(topology["transform"][name]) for name in ("scale", "translate"))
    arcs = [np.cumsum(np.array(arc), axis=0) * scale + first for arc in topology["arcs"]]

    def ring(numbers: list[int]) -> np.ndarray:
        parts = [arcs[k] if k >= 0 else arcs[~k][::-1] for k in numbers]
        points = np.concatenate([parts[0], *(part[1:] for part in parts[1:])])
        points[:, 0] = np.unwrap(points[:, 0], period=360)
        if abs(points[-1, 0] - points[0, 0]) > 180:  # Antarctica goes round the pole
            pole = [[points[-1, 0], -90], [points[0, 0], -90], points[0]]
            points = np.concatenate([points, pole])
        return points

    return [
        [ring(numbers) for numbers in polygon]
        for shape in topology["objects"]["land"]["geometries"]
        for polygon in (shape["arcs"] if shape["type"] == "MultiPolygon" else [shape["arcs"]])
    ]


def land(topology: dict) -> np.ndarray:
    """Make the polygons, with longitudes from -180 to 180 degrees."""
    polygons = []
    for outer, *holes in rings(topology):
        shape = shapely.make_valid(
            shapely.Polygon(outer, [hole for hole in holes if len(hole) > 3])
        )
        for turn in (-360, 0, 360):
            turned = shapely.transform(shape, lambda points, turn=turn: np.add(points, [turn, 0]))
            inside = shapely.intersection(turned, shapely.box(-180, -90, 180, 90))
            polygons += [part for part in shapely.get_parts(inside) if part.area > 0]
    coarse = shapely.set_precision(shapely.simplify(np.array(polygons), TOLERANCE), DIGITS)
    parts = shapely.get_parts(shapely.make_valid(coarse))
    return parts[shapely.area(parts) > 0]


def main(source: Path, folder: Path) -> None:
    kind, corners, offsets = shapely.to_ragged_array(land(json.loads(source.read_text())))
    assert kind == shapely.GeometryType.POLYGON
    # Differences between corners in thousandths of a degree compress well.
    steps = np.diff(np.rint(corners / DIGITS).astype(np.int32), axis=0, prepend=0)
    rings, polygons = (np.asarray(offset, np.int32) for offset in offsets)
    arrays = {"east": steps[:, 0], "north": steps[:, 1], "rings": rings, "polygons": polygons}
    np.savez_compressed(folder / "land.npz", **arrays)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).parent)
