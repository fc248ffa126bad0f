import dataclasses
import json
import re
import warnings
from pathlib import Path
from typing import Any, ClassVar

import tyro

from .. import drift, patrol, record, space
from ..base.doubts import Doubt
from ..base.limits import Unknown
from ..base.optional_modules import import_module
from ..base.paths import replacing
from ..study.drift.sea_study import Naming
from ..study.map_study import read_part
from ..study.parameters import Headings, Pose
from .described import Reading, describe
from .output import Printing
from .terminal import say, table


@dataclasses.dataclass(frozen=True, kw_only=True)
class Doctor(Naming, Printing):
    """Examine any file: what it is taken for and why, and each doubt with the option that settles
    it.

    Exit status: 0 if nothing is doubtful, 1 if something is.
    """

    example: ClassVar[str] = "@lab_a"
    headings: ClassVar[Headings] = {
        "How is a map read?": ("unknown", "piece", "crop"),
        "How is a graph read?": ("weight", "directed"),
        "How are trajectories read?": ("max_speed",),
        "How are currents read?": tuple(Naming.__annotations__),
    }

    file: tyro.conf.Positional[tuple[Path, ...]]
    """Files that jaxcell reads or writes, or folders of them."""
    out: Path | None = None
    """File for a picture of a map, a graph, trajectories or currents, .png."""
    unknown: Unknown = "wall"
    """Meaning of unknown pixels of a ROS map, wall or free."""
    piece: Pose | None = None
    """Connected part of the free space: largest, all, or the part around the point "x,y"."""
    crop: Pose | None = None
    """Part of a map of squares to read: two opposite corners "x,y,x,y" in metres."""
    weight: str | None = None
    """Attribute of edges that is their length; by default length."""
    directed: bool = False
    """Take each edge of the file as one-way."""
    max_speed: float | None = None
    """Largest speed of drifters in m/s; by default 10."""

    def run(self) -> int:
        if not self.file:
            raise ValueError("file: expected at least one, got none")
        if self.out is not None and len(self.file) != 1:
            raise ValueError(f"out: expected one file to draw, got {len(self.file)}")
        part = read_part(self.unknown, self.piece, self.crop)
        how = Reading(part, self.weight, self.directed, self.max_speed, self.said)
        one_sea = len(self.file) > 1 and all(_may_be_current(path, how) for path in self.file)
        sources = [self.file] if one_sea else [(path,) for path in self.file]
        reports = [examine(*paths, how=how) for paths in sources]
        self._check_options([report["what"] for report in reports])
        if self.json:
            say(json.dumps(reports[0] if len(reports) == 1 else reports))
        else:
            for paths, report in zip(sources, reports, strict=True):
                shown = report | {"doubts": "\n".join(report["doubts"]) or "none"}
                names = [name.replace("_", " ") for name in shown]
                table(", ".join(map(str, paths)), names, [[*map(_shown, shown.values())]])
        if self.out is not None:
            save_picture(self.file[0], reports[0]["what"], self.out, how)
        return int(any(report["doubts"] for report in reports))

    def _check_options(self, kinds: list[str]) -> None:
        """Refuse options that have no effect on any of the files."""
        of_kinds = "a map", "a graph", "trajectories", "currents"
        for kind, names in zip(of_kinds, self.headings.values(), strict=True):
            # Options may be wrong for a NetCDF file that is not read.
            if not any(what.startswith((kind, "a folder", "a NetCDF file")) for what in kinds):
                for name in names:
                    if getattr(self, name) not in (None, False, "wall"):
                        raise ValueError(f"{name}: it has an effect on {kind}, not on {kinds[0]}")


def _may_be_current(path: Path, how: Reading) -> bool:
    with warnings.catch_warnings(action="ignore"):
        return bool(re.match("currents|a NetCDF file", describe(path, how)["what"]))


def examine(path: Path, *others: Path, how: Reading) -> dict[str, Any]:
    """Describe a file as `describe` does, with what commands read from it, and its `doubts`.

    The `others` are more files of the same currents, such as those of v. A folder that is no result
    has the kind of each of its files, and their doubts.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        described = describe(path, how)
        if re.match("currents|trajectories|a NetCDF file", described["what"]):
            described |= _sea((path, *others), described["what"], how)
    if described["what"] == "a folder":
        return _folder(path, described, how)
    said = {_with_options(str(one.message)): one.category for one in caught}
    doubts = [text for text, category in said.items() if issubclass(category, Doubt)]
    notes = [text for text, category in said.items() if category is UserWarning]
    notes = [one for one in described.get("notes", []) if one not in "\n".join(doubts)] + notes
    return described | ({"notes": notes} if notes else {}) | {"doubts": doubts}


def _folder(path: Path, described: dict[str, Any], how: Reading) -> dict[str, Any]:
    kinds, doubts = {}, []
    for name in described["files"]:
        try:
            report = examine(path / name, how=how)
            kinds[name], more = report["what"], report["doubts"]
        except (ValueError, OSError, MemoryError) as error:
            kinds[name], more = "not read", [str(error)]
        doubts += [one if name in one else f"{name}: {one}" for one in more]
    return described | {"files": kinds, "doubts": doubts}


def _with_options(doubt: str) -> str:
    return re.sub(r'`(\w+)(?:="(\w+)")?`', lambda found: _option(*found.groups()), doubt)


def _option(name: str, value: str | None) -> str:
    return f"--{name.replace('_', '-')} {value or ''}".strip()


def _sea(path: tuple[Path, ...], what: str, how: Reading) -> dict[str, Any]:
    """Read trajectories or currents as the commands do, and say what they are taken for."""
    errors = []
    for kind, read in (("trajectories", _of_trajectories), ("currents", _of_currents)):
        if what.startswith((kind, "a NetCDF file")):
            try:
                return {"what": re.sub("^[^:,]*", kind, what), **read(path, how)}
            except (ValueError, MemoryError) as error:
                errors.append(f"not read as {kind}: {error}")
    warnings.warn("; ".join(errors), Doubt, stacklevel=2)
    return {}


def _of_trajectories(path: tuple[Path, ...], how: Reading) -> dict[str, Any]:
    seen = how.open_trajectories(path)
    spans = {"longitudes": seen.lon, "latitudes": seen.lat, "seconds": seen.time}
    return {
        "drifters": seen.drifters,
        "observations": seen.lon.size,
        **{name: [float(values.min()), float(values.max())] for name, values in spans.items()},
        "since": seen.since or "unknown",
    }


def _of_currents(path: tuple[Path, ...], how: Reading) -> dict[str, Any]:
    from ..currents.ocean import read_moments

    times = read_moments(path, **how.said)
    sea = drift.open_currents(path, mean=True, **how.said)
    about = sea.attrs
    return {
        "eastward": about["east_from"],
        "northward": about["north_from"],
        "records": len(times),
        "times": [str(times[0]), str(times[-1])] if len(times) else [],
        "depths_m": sea.depth.values.round(3).tolist(),
        "water_cells": int(sea.water.sum()),
        "land_cells": int(sea.land.sum()),
        "notes": about["notes"].splitlines(),
    }


def save_picture(path: Path, what: str, out: Path, how: Reading) -> None:
    """Draw a map, a graph, trajectories or currents, as commands read them, in a PNG file."""
    figure = import_module("matplotlib.figure").Figure(layout="constrained")
    ax = figure.add_subplot()
    kind = re.split("[:,]", what)[0]
    with warnings.catch_warnings(action="ignore"):
        if kind == "a map":
            room, cell, _ = space.cells.suggested(path, None, None, None, *how.part)
            record.plot(space.CellSpace.of(room, cell, 1), ax=ax)
        elif kind == "a graph":
            ways = patrol.files.load_ways(path, how.weight, how.directed)
            edges = {tuple(sorted(pair)) for pair in ways.ends.tolist()}
            record.plot(patrol.Graph(sorted(edges), len(ways.names), ways.xy), ax=ax)
        elif kind == "trajectories":
            seen = how.open_trajectories(path)
            ax.scatter(seen.lon, seen.lat, 2, seen.drifter, cmap="tab20")
        elif kind == "currents":
            sea = drift.open_currents(path, mean=True, **how.said)
            speed = (sea.u**2 + sea.v**2).values[0, 0] ** 0.5
            mesh = ax.pcolormesh(sea.lon, sea.lat, speed)
            figure.colorbar(mesh, label="speed of the mean current (m/s)")
        else:
            raise ValueError(f"out: {path} is {what}, of which there is no picture here")
    ax.set_title(str(path))
    with replacing(out) as temporary:
        figure.savefig(temporary, format="png", dpi=130)


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return "\n".join(f"{name}: {_shown(part)}" for name, part in value.items())
    if isinstance(value, list):
        parts = [_shown(part).replace("\n", ", ") for part in value]
        return ("\n" if any(isinstance(part, dict) for part in value) else ", ").join(parts)
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)
