"""Descriptions of all files that jaxcell reads or writes: the kind and the content of each."""

import csv
import itertools
import json
import re
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from .. import automata, drift, patrol, space, sweep
from ..base.documents import Fields, about
from ..base.doubts import Doubt, warn
from ..base.limits import Crop, Piece, Unknown
from ..base.paths import absent, visible
from ..base.results import MANIFEST, Manifest, check_result


# The most files of a folder that is described.
_MOST_FILES = 2_000
_STATES = {"states": r": (\d+) states", "knowledge_cycles": r"(\d+) knowledge cycles"}
# Files for other programs, by suffix: a name, a pattern that identifies them, patterns to count.
_EXPORTS: dict[str, tuple[str, str, dict[str, str]]] = {
    ".dot": (
        "a filter, for Graphviz",
        r"(?s)\Adigraph .*}\s*\Z",
        {"states": r"^  \d+ \[", "transitions": r"^  \d+ -> \d+ \["},
    ),
    ".jff": (
        "an automaton, for JFLAP",
        r"(?s)<structure>.*</structure>\s*\Z",
        {"states": r"<state ", "transitions": r"<transition>"},
    ),
    ".h": ("a filter, for C", r"_(transition|turn)\[\d+\]", _STATES),
    ".ino": ("a program for an Arduino", r"(?s)\A/\* .{,1000}Made by jaxcell", _STATES),
}


class Reading(NamedTuple):
    """Options of commands for reading maps, graphs, trajectories and currents."""

    part: tuple[Unknown, Piece | None, Crop] = ("wall", None, None)
    weight: str | None = None
    directed: bool = False
    max_speed: float | None = None
    said: Mapping[str, Any] = MappingProxyType({})

    def open_trajectories(self, path: Any) -> "drift.Trajectories":
        """Read trajectories up to the largest speed, by default the usual one."""
        fastest = {} if self.max_speed is None else {"max_speed": self.max_speed}
        return drift.open_trajectories(path, **fastest)


def describe(path: Path, how: Reading | None = None) -> dict[str, Any]:
    """Describe a file: its kind, under the key `what`, and its content."""
    if not path.exists():
        raise absent(path)
    check_result(path)
    if path.is_dir():
        return _directory(path)
    suffix = path.suffix.lower()
    if suffix not in KINDS:
        raise ValueError(f"{path}: expected a file of a kind among {', '.join(KINDS)}")
    reader = KINDS[suffix]
    return reader(path, how or Reading()) if reader in _CHOOSING else reader(path)


def _directory(path: Path) -> dict[str, Any]:
    if path.name == "sweep.zarr" or (path / "spec.toml").is_file():
        return _sweep(path.parent if path.suffix == ".zarr" else path)
    if path.suffix == ".zarr":
        return _zarr(path)
    found = [*itertools.islice(visible(path, "*"), _MOST_FILES + 1)]
    if len(found) > _MOST_FILES:
        raise ValueError(f"{path}: it has more than {_MOST_FILES:,} files; name a folder in it")
    files = sorted(
        str(file.relative_to(path))
        for file in found
        if (file.suffix.lower() in KINDS and file.is_file()) or file.suffix == ".zarr"
        if not any(folder.suffix == ".zarr" for folder in file.relative_to(path).parents)
    )
    if not files:
        raise ValueError(f"{path}: the folder has no file that jaxcell reads")
    if (manifest := Manifest.read(path)) is None:
        return {"what": "a folder", "files": files}
    files.remove(MANIFEST)
    return {
        "what": "a result",
        "command": shlex.join(["jaxcell", *manifest.words]),
        "run_id": manifest.run_id,
        "created": manifest.created,
        "files": files,
    }


def _filter(path: Path) -> dict[str, Any]:
    from ..automata.formats.storage import read_kind

    if path.suffix == ".jxb":
        hidden = automata.HiddenMap.load(path)
        what = "a map for the belief of a robot"
        return {"what": what, "fine_cells": hidden.cells, **hidden.metadata}
    if read_kind(path) == "policy":
        policy = automata.Policy.load(path)
        return {
            "what": "a localization policy",
            "states": policy.turn.size,
            "ends": policy.ends.size,
            "largest_uncertainty": int(policy.uncertainty[policy.ends].max()),
            **policy.metadata,
        }
    filter = automata.Filter.load(path)
    return {
        "what": "a localization filter",
        "states": len(filter.transition),
        "open_world": filter.open_world,
        "knowledge_cycles": [
            {"color": cycle.color, "uncertainty": cycle.uncertainty, "length": len(cycle.states)}
            for cycle in filter.cycles
        ],
        **filter.metadata,
    }


def _netcdf(path: Path, how: Reading) -> dict[str, Any]:
    from ..currents.netcdf import open_netcdf

    with open_netcdf(path, how.said.get("group")) as file:
        return _contents(file.dataset)


def _counts(path: Path) -> dict[str, Any]:
    import numpy as np

    try:
        with path.open("rb") as stream, np.load(stream) as arrays:
            cells, moves = arrays["lon"].size, arrays["data"].sum()
    except Exception as error:
        raise ValueError(f"{path}: not counts of moves of drifters: {error}") from None
    return {"what": "counts of moves of drifters", "cells": int(cells), "moves": int(moves)}


def _zarr(path: Path) -> dict[str, Any]:
    import xarray as xr

    with xr.open_zarr(path) as store:
        return _contents(store)


def _contents(dataset: Any) -> dict[str, Any]:
    attributes = dataset.attrs
    every = [attributes, *(array.attrs for array in dataset.data_vars.values())]
    labels = " ".join(str(about.get("coordinates", "")) for about in every).split()
    ours = "jaxcell_version" in attributes
    shown = {}
    for name, array in dataset.data_vars.items():
        if name not in labels:
            units = f", {array.attrs['units']}" if "units" in array.attrs else ""
            meaning = f": {array.attrs['long_name']}" if "long_name" in array.attrs else ""
            shown[name] = f"({', '.join(array.dims)}){units}{meaning}"
    what = "a result of jaxcell" if ours else _kind_of_sea(dataset)
    hidden = {"title", "coordinates"} if ours else {*attributes}
    more = {name: str(value) for name, value in attributes.items() if name not in hidden}
    about = {"what": f"{what}: {attributes.get('title', 'without a title')}"}
    return {**about, "dimensions": dict(dataset.sizes), "variables": shown, **more}


def _kind_of_sea(dataset: Any) -> str:
    if any(array.ndim > 1 and "s-1" in array.attrs.get("units", "") for array in dataset.values()):
        return "currents"
    keys = {key for array in dataset.variables.values() for key in array.attrs}
    drifting = str(dataset.attrs.get("featureType")).lower() == "trajectory"
    return "trajectories" if drifting or "sample_dimension" in keys else "a NetCDF file"


def _recording(path: Path) -> dict[str, Any]:
    from ..base.optional_modules import import_module
    from .view import recordings_in

    recordings_in(path)
    chunks = import_module("rerun.chunk")
    try:
        reader = chunks.RrdReader(str(path))
        [entry] = reader.recordings()
        schema = reader.store().schema()
    except Exception as error:  # Rerun has no exception of its own for a damaged file.
        message = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{path}: the recording cannot be read: {message}") from None
    return {
        "what": "a Rerun recording; to look at it: jaxcell view",
        "application": entry.application_id,
        "bytes": path.stat().st_size,
        "timelines": [index.name for index in schema.index_columns()],
        "entities": len(schema.entity_paths()),
    }


def _json(path: Path, how: Reading) -> dict[str, Any]:
    try:
        fields = json.loads(_text(path))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not valid JSON, or cut short: {error}") from None
    match fields:
        case {"format": "jaxcell-map"}:
            return _map(path, how)
        case {"format": "jaxcell-robot-task"}:
            return _robot_task(path)
        case {"format": "jaxcell filter", "transition": [*rows], "cycles": [*cycles]}:
            return {
                "what": "a filter, for other programs",
                "states": len(rows),
                "transitions": sum(str(row).count(",") + 1 - str(row).count("-1") for row in rows),
                "knowledge_cycles": len(cycles),
            }
        case {"nodes": _} | {"problem_params": _}:
            return _graph(path, how)
        case {"verts": _} | {"type": "FeatureCollection" | "Feature" | "Polygon" | "MultiPolygon"}:
            return _map(path, how)
        case {"targets": _, "ways": _}:
            game = patrol.rounds.load_game(path)
            described = {"what": "a game of patrols", "vertices": len(game.names)}
            return described | {"targets": game.targets.size, "robots": game.robots}
        case {"kind": "rounds", "robots": [*robots]}:
            return {"what": "routes of guards", "robots": len(robots)}
        case {"command": command}:
            Fields(fields, f"{path}: ").check_version(1)
            plain = {key: value for key, value in fields.items() if not isinstance(value, dict)}
            plain.pop("command")
            return {"what": f"the summary of {command}", **plain}
    raise ValueError(
        f"{path}: expected a map, a graph, a task of robots, a filter, or the summary of a command"
    )


def _map(path: Path, how: Reading) -> dict[str, Any]:
    import numpy as np

    from ..space.cells import suggested
    from ..space.maps.map_server import about_map_server

    ros = path.suffix.lower() in (".yaml", ".yml")
    # The side of cells, which doctor does not choose, is no doubt here.
    workspace, _, _ = suggested(path, 1.0, None, None, *how.part)
    width, height = np.ptp(np.asarray(workspace.boundary, float), axis=0).tolist()
    described = {
        "what": "a map",
        "format": "map_server of ROS" if ros else _map_format(path),
        "name": workspace.name,
        **(about_map_server(_text(path), path.parent) if ros else {}),
        "width_m": round(width, 6),
        "height_m": round(height, 6),
        "obstacles": len(workspace.obstacles),
        "robot_radius_m": workspace.robot_radius,
        "cell_m": workspace.cell,
        "directions": workspace.directions,
        "pieces": workspace.pieces,
    }
    if workspace.cell is not None:
        cells = space.CellSpace.of(workspace, workspace.cell, workspace.directions or 1)
        described["positions"] = cells.positions
    return described


def _map_format(path: Path) -> str:
    """Name the format of a map that has been read."""
    if path.suffix.lower() in (".txt", ".map"):
        return "MovingAI" if _text(path).startswith("type ") else "ASCII grid"
    document = json.loads(_text(path))
    return "HouseExpo" if "verts" in document else document.get("format", "GeoJSON")


def _graph(path: Path, how: Reading) -> dict[str, Any]:
    import numpy as np
    import scipy.sparse

    from ..patrol.files.graph_formats import parsed
    from ..patrol.rounds.game import about_unguarded

    vertices, edges, _ = parsed(path, how.weight)
    ways = patrol.files.load_ways(path, how.weight, how.directed)
    for omitted in (*ways.omitted, *about_unguarded(ways, 1)):
        warn(f"{path}: {omitted}", Doubt)
    there = {*map(tuple, ways.ends.tolist())}
    one_way = sum((head, tail) not in there for tail, head in there)
    described = {"what": "a graph", "vertices": len(ways.names)}
    described["edges"] = (len(there) + one_way) // 2
    described["one_way"] = one_way
    size = len(ways.names)
    joined = scipy.sparse.csr_array((np.ones(len(ways.ends)), tuple(ways.ends.T)), (size, size))
    described["pieces"] = scipy.sparse.csgraph.connected_components(joined, False)[0]
    on_earth = not {"x", "y", "pos"} & vertices[0].attributes.keys()
    described["positions"] = "none" if ways.xy is None else "degrees" if on_earth else "metres"
    if ways.lengths is None:
        return described | {"lengths": "none: each edge takes one step"}
    source = "great circles between ends" if on_earth else "distances of ends"
    if edges[0].length is not None:
        source = f"{how.weight or 'length'} of edges"
    both = np.sort(ways.ends, axis=1) @ [size, 1]
    total = ways.lengths[np.unique(both, return_index=True)[1]].sum()
    return described | {"lengths": source, "total_length_m": round(float(total), 3)}


def _map_or_graph(path: Path, how: Reading) -> dict[str, Any]:
    text = _text(path)
    words = re.search(r"(?m)^(?![#X@. ]+$)\w+[ \t,]+\w+", text)
    return _graph(path, how) if words and not text.startswith("type ") else _map(path, how)


def _robot_task(path: Path) -> dict[str, Any]:
    from ..robot.tasks.files import load_task

    task = load_task(path)
    return {
        "what": "a task of robots; to run it: jaxcell robot run",
        "kind": task.kind,
        "robots": getattr(task, "robots", 1),
        "cell_m": task.cell,
        "directions": task.directions,
        "robot_radius_m": task.radius,
    }


def _log(path: Path) -> dict[str, Any]:
    from ..robot.run_log import read_log

    run = read_log(path)
    end = next((event for event in run.events if event["event"] == "end"), {})
    outcome = {"observations": run.observations, "whole": run.whole, "result": end.get("result")}
    return {"what": "the log of a robot", **run.header, **outcome}


def _sweep(path: Path) -> dict[str, Any]:
    status = sweep.sweep_status(path)
    return {
        "what": "a sweep; to read it: jaxcell.sweep.open_sweep",
        "task": status.task,
        "dimensions": dict(status.dimensions),
        "chunks": status.chunks,
        "done": status.done,
        "failed": len(status.failures),
    }


def _specification(path: Path) -> dict[str, Any]:
    spec = sweep.Spec.load(path)
    sizes = {"dimensions": spec.dimensions, "chunks": spec.chunk_count}
    what = "the specification of a sweep; to run it: jaxcell sweep"
    return {"what": what, "task": spec.task, **sizes}


def _export(path: Path) -> dict[str, Any]:
    what, known, numbers = _EXPORTS[path.suffix.lower()]
    text = _text(path)
    if not re.search(known, text):
        raise ValueError(f"{path}: expected {what}, complete and as `jaxcell` writes it")
    found = {name: re.findall(pattern, text, re.MULTILINE) for name, pattern in numbers.items()}
    counts = {name: int(m[0]) if m[0].isdigit() else len(m) for name, m in found.items() if m}
    title = {"title": text[3:].partition("\n")[0]} if path.suffix.lower() == ".ino" else {}
    return {"what": what, **title, **counts}


def _geojson(path: Path, how: Reading) -> dict[str, Any]:
    text = _text(path)
    if "startid" in text:
        return _graph(path, how)
    if "Polygon" in text:
        return _map(path, how)
    if "LineString" in text:
        raise ValueError(
            f"{path}: lines are neither a map nor a graph; expected polygons for a map, or for a "
            "graph points with an id and lines with startid and endid, or GraphML as of OSMnx"
        )
    return _places(path)


def _places(path: Path) -> dict[str, Any]:
    try:
        if path.suffix.lower() == ".csv":
            rows = csv.DictReader(_text(path).splitlines(), strict=True)
            places = [(float(row["lon"]), float(row["lat"])) for row in rows]
        else:
            features = json.loads(_text(path))["features"]
            points = [feature["geometry"]["coordinates"][:2] for feature in features]
            places = [(float(x), float(y)) for x, y in points]
        lon, lat = zip(*places, strict=True)
    except (csv.Error, ValueError, RecursionError, KeyError, TypeError):
        raise ValueError(
            f"{path}: expected places of drifters: columns lon and lat, or GeoJSON of points"
        ) from None
    return {
        "what": "places of drifters",
        "points": len(places),
        "longitudes": [min(lon), max(lon)],
        "latitudes": [min(lat), max(lat)],
    }


def _table(path: Path, how: Reading) -> dict[str, Any]:
    seen = how.open_trajectories(path)
    return {"what": "trajectories, in a table", "drifters": seen.drifters}


def _csv(path: Path, how: Reading) -> dict[str, Any]:
    header = next(iter(_text(path).splitlines()), "").lower()
    return _table(path, how) if "time" in header or "date" in header else _places(path)


def _picture(path: Path) -> dict[str, Any]:
    from PIL import UnidentifiedImageError

    from ..space.maps.images import read_image

    with about(path):
        try:
            image = read_image(path.read_bytes(), ("PPM", "PNG", "BMP"))
        except UnidentifiedImageError:
            raise ValueError("expected a PGM, PNG or BMP picture") from None
    what = "the picture of a map; its .yaml has the size of a pixel"
    return {"what": what, "width": image.width, "height": image.height}


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text in UTF-8: {error.reason}") from None


_CHOOSING = (_netcdf, _json, _map, _graph, _map_or_graph, _geojson, _table, _csv)
"""The readers whose result depends on `Reading`."""

KINDS: dict[str, Callable[..., dict[str, Any]]] = {
    ".jxb": _filter,
    ".jxf": _filter,
    ".nc": _netcdf,
    ".npz": _counts,
    ".rrd": _recording,
    ".json": _json,
    ".jsonl": _log,
    ".toml": _specification,
    ".yaml": _map,
    ".yml": _map,
    ".txt": _map_or_graph,
    ".map": _map,
    **dict.fromkeys((".pgm", ".png", ".bmp"), _picture),
    **dict.fromkeys(_EXPORTS, _export),
    ".csv": _csv,
    ".geojson": _geojson,
    **dict.fromkeys((".edges", ".graphml", ".graph", ".gml", ".adjlist"), _graph),
    ".parquet": _table,
}
