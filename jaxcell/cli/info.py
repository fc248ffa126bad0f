import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tyro

from . import info_exports
from .options import Printing
from .terminal import say, table


@dataclasses.dataclass(frozen=True, kw_only=True)
class Info(Printing):
    """Describe a file: a map, a graph, currents, or a result."""

    file: tyro.conf.Positional[Path]
    """Any file that jaxcell reads or writes, or a directory of results."""

    def run(self) -> int:
        found = describe(self.file)
        if self.json:
            say(json.dumps(found))
        else:
            rows = [(name.replace("_", " "), _shown(value)) for name, value in found.items()]
            table(str(self.file), ("", ""), rows)
        return 0


def describe(path: Path) -> dict[str, Any]:
    """Describe what a file is, as `what`, and what is in it.

    **Raises:** `ValueError` if it is of no known kind, or damaged; `FileNotFoundError`.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: there is no such file")
    if path.is_dir():
        return _directory(path)
    suffix = path.suffix.lower()
    if suffix not in _KINDS:
        raise ValueError(f"{path}: expected a file of a kind among {', '.join(_KINDS)}")
    return _KINDS[suffix](path)


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return "\n".join(f"{name}: {_shown(part)}" for name, part in value.items())
    if isinstance(value, list):
        parts = [_shown(part).replace("\n", ", ") for part in value]
        return ("\n" if any(isinstance(part, dict) for part in value) else ", ").join(parts)
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)


def _directory(path: Path) -> dict[str, Any]:
    if path.name == "sweep.zarr" or (path / "spec.toml").is_file():
        return _sweep(path.parent if path.suffix == ".zarr" else path)
    if path.suffix == ".zarr":
        return _zarr(path)
    files = sorted(
        str(file.relative_to(path))
        for file in path.rglob("*")
        if (file.suffix.lower() in _KINDS and file.is_file()) or file.suffix == ".zarr"
        if not any(folder.suffix == ".zarr" for folder in file.relative_to(path).parents)
    )
    if not files:
        raise ValueError(f"{path}: there is no file of jaxcell's in it")
    return {"what": "a directory", "files": files}


def _belief(path: Path) -> dict[str, Any]:
    from ..automata import HiddenMap

    hidden = HiddenMap.load(path)
    return {
        "what": "a map for the belief of a robot",
        "fine_cells": hidden.cells,
        **hidden.metadata,
    }


def _filter(path: Path) -> dict[str, Any]:
    from ..automata import Filter, Policy
    from ..automata.formats.storage import read_kind

    if read_kind(path) == "policy":
        policy = Policy.load(path)
        return {
            "what": "a localization policy",
            "states": policy.turn.size,
            "ends": policy.ends.size,
            "largest_uncertainty": int(policy.uncertainty[policy.ends].max()),
            **policy.metadata,
        }
    filter = Filter.load(path)
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


def _netcdf(path: Path) -> dict[str, Any]:
    import netCDF4
    from scipy.io import netcdf_file

    from ..drift.currents.netcdf import netcdf_engine

    try:
        if netcdf_engine(path) == "scipy":
            # The other library may look for ages for what a damaged header promises.
            netcdf_file(path).close()
        with netCDF4.Dataset(path) as file:
            # Values are not read: there may be very many.
            every = (file, *file.variables.values())
            named = [str(one.__dict__.get("coordinates", "")) for one in every]
            coordinates = {*file.dimensions, *" ".join(named).split()}
            variables = {
                name: (one.dimensions, one.__dict__)
                for name, one in file.variables.items()
                if name not in coordinates
            }
            sizes = {name: len(one) for name, one in file.dimensions.items()}
            return _contents(sizes, variables, file.__dict__)
    except Exception as error:  # what a damaged file makes the library raise is not written
        message = " ".join(str(error).split())[:500] or type(error).__name__
        raise ValueError(f"{path}: not a NetCDF file that can be read: {message}") from None


def _zarr(path: Path) -> dict[str, Any]:
    import xarray as xr

    with xr.open_zarr(path) as found:
        variables = {name: (one.dims, one.attrs) for name, one in found.data_vars.items()}
        return _contents(dict(found.sizes), variables, found.attrs)


def _contents(
    sizes: dict[Any, int],
    variables: dict[Any, tuple[tuple[Any, ...], dict[str, Any]]],
    everything: dict[str, Any],
) -> dict[str, Any]:
    """What is in a file of labelled arrays, by their dimensions and attributes, and its own."""
    ours = "jaxcell_version" in everything
    attributes = {name: str(value) for name, value in everything.items() if ours or name == "title"}
    title = attributes.pop("title", "without a title")
    attributes.pop("coordinates", None)
    shown = {}
    for name, (dimensions, about) in variables.items():
        units = f", {about['units']}" if "units" in about else ""
        meaning = f": {about['long_name']}" if "long_name" in about else ""
        shown[name] = f"({', '.join(dimensions)}){units}{meaning}"
    what = f"a result of jaxcell: {title}" if ours else f"a NetCDF file: {title}"
    return {"what": what, "dimensions": sizes, "variables": shown, **attributes}


def _recording(path: Path) -> dict[str, Any]:
    from ..base.optional_modules import import_module
    from .view import recordings_in

    recordings_in(path)
    chunks = import_module("rerun.chunk")
    try:
        reader = chunks.RrdReader(str(path))
        [entry] = reader.recordings()
        schema = reader.store().schema()
    except Exception as error:
        # Rerun has no exception of its own for a damaged file.
        message = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{path}: the recording cannot be read: {message}") from None
    return {
        "what": "a Rerun recording; to look at it: jaxcell view",
        "application": entry.application_id,
        "bytes": path.stat().st_size,
        "timelines": [index.name for index in schema.index_columns()],
        "entities": len(schema.entity_paths()),
    }


def _json(path: Path) -> dict[str, Any]:
    try:
        fields = json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not valid JSON, or cut short: {error}") from None
    if not isinstance(fields, dict):
        raise ValueError(f"{path}: expected a JSON object, as all of ours are")
    match fields:
        case {"format": "jaxcell-map"}:
            return _map(path)
        case {"format": "jaxcell-robot-task"}:
            return _robot_task(path)
        case {"format": "jaxcell filter"}:
            return info_exports.filter_json(path, fields)
        case {"nodes": _}:
            return _graph(path)
        case {"command": command}:
            plain = {key: one for key, one in fields.items() if not isinstance(one, dict)}
            plain.pop("command", None)
            return {"what": f"the summary of {command}", **plain}
    raise ValueError(
        f"{path}: neither a map, a graph, a task of robots, nor a summary of a command"
    )


def _map(path: Path) -> dict[str, Any]:
    import numpy as np

    from ..space import CellSpace, Workspace

    workspace = Workspace.load(path)
    corners = np.asarray(workspace.boundary, float)
    width, height = np.ptp(corners, axis=0).tolist()
    found = {
        "what": "a map",
        "name": workspace.name,
        "width_m": round(width, 6),
        "height_m": round(height, 6),
        "obstacles": len(workspace.obstacles),
        "robot_radius_m": workspace.robot_radius,
        "cell_m": workspace.cell,
        "directions": workspace.directions,
    }
    if workspace.cell is not None:
        cells = CellSpace.of(workspace, workspace.cell, workspace.directions or 1)
        found |= {"positions": cells.positions}
    return found


def _graph(path: Path) -> dict[str, Any]:
    from ..patrol import load_graph

    graph, names = load_graph(path)
    return {"what": "a graph", "vertices": len(names), "edges": len(graph.edges)}


def _robot_task(path: Path) -> dict[str, Any]:
    from ..robot.tasks.files import load_task

    task = load_task(path)
    return {
        "what": "a task of robots; to run it: jaxcell robot run",
        "kind": task.header["kind"],
        "robots": getattr(task, "robots", 1),
        "cell_m": task.cell,
        "directions": task.directions,
        "robot_radius_m": task.radius,
    }


def _sweep(path: Path) -> dict[str, Any]:
    from ..sweep import sweep_status

    found = sweep_status(path)
    return {
        "what": "a sweep; to read it: jaxcell.sweep.open_sweep",
        "task": found.task,
        "dimensions": dict(found.dimensions),
        "chunks": found.chunks,
        "done": found.done,
        "failed": len(found.failures),
    }


def _specification(path: Path) -> dict[str, Any]:
    from ..sweep import Spec

    spec = Spec.load(path)
    return {
        "what": "the specification of a sweep; to run it: jaxcell sweep",
        "task": spec.task,
        "dimensions": spec.dimensions,
        "chunks": spec.chunk_count,
    }


def _map_or_graph(path: Path) -> dict[str, Any]:
    try:
        return _map(path)
    except ValueError as no_map:
        try:
            return _graph(path)
        except ValueError:
            raise no_map from None


def _log(path: Path) -> dict[str, Any]:
    from ..robot.run_log import read_log

    run = read_log(path)
    end = next((event for event in run.events if event["event"] == "end"), None)
    return {
        "what": "the log of a robot",
        **run.header,
        "observations": run.observations,
        "whole": run.whole,
        "result": None if end is None else end.get("result"),
    }


_KINDS: dict[str, Callable[[Path], dict[str, Any]]] = {
    ".jxb": _belief,
    ".jxf": _filter,
    ".nc": _netcdf,
    ".rrd": _recording,
    ".json": _json,
    ".jsonl": _log,
    ".toml": _specification,
    ".yaml": _map,
    ".yml": _map,
    ".txt": _map_or_graph,
    ".pgm": info_exports.picture,
    ".dot": info_exports.dot,
    ".jff": info_exports.jflap,
    ".h": info_exports.c_header,
    ".ino": info_exports.sketch,
    ".csv": info_exports.points_csv,
    ".geojson": info_exports.geojson,
    ".edges": _graph,
    ".graphml": _graph,
}
