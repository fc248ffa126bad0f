"""Read and write map files in the format that their suffix indicates.

The module `grid_files` reads and writes all formats except the JSON format of jaxcell. A map is
represented by the keyword arguments of `Workspace`. In JSON, `format` ("jaxcell-map"), `version`
(1) and `boundary` are required; `units` ("m" by default, or "cm", "mm", "ft") applies to all
lengths in the file. Unknown keys are refused, so that a misspelt key is noticed.
"""

import json
import math
import os
import reprlib
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import shapely

from ...base.documents import (
    about,
    check_file,
    checked_list,
    checked_number,
    checked_pair,
    decode_json,
    read_text,
    refused,
)
from ...base.limits import Crop, Unknown
from ...base.optional_modules import explained
from ...base.paths import replacing
from .grid_files import format_ascii, parse_ascii, parse_moving_ai
from .plans import plan_fields


_GRID_SUFFIXES = (".txt", ".map")
_MAP_SERVER_SUFFIXES = (".yaml", ".yml")
_PLAN_SUFFIXES = (".json", ".geojson")
_IMAGE_SUFFIXES = (".pgm", ".png", ".bmp")
_SUFFIXES = (
    ".json or .geojson (polygons), .yaml or .yml (map_server), .txt or .map (ASCII grid, MovingAI)"
)

_KEYS = ("boundary", "obstacles", "robot_radius", "name", "cell", "directions", "piece")
# Metres in a unit, as a fraction of whole numbers: 57 cm is then the float64 nearest to 0.57.
_UNITS = {"m": (1, 1), "cm": (1, 100), "mm": (1, 1000), "ft": (3048, 10000)}


def read_map(
    path: str | os.PathLike[str], unknown: Unknown = "wall", crop: Crop = None
) -> dict[str, Any]:
    """Read a map file, in the format that its suffix indicates, as arguments of `Workspace`."""
    path = Path(path)
    check_file(path, "a map")
    suffix = path.suffix.lower()
    with about(path):
        if suffix in _PLAN_SUFFIXES:
            if crop is not None:
                why = "`crop` has no effect; expected a map of squares: .yaml, .txt or .map"
                raise ValueError(why)
            fields = parse_json(read_text(path), path.name)
        elif suffix in _MAP_SERVER_SUFFIXES:
            fields = _map_server().parse_map_server(read_text(path), path.parent, unknown, crop)
        elif suffix in _GRID_SUFFIXES:
            text = read_text(path)
            parse = parse_moving_ai if text.startswith("type ") else parse_ascii
            fields = parse(text, crop)
        elif suffix in _IMAGE_SUFFIXES:
            raise ValueError("an image alone has no scale; give the map_server .yaml that names it")
        else:
            raise ValueError(f"unknown format {suffix!r}; expected {_SUFFIXES}")
    return {"name": path.stem, **fields}


def write_map(
    path: str | os.PathLike[str],
    fields: Mapping[str, Any],
    environment: shapely.Polygon | shapely.MultiPolygon,
) -> None:
    """Write or replace a map file in the format that its suffix indicates; see `Workspace.save`.

    A grid is written from the environment, the other formats from the polygons in `fields`.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    with about(path):
        if suffix == ".json":
            files = {path: format_json(fields).encode()}
        elif suffix in _GRID_SUFFIXES:
            files = {path: format_ascii(fields, environment).encode()}
        elif suffix in _MAP_SERVER_SUFFIXES:
            image = path.with_suffix(".pgm")
            text, pixels = _map_server().format_map_server(fields, environment, image.name)
            files = {image: pixels, path: text.encode()}
        else:
            raise ValueError(f"unknown format {suffix!r}; expected {_SUFFIXES}")
    for file, content in files.items():
        with replacing(file) as temporary:
            temporary.write_bytes(content)


def _map_server() -> ModuleType:
    try:
        from . import map_server
    except ModuleNotFoundError as error:
        raise explained(error) from None
    return map_server


def parse_json(text: str, file: str = "map") -> dict[str, Any]:
    """Read a map in JSON, and return keyword arguments of `Workspace`, with lengths in metres."""
    document = decode_json(text, "a map")
    document = document if isinstance(document, dict) else {}
    if "nodes" in document:
        raise ValueError("it is a graph, not a map; study.PatrolGraph and load_graph take it")
    if "verts" in document:
        boundary = _vertices("verts", document["verts"], "m")
        return {"boundary": boundary, "name": str(document.get("id", file))}
    if plan := plan_fields(document, file):
        return plan
    if document.get("format") != "jaxcell-map":
        raise ValueError(
            'format: expected an object with "format": "jaxcell-map", GeoJSON of polygons, or a '
            "plan of HouseExpo with verts"
        )
    version = document.get("version")
    if type(version) is not int or version != 1:
        raise refused("version", "1", version)
    for key in document:
        if key not in ("format", "version", "units", *_KEYS):
            raise ValueError(f"{reprlib.repr(key)}: unknown key; expected {', '.join(_KEYS)}")
    units = document.get("units", "m")
    if not isinstance(units, str) or units not in _UNITS:
        raise refused("units", ", ".join(_UNITS), units)
    if "boundary" not in document:
        raise ValueError("boundary: it is missing")

    fields = {key: document[key] for key in _KEYS if key in document}
    fields["boundary"] = _vertices("boundary", fields["boundary"], units)
    rings = enumerate(checked_list("obstacles", fields.get("obstacles", [])))
    fields["obstacles"] = [_vertices(f"obstacles[{i}]", ring, units) for i, ring in rings]
    for key in ("robot_radius", "cell"):
        if key in fields:
            fields[key] = _length(key, fields[key], units)
    piece = fields.get("piece", "all")
    if piece not in ("all", "largest", "main"):
        fields["piece"] = tuple(_vertices("piece", [piece], units)[0])
    if not isinstance(fields.get("name", ""), str):
        raise refused("name", "text", fields["name"])
    if type(fields.get("directions", 1)) is not int:
        raise refused("directions", "a whole number", fields["directions"])
    return fields


def format_json(fields: Mapping[str, Any]) -> str:
    """Format a map as JSON, in metres, so that `parse_json` restores exactly the same numbers."""
    obstacles = ",\n".join(f"    {json.dumps(ring.tolist())}" for ring in fields["obstacles"])
    values = {
        "format": '"jaxcell-map"',
        "version": "1",
        "units": '"m"',
        "name": json.dumps(fields["name"], ensure_ascii=False),
        "boundary": json.dumps(fields["boundary"].tolist()),
        "obstacles": f"[\n{obstacles}\n  ]" if obstacles else "[]",
    }
    for key in ("robot_radius", "cell", "directions", "piece"):
        if fields[key] not in (None, "all"):
            values[key] = json.dumps(fields[key])
    return "{\n" + ",\n".join(f'  "{key}": {value}' for key, value in values.items()) + "\n}\n"


def _vertices(field: str, value: object, units: str) -> list[list[float]]:
    pairs = ((f"{field}[{i}]", pair) for i, pair in enumerate(checked_list(field, value)))
    return [[_length(at, one, units) for one in checked_pair(at, pair)] for at, pair in pairs]


def _length(field: str, value: object, units: str) -> float:
    metres, parts = _UNITS[units]
    return checked_number(field, value, most=math.inf) * metres / parts
