"""Files of all plans: NetCDF, written and read some goals at a time.

netCDF4 takes a tenth of a second to import, so that is done when it is needed.
"""

import json
import os
import reprlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from ... import __version__
from ...base.paths import replacing
from .roadmap import Roadmap
from .routes import Routes, block_size


_FORMAT = "jaxcell-plans"
_VERSION = 1
# No zlib stream grows more than this many times when it is read.
_ZLIB_RATIO = 1032


def write_plans(path: str | os.PathLike[str], roadmap: Roadmap, routes: Iterable[Routes]) -> None:
    """Write a roadmap and the routes through it, whole or not at all.

    **Arguments:**

    - `path`: the file to write or replace.
    - `roadmap`: the roadmap.
    - `routes`: the routes to all entries, some at a time.

    **Raises:** `FileNotFoundError` if the folder does not exist.
    """
    import netCDF4

    angles, walls = roadmap.turned.shape
    entries = roadmap.entry.size
    with replacing(path) as temporary, netCDF4.Dataset(temporary, "w") as file:
        file.setncatts(
            {
                "format": _FORMAT,
                "format_version": _VERSION,
                "title": "Cheapest plans of a bouncing robot between all pairs of cells",
                "source": "jaxcell; Alam 2018, Alg. 3.2",
                "jaxcell_version": __version__,
                "keep": roadmap.keep,
                "change": roadmap.change,
                "method": roadmap.method,
                "space": json.dumps(dict(roadmap.space)),
                "cell_index": "direction * positions + position",
                "cost_of_a_plan": (
                    "from cell s to cell g: keep * (length[s] - length[g]) if both are on the line "
                    "of one wall, and g is not farther from it; else, with e = entry_of[g], "
                    "keep * (length[s] + length[entry[e]] - length[g]) + cost[e, wall[s]], "
                    "and no path if e or the cost is -1"
                ),
            }
        )
        for name, size in [("cell", roadmap.size), ("angle", angles), ("wall_index", walls)]:
            file.createDimension(name, size)
        file.createDimension("entry_index", entries)

        def create(name: str, over: tuple[str, ...], kind: Any, meaning: str, **more: Any) -> Any:
            made = file.createVariable(name, kind, over, compression="zlib", complevel=1, **more)
            made.long_name = meaning
            return made

        for name, over, meaning in _ROADMAP:
            values = getattr(roadmap, name)
            create(name, over, values.dtype, meaning)[:] = values
        file["length"].units = "steps"
        file["bounces"].units = "rad"
        chunk = min(block_size(roadmap), entries)
        over = ("entry_index", "wall_index")
        cost = create("cost", over, roadmap.number, _COST, chunksizes=(chunk, walls))
        layer = create("layer", over, roadmap.small, _LAYER, chunksizes=(chunk, walls))
        over = ("entry_index", "angle", "wall_index")
        turn = create("turn", over, roadmap.small, _TURN, chunksizes=(chunk, angles, walls))
        done = 0
        for some in routes:
            rows = slice(done, done + len(some.cost))
            cost[rows], layer[rows], turn[rows] = some.cost, some.layer, some.turn
            done = rows.stop


def read_roadmap(path: Path) -> Roadmap:
    """The roadmap in a file of plans.

    **Raises:** `ValueError` if it is not a file of plans; `FileNotFoundError`.
    """
    import netCDF4

    if not path.exists():
        raise FileNotFoundError(f"{path}: there is no such file")
    try:
        with path.open("rb") as content:
            if content.read(3) == b"CDF":  # The library may crash on one that is damaged.
                raise ValueError("it is of version 3; plans are written in version 4")
        file = netCDF4.Dataset(path)
    except Exception as error:  # what a damaged file makes the library raise is not written
        raise ValueError(f"{path}: expected a NetCDF file of plans: {_line(error)}") from None
    with file:
        try:
            return _read_roadmap(path, file)
        except Exception as error:  # as above
            if str(error).startswith(f"{path}: "):
                raise
            raise ValueError(f"{path}: a damaged file of plans: {_line(error)}") from error


def _read_roadmap(path: Path, file: Any) -> Roadmap:
    attributes = file.__dict__
    found = attributes.get("format"), attributes.get("format_version")
    if found != (_FORMAT, _VERSION):
        raise ValueError(
            f"{path}: expected a file of plans, format {_FORMAT!r} version {_VERSION}, "
            f"got {reprlib.repr(found[0])} version {reprlib.repr(found[1])}"
        )
    file.set_auto_mask(False)
    length = path.stat().st_size
    for name, over, _ in _ROADMAP:
        if file[name].dimensions != over:
            raise ValueError(f"{path}: {name}: expected the dimensions {', '.join(over)}")
        size = file[name].size * file[name].dtype.itemsize
        if size > _ZLIB_RATIO * length:
            raise ValueError(f"{path}: {name}: {size:,} bytes cannot come from {length:,}")
    return Roadmap(
        wall=file["wall"][:],
        length=file["length"][:],
        turned=file["turned"][:],
        bounces=file["bounces"][:],
        keep=attributes["keep"].item(),
        change=attributes["change"].item(),
        method=attributes["method"],
        space=dict(json.loads(attributes["space"])),
    )


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:500] or type(error).__name__


def read_routes(path: Path, entries: Int[np.ndarray, "some"]) -> Routes:
    """The routes to some entries, in ascending order, from a file of plans."""
    import netCDF4

    with netCDF4.Dataset(path) as file:
        file.set_auto_mask(False)
        return Routes(*(file[name][entries] for name in ("cost", "layer", "turn")))


_ROADMAP = [
    ("wall", ("cell",), "index of the wall that the cell runs to"),
    ("length", ("cell",), "steps until it is there"),
    ("turned", ("angle", "wall_index"), "cell after a bump"),
    ("bounces", ("angle",), "bouncing angle, counter-clockwise"),
    ("wall_cell", ("wall_index",), "cell that is the wall"),
    ("entry", ("entry_index",), "cell that a robot can turn into at a bump"),
    ("entry_of", ("cell",), "index of the entry that leads to the cell, -1 if there is none"),
]
_COST = "cost of the route from the wall to the entry, the first bump included; -1: none"
_LAYER = "layer that the route begins in; the layer is the angle in use (method exact)"
_TURN = "index of the angle to turn by at the wall, in the layer; -1: none"
