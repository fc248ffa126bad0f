"""What is in files that other programs read: automata, programs, drifters, pictures of maps."""

import csv
import io
import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree


def filter_json(path: Path, fields: dict[str, Any]) -> dict[str, Any]:
    """A filter as JSON."""
    try:
        targets = [target for row in fields["transition"] for target in row]
        return {
            "what": "a filter, for other programs",
            "states": len(fields["transition"]),
            "transitions": sum(target >= 0 for target in targets),
            "knowledge_cycles": len(fields["cycles"]),
        }
    except (KeyError, TypeError):
        raise _unexpected(path, "a filter, as `jaxcell export` writes it") from None


def dot(path: Path) -> dict[str, Any]:
    """A filter as a graph of Graphviz."""
    text = _text(path)
    if not text.startswith("digraph "):
        raise _unexpected(path, "the graph of a filter, as `jaxcell export` writes it")
    return {
        "what": "a filter, for Graphviz",
        "states": len(re.findall(r"^  \d+ \[", text, re.MULTILINE)),
        "transitions": len(re.findall(r"^  \d+ -> \d+ \[", text, re.MULTILINE)),
    }


def jflap(path: Path) -> dict[str, Any]:
    """An automaton of JFLAP."""
    try:
        root = ElementTree.fromstring(_text(path))
    except ElementTree.ParseError as error:
        raise ValueError(f"{path}: not valid XML, or cut short: {error}") from None
    kinds = {"moore": "a Moore machine", "fa": "a finite automaton"}
    kind = root.findtext("type", "")
    if root.tag != "structure" or kind not in kinds:
        raise _unexpected(path, f"an automaton of JFLAP whose type is one of {', '.join(kinds)}")
    return {
        "what": f"{kinds[kind]}, for JFLAP",
        "states": len(root.findall("automaton/state")),
        "transitions": len(root.findall("automaton/transition")),
    }


def c_header(path: Path) -> dict[str, Any]:
    """A filter as tables of C."""
    found = _tables(_text(path))
    if found is None:
        raise _unexpected(path, "the tables of a filter, as `jaxcell export` writes them")
    return {"what": "a filter, for C", **found}


def sketch(path: Path) -> dict[str, Any]:
    """A program for an Arduino."""
    text = _text(path)
    first = text.partition("\n")[0]
    if not first.startswith("/* ") or "Made by jaxcell" not in text[:1000]:
        raise _unexpected(path, "a program that `jaxcell robot sketch` writes")
    return {"what": "a program for an Arduino", "title": first[3:], **(_tables(text) or {})}


def points_csv(path: Path) -> dict[str, Any]:
    """Where drifters are deployed, as a table."""
    try:
        rows = list(csv.DictReader(io.StringIO(_text(path), newline=""), strict=True))
        places = [(float(row["lon"]), float(row["lat"])) for row in rows]
    except (csv.Error, KeyError, TypeError, ValueError):
        raise _unexpected(path, "columns lon and lat with a number in each line") from None
    return _deployment(path, places)


def geojson(path: Path) -> dict[str, Any]:
    """Where drifters are deployed, as GeoJSON."""
    try:
        fields = json.loads(_text(path))
        points = [feature["geometry"] for feature in fields["features"]]
        places = [tuple(map(float, point["coordinates"][:2])) for point in points]
    except (ValueError, RecursionError, KeyError, TypeError):
        raise _unexpected(path, "a FeatureCollection of points") from None
    return _deployment(path, places)


def picture(path: Path) -> dict[str, Any]:
    """The picture of a map, whose darkest pixels are occupied."""
    import numpy as np
    from PIL import UnidentifiedImageError

    from ..space.maps.images import read_image

    try:
        image = read_image(path.read_bytes(), ("PPM",))
    except UnidentifiedImageError:
        raise _unexpected(path, "a PGM picture") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    grey = np.asarray(image.convert("L") if image.mode in ("1", "RGB") else image)
    full = 255 if grey.dtype == np.uint8 else 65535
    # What map_server takes as occupied where a map does not say.
    occupied = (full - grey.astype(float)) / full > 0.65
    return {
        "what": "the picture of a map; its .yaml says how large it is",
        "width": image.width,
        "height": image.height,
        "occupied_share": round(float(occupied.mean()), 6),
    }


def _tables(text: str) -> dict[str, int] | None:
    """The size of the filter in a C header, if there is one in it."""
    counts = re.search(r": (\d+) states, (\d+) knowledge cycles", text)
    none = re.search(r"^#define \w+_IMPOSSIBLE (\d+)", text, re.MULTILINE)
    table = re.search(r"_transition\[\d+\]\[2\][^{;]*\{([^;]*)\};", text)
    if counts is None or none is None or table is None:
        return None
    pairs = re.findall(r"\{(\d+), (\d+)\}", table[1])
    return {
        "states": int(counts[1]),
        "transitions": sum(target != none[1] for pair in pairs for target in pair),
        "knowledge_cycles": int(counts[2]),
    }


def _deployment(path: Path, places: list[Any]) -> dict[str, Any]:
    if not places or any(len(place) != 2 for place in places):
        raise _unexpected(path, "one point or more, each with a longitude and a latitude")
    lon, lat = zip(*places, strict=True)
    return {
        "what": "where drifters are deployed",
        "points": len(places),
        "longitudes": [min(lon), max(lon)],
        "latitudes": [min(lat), max(lat)],
    }


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text in UTF-8: {error.reason}") from None


def _unexpected(path: Path, expected: str) -> ValueError:
    return ValueError(f"{path}: expected {expected}")
