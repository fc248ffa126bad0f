"""The output and the files of commands as short JSON, for comparison within a tolerance."""

import csv
import hashlib
import json
import math
from pathlib import Path

import numpy as np
import xarray as xr
from rerun.chunk import RrdReader

import jaxcell


# Far above the rounding differences between machines, far below another result.
TOLERANCE = 1e-8
_LISTED = 40
_ROWS = 4
# Values that depend on the run or the machine: only their presence is compared.
_VOLATILE = {
    "application",
    "back_m",
    "battery_percent",
    "bytes",
    "attributes_sha256",
    # Rounding decides the number for a chaotic attractor.
    "cells_on",
    "created",
    "difference",
    "filter_seconds",
    "forward_m",
    "iterations",
    "jax_version",
    "jaxcell_version",
    "pose",
    "run_id",
    "seconds",
    "sha256",
    "trace",
    "versions",
    "voltage_V",
    "where",
}


def plain(value):
    """A JSON value with long lists summed up, and without what is different each time."""
    if isinstance(value, dict):
        return {
            name: "*" if name in _VOLATILE else plain(one)
            for name, one in value.items()
            # There is none where the source is no checkout.
            if name != "git_revision"
        }
    if isinstance(value, str):
        return value if len(value) <= 2 * _LISTED or " " in value else text(value)
    if isinstance(value, list):
        if len(value) > _ROWS and all(isinstance(one, dict) for one in value):
            names = sorted({name for one in value for name in one})
            columns = {name: plain([one.get(name) for one in value]) for name in names}
            return {"rows": len(value), "columns": columns}
        array = _array(value)
        return [plain(one) for one in value] if array is None else values(array)
    return value if not isinstance(value, float) else _number(value)


def _array(value):
    """A list as an array, if it is one of numbers, or of many strings."""
    try:
        array = np.array(value)
    except ValueError:
        return None
    many = array.dtype.kind == "U" and all(isinstance(one, str) for one in value)
    return array if array.dtype.kind in "biuf" or (many and len(value) > _LISTED) else None


def values(array):
    """The values of an array, or what would be different if one of them were."""
    array = np.asarray(array)
    if array.size <= _LISTED:
        listed = array.astype(str) if array.dtype.kind not in "biuf" else array
        return _listed(listed.tolist())
    found = {"shape": list(array.shape)}
    if array.dtype.kind in "biu":
        low, high = int(array.min()), int(array.max())
        return {**found, "least": low, "most": high, "digest": _digest(array.astype("<i8"))}
    if array.dtype.kind != "f":
        return {**found, "digest": _digest("\n".join(map(str, array.ravel())).encode())}
    flat = array.ravel().astype(float)
    finite = np.isfinite(flat)
    if not finite.all():
        kinds = np.select([finite, np.isnan(flat), flat > 0], [0, 1, 2], 3).astype("<i1")
        found |= {"finite": int(finite.sum()), "not_finite": _digest(kinds)}
    rest = np.where(finite, flat, 0)
    # Values at other places, too, give other sums.
    place = np.arange(flat.size)
    sums = [float(rest @ np.cos(place * step)) for step in (0, 1, math.sqrt(2))]
    ends = [float(rest.min()), float(rest.max())]
    return {**found, "ends": _listed(ends), "sums": _listed(sums)}


def _listed(value):
    return [_listed(one) for one in value] if isinstance(value, list) else _number(value)


def _number(value):
    if not isinstance(value, float):
        return value
    if not math.isfinite(value):
        return str(value)
    # Nothing but noise would be left of it.
    return 0.0 if abs(value) < TOLERANCE / 2 else float(f"{value:.10g}")


def _digest(data):
    return hashlib.sha256(np.ascontiguousarray(data) if len(data) else b"").hexdigest()[:16]


def text(value):
    """The number of lines of a text, and its digest."""
    value = value.replace(jaxcell.__version__, "VERSION")
    return {"lines": value.count("\n") + 1, "digest": _digest(np.frombuffer(value.encode(), "u1"))}


def file(path):
    """The content of a file, read by its suffix."""
    read = {
        ".nc": netcdf,
        ".rrd": recording,
        ".json": lambda path: plain(json.loads(path.read_text())),
        ".geojson": lambda path: plain(json.loads(path.read_text())),
        ".csv": lambda path: plain(list(csv.DictReader(path.read_text().splitlines()))),
        # Commands that read them tell what is in them.
        ".jxf": lambda path: "*",
        ".jsonl": lambda path: "*",
    }
    if path.name == "result.json":
        manifest = json.loads(path.read_text())
        # Files of other runs have another digest in each run.
        inputs = {
            name: digest if name.startswith("data/") or "/" not in name else "*"
            for name, digest in manifest["inputs"].items()
        }
        return plain({**manifest, "inputs": inputs, "files": sorted(manifest["files"])})
    return read.get(path.suffix, lambda path: text(path.read_text()))(path)


def netcdf(path):
    """Dimensions, variables and attributes of a NetCDF file."""
    with xr.open_dataset(path, mask_and_scale=False, decode_times=False) as dataset:
        attributes = dict(dataset.attrs)
        if "spec" in attributes:
            attributes["spec"] = json.loads(attributes["spec"])
        return {
            "dimensions": dict(dataset.sizes),
            "attributes": plain(_python(attributes)),
            "variables": {
                name: _variable(one) | ({"values": "*"} if name in _VOLATILE else {})
                for name, one in dataset.variables.items()
            },
            "coordinates": sorted(dataset.coords),
        }


def _variable(variable):
    dtype = "str" if variable.dtype.kind in "OSU" else str(variable.dtype)
    return {
        "is": f"{dtype}({', '.join(variable.dims)})",
        **plain(_python(variable.attrs)),
        "values": values(variable.values),
    }


def _python(attributes):
    return {
        name: one.tolist() if isinstance(one, np.ndarray | np.generic) else one
        for name, one in attributes.items()
    }


def recording(path):
    """The entities of a recording with their timelines, and the views of its blueprint."""
    reader = RrdReader(path)
    entities = {}
    for chunk in reader.stream().to_chunks():
        known = entities.setdefault(chunk.entity_path, set())
        known |= {"static"} if chunk.is_static else set(chunk.timeline_names)
    views = []
    for store in reader.blueprints():
        for chunk in reader.stream(store=store).to_chunks():
            batch = chunk.to_record_batch().to_pydict()
            if "ViewBlueprint:class_identifier" in batch:
                (kind,) = batch["ViewBlueprint:class_identifier"][-1]
                (name,) = batch["ViewBlueprint:display_name"][-1]
                views.append(f"{kind}: {name}")
    return {
        "entities": {entity: ", ".join(sorted(some)) for entity, some in entities.items()},
        "timelines": sorted(set().union(*entities.values()) - {"static"}),
        "views": sorted(views),
    }


def dump(value, indent=0):
    """JSON with sorted keys and what is short in one line."""
    line = json.dumps(value, sort_keys=True, ensure_ascii=False)
    pad = " " * (indent + 1)
    if isinstance(value, dict) and len(line) + indent > 90:
        parts = [
            f"{pad}{json.dumps(name, ensure_ascii=False)}: {dump(value[name], indent + 1)}"
            for name in sorted(value)
        ]
        return "{\n" + ",\n".join(parts) + f"\n{' ' * indent}}}"
    if isinstance(value, list) and any(isinstance(one, dict | list) for one in value):
        parts = [pad + dump(one, indent + 1) for one in value]
        return line if len(line) + indent <= 90 else "[\n" + ",\n".join(parts) + f"\n{pad[1:]}]"
    return line


def differences(expected, found, tolerance=TOLERANCE, place=""):
    """Find where two values of plain JSON differ by more than the tolerance, and how."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for name in sorted({*expected, *found}):
            here = f"{place} > {name}" if place else name
            if name not in found:
                yield f"{here}: is missing; it was {_short(expected[name])}"
            elif name not in expected:
                yield f"{here}: is new: {_short(found[name])}"
            else:
                yield from differences(expected[name], found[name], tolerance, here)
    elif isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        for i, (one, other) in enumerate(zip(expected, found, strict=True)):
            yield from differences(one, other, tolerance, f"{place}[{i}]")
    elif not _alike(expected, found, tolerance):
        yield f"{place}: was {_short(expected)}, is {_short(found)}"


def settled(recorded, found, tolerance=TOLERANCE):
    """Take what is recorded where it is within the tolerance, and what is found elsewhere."""
    if isinstance(recorded, dict) and isinstance(found, dict):
        return {
            name: settled(recorded[name], one, tolerance) if name in recorded else one
            for name, one in found.items()
        }
    if isinstance(recorded, list) and isinstance(found, list) and len(recorded) == len(found):
        pairs = zip(recorded, found, strict=True)
        return [settled(one, other, tolerance) for one, other in pairs]
    return recorded if _alike(recorded, found, tolerance) else found


def _alike(one, other, tolerance):
    if any(type(x) not in (int, float) for x in (one, other)) or {type(one), type(other)} == {int}:
        return one == other and isinstance(one, bool) == isinstance(other, bool)
    return math.isclose(one, other, rel_tol=tolerance, abs_tol=tolerance)


def _short(value):
    line = json.dumps(value, sort_keys=True, ensure_ascii=False)
    return line if len(line) <= 200 else f"{line[:200]}..."


def load(path: Path):
    return json.loads(path.read_text(encoding="utf-8"))
