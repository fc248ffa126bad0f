"""The walk on a graph with the least commute time, as `jaxcell patrol graph`."""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from .parameters import Parameter, members, number, text
from .results import dataset, together


def _names(value: Any) -> tuple[str, ...]:
    some = value if isinstance(value, list | tuple) else [value]
    if len(some) < 2 or not all(isinstance(one, str) for one in some):
        raise ValueError("names of two or more vertices")
    return tuple(some)


PARAMETERS = {
    "file": Parameter(text, file=True),
    "emphasis": Parameter(_names, None),
    "share": Parameter(number("0 or more and less than 1", lambda x: 0 <= x < 1), 0.8),
}
_RESULTS = {
    "commute_time": ("mean number of steps from a vertex to another and back", "steps"),
    "gap": ("relative duality gap", "1"),
    "edges_used": ("edges with a share of the steps above 1e-6", "1"),
    "largest_weight": ("largest share of the steps on one edge", "1"),
}
_USED = 1e-6


def patrol(batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int) -> xr.Dataset:
    """The random walk on a graph that commutes fastest.

    Parameters: the options `file`, `emphasis` (a list of names of vertices, or none) and `share` of
    `jaxcell patrol graph`. Nothing is random. Members with the same graph are one batched call.
    """
    found = members("patrol", PARAMETERS, batch, fixed)
    return dataset(
        _RESULTS,
        together(found, lambda member: (member["file"], member["emphasis"] is None), _rows),
    )


def _rows(some: list[dict[str, Any]]) -> list[tuple[float | int, ...]]:
    from ...optimize import minimum_commute_sweep

    file, evenly = some[0]["file"], some[0]["emphasis"] is None
    graph, names = _graph(file)
    if evenly:
        found = minimum_commute_sweep(graph)
    else:
        emphasis = [_vertices(file, names, member["emphasis"]) for member in some]
        share = np.array([member["share"] for member in some])
        found = minimum_commute_sweep(graph, emphasis=emphasis, share=share)
    weights = np.asarray(found.weights)
    columns = (found.commute_time, found.gap, (weights > _USED).sum(axis=1), weights.max(axis=1))
    rows = list(zip(*(np.asarray(x).tolist() for x in columns), strict=True))
    # Without an emphasis all members have one answer.
    return rows * len(some) if evenly else rows


@functools.lru_cache(maxsize=8)
def _graph(file: str) -> Any:
    from ...patrol.walks.graph_files import load_graph

    return load_graph(Path(file))


def _vertices(file: str, names: tuple[str, ...], wanted: tuple[str, ...]) -> list[int]:
    for name in wanted:
        if name not in names:
            raise ValueError(f"emphasis: expected vertices of {file}, got {name!r}")
    return [names.index(name) for name in wanted]
