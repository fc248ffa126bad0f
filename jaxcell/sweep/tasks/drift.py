"""Where an ocean current carries drifters, as `jaxcell drift`."""

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from .parameters import Parameter, members, number, one_of, text
from .results import dataset


def _record(value: Any) -> int | str:
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise ValueError("the number of a record, or its moment")
    return value


PARAMETERS = {
    "file": Parameter(text, file=True),
    "time": Parameter(_record, None),
    "depth": Parameter(number("a depth in metres", lambda x: x >= 0), None),
    "duration": Parameter(number("more than 0 seconds", lambda x: x > 0), None),
    "rho": Parameter(number("a probability from 0 to 1", lambda x: 0 <= x <= 1), 0.8),
    "spread": Parameter(one_of("turned", "all", "sampled"), "turned"),
    "edge": Parameter(one_of("uniform", "exit"), "uniform"),
}
_RESULTS = {
    "step": ("duration of a step", "s"),
    "persistent_groups": ("number of persistent groups", "1"),
    "persistent_cells": ("cells of persistent groups", "1"),
    "transient_groups": ("number of transient groups", "1"),
    "mean_hours": ("mean expected time to a persistent group, of cells that surely arrive", "h"),
    "longest_hours": ("longest expected time to a persistent group, of such cells", "h"),
}


def drift(batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int) -> xr.Dataset:
    """The persistent groups of one layer of an ocean current, and how soon drifters are in them.

    Parameters: the options `file`, `time`, `duration`, `rho`, `spread` and `edge` of `jaxcell
    drift`, and `depth` in metres, by default the first layer of the file. Nothing is random.
    """
    return dataset(
        _RESULTS, [_row(member) for member in members("drift", PARAMETERS, batch, fixed)]
    )


@functools.lru_cache(maxsize=8)
def _layer(file: str, time: int | str | None, depth: float | None) -> Any:
    from ...drift import Flow, Water, open_currents

    currents = open_currents(file, time=time, depths=None if depth is None else (depth,))
    return Water.of(currents, 0), Flow.of(currents, 0).mean()


def _row(member: dict[str, Any]) -> tuple[float | int, ...]:
    from ...drift import crossing_time, drift_map, long_term_behaviour

    water, flow = _layer(member["file"], member["time"], member["depth"])
    duration = member["duration"]
    if duration is None:
        duration = crossing_time(water, flow)
    chain = drift_map(
        water,
        flow,
        duration,
        rho=member["rho"],
        spread=member["spread"],
        edge=member["edge"],
    )
    found = long_term_behaviour(chain, duration)
    hours = np.asarray(found.hours)
    hours = hours[np.isfinite(hours)]
    return (
        float(duration),
        int(found.groups.count),
        int((np.asarray(found.groups.group) >= 0).sum()),
        int(found.transient.count),
        float(hours.mean()) if hours.size else math.nan,
        float(hours.max()) if hours.size else math.nan,
    )
