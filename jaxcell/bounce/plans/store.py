"""Zarr stores of all plans of a map, which are written and read in blocks of entries."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from jaxtyping import Int

from ... import __version__
from ...base.documents import check_version
from ...base.paths import absent, replacing
from ...space import CellSpace
from .roadmap import Roadmap, describe_space
from .routes import Routes, block_size


_FORMAT, _VERSION = "jaxcell-plans", 1
_ROUTES = ("entry_index", "wall_index")
_VARIABLES = {
    "wall": (("cell",), "index of the wall that the cell runs to"),
    "length": (("cell",), "steps to that wall"),
    "turned": (("angle", "wall_index"), "cell after a bump"),
    "bounces": (("angle",), "bouncing angle in radians, counter-clockwise"),
    "wall_cell": (("wall_index",), "cell that is the wall"),
    "entry": (("entry_index",), "cell that a robot can turn into at a bump"),
    "entry_of": (("cell",), "index of the entry that leads to the cell, -1 for none"),
    "cost": (_ROUTES, "cost of the route from the wall to the entry with the first bump; -1: none"),
    "layer": (_ROUTES, "layer that the route begins in, the angle in use if method is exact"),
    "turn": (
        ("entry_index", "angle", "wall_index"),
        "index of the angle to turn by at the wall, in the layer; -1: none",
    ),
}


def write_plans(path: str | os.PathLike[str], roadmap: Roadmap, routes: Iterable[Routes]) -> None:
    """Write a roadmap and the routes to all its entries to a folder, completely or not at all.

    The folder, such as `plans.zarr`, is replaced if it exists. `routes` yields blocks of routes.
    """
    angles, walls = roadmap.turned.shape
    entries = roadmap.entry.size
    chunk = min(block_size(roadmap), entries)
    attributes = {
        "format": _FORMAT,
        "version": _VERSION,
        "title": "Cheapest plans of a bouncing robot between all pairs of cells",
        "source": "jaxcell; Alam 2018, Alg. 3.2",
        "jaxcell_version": __version__,
        "keep": roadmap.keep,
        "change": roadmap.change,
        "method": roadmap.method,
        "space": dict(roadmap.space),
        "cell_index": "direction * positions + position",
        "cost_of_a_plan": (
            "from cell s to cell g: keep * (length[s] - length[g]) if both are on the line "
            "of one wall, and g is not farther from it; else, with e = entry_of[g], "
            "keep * (length[s] + length[entry[e]] - length[g]) + cost[e, wall[s]], "
            "and no path if e or the cost is -1"
        ),
    }
    blocks: dict[str, tuple[tuple[int, ...], np.dtype]] = {
        "cost": ((walls,), roadmap.number),
        "layer": ((walls,), roadmap.small),
        "turn": ((angles, walls), roadmap.small),
    }
    with replacing(path) as temporary:
        store: Any = zarr.create_group(temporary, attributes=attributes)
        layout: dict[str, Any]
        for name, (dims, meaning) in _VARIABLES.items():
            if name in blocks:
                shape, dtype = blocks[name]
                layout = {"shape": (entries, *shape), "chunks": (chunk, *shape), "dtype": dtype}
            else:
                values = getattr(roadmap, name)
                layout = {"data": values, "chunks": values.shape}
            attributes = {"long_name": meaning}
            store.create_array(name, dimension_names=dims, attributes=attributes, **layout)
        done = 0
        for part in routes:
            rows = slice(done, done + len(part.cost))
            for name in blocks:
                store[name][rows] = getattr(part, name)
            done = rows.stop


def read_roadmap(path: Path, cells: CellSpace) -> Roadmap:
    if not path.exists():
        raise absent(path)
    try:
        store: Any = zarr.open_group(path, mode="r")
        about: dict[str, Any] = dict(store.attrs)
    except Exception as error:  # zarr does not document the errors of damaged stores
        raise ValueError(f"{path}: expected a Zarr store of plans: {_line(error)}") from None
    if about.get("format") != _FORMAT:
        raise ValueError(f"{path}: expected a store of plans; its format is not {_FORMAT!r}")
    check_version(about.get("version", 1), _VERSION, f"{path}: ")
    try:
        space = dict(about["space"])
        for name, expected in describe_space(cells).items():
            if space.get(name) != expected:
                raise ValueError(f"{name}: expected {expected} as in the cells, got {space[name]}")
        angles, walls = store["turned"].shape
        shapes = {"wall": (cells.size,), "length": (cells.size,), "bounces": (angles,)}
        for name, shape in shapes.items():
            if store[name].shape != shape:
                raise ValueError(f"{name}: expected the shape {shape}, got {store[name].shape}")
        if angles > cells.directions or walls > cells.size:
            raise ValueError(f"turned: {angles} angles and {walls} walls are too many")
        return Roadmap(
            **{name: store[name][:] for name in ("wall", "length", "turned", "bounces")},
            keep=about["keep"],
            change=about["change"],
            method=about["method"],
            space=space,
        )
    except Exception as error:
        raise ValueError(f"{path}: {_line(error)}") from None


def read_routes(path: Path, entries: Int[np.ndarray, "entries"]) -> Routes:
    """Read the routes to `entries`, which are in ascending order, from a store of plans."""
    store: Any = zarr.open_group(path, mode="r")
    return Routes(*(store[name].oindex[entries] for name in ("cost", "layer", "turn")))


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:500] or type(error).__name__
