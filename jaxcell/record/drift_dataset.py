from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from ..drift import Voyage
from .chain_checks import drift_checks
from .checks import with_checks
from .provenance import provenance
from .sea_drift import SeaDrift


_SQUARES = ("layer", "y", "x")
_LAND = -2
_ONE = {"units": "1"}
_HOURS = {"units": "hour"}


def drift_dataset(drift: SeaDrift, *, spec: Mapping[str, Any] | None = None) -> xr.Dataset:
    """The long-term behaviour of drifters as a labelled dataset, with the conventions of CF.

    Over `layer`, `y` and `x`, the squares of the grid: `cell`, the number of a cell among those of
    all layers; `group`, its persistent group; `transient_group`; `basin`, the group in which a
    drifter ends up for sure; `absorption_time`; and `leaving`, the probability of ending off the
    grid. With `group_index` before them: `probability`, that of ending in each group of the layer.
    Over `transient`, the transient groups of all layers: their layer and number; the domiciles of
    the `i`-th are `domicile[domicile_offset[i]:domicile_offset[i + 1]]`.

    Over `entry`, the chain of all layers: from cell `from_cell` a drifter is in `to_cell` one step
    later with probability `transition`; what they lack of 1 has left the grid.

    Over `drifter`: the deployment, `deployment_cell` with its place, group and transient group; the
    fewest cells from which all may be visited are `minimum_cell`. If drifters look at the sea bed,
    over `view`: `view_cell`, and whether it is `view_kept`. If there is a start: `reached`, by
    drifters that keep their depth, and `reached_at_any_depth`. If there is a goal: `action`,
    `value`, `arrival_probability`, `arrival_time`, and those of the surest voyage.

    Numbers are -2 where there is no water, and times and probabilities are NaN there.

    **Arguments:**

    - `drift`: what was found.
    - `spec`: what was asked for, kept as JSON in the attribute `spec`.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    **Raises:** `ValueError` if `spec` is not JSON; `RuntimeError` if the result contradicts itself.

    The surface of the bundled sea at its first record:

        >>> from jaxcell import drift, record
        >>> from jaxcell.bundled import bundled
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> water, flow = drift.Water.of(currents), drift.Flow.of(currents)
        >>> chain, duration = drift.drift_map(water, flow), drift.crossing_time(water, flow)
        >>> behaviour = drift.long_term_behaviour(chain, duration)
        >>> diagnosis = drift.diagnose(water, flow, behaviour.groups)
        >>> deployment, minimum = drift.deployment_cells(behaviour), drift.minimum_deployment(chain)
        >>> found = record.SeaDrift(currents, (behaviour,), (diagnosis,), deployment, minimum)
        >>> dataset = record.drift_dataset(found)
        >>> dict(dataset.group.sizes), dataset.minimum_cell.size == len(found.minimum)
        ({'layer': 1, 'y': 21, 'x': 29}, True)
    """
    currents = drift.currents
    coords = {name: currents[name].drop_encoding() for name in ("lon", "lat", "depth")}
    dataset = xr.Dataset(
        {
            **_behaviour(drift),
            **_domiciles(drift),
            **_chain(drift),
            **_deployment(drift),
            **_reached(drift),
            **_voyages(drift),
        },
        coords=coords,
        attrs={
            **provenance("Long-term behaviour of drifters in an ocean current", None, spec),
            "Conventions": "CF-1.8",
            "source": f"jaxcell; definitions of Alam 2018, chapter 5; currents of "
            f"{currents.attrs['source']}",
            "step_seconds": drift.duration,
        },
    )
    return with_checks(dataset, drift_checks(dataset))


def _behaviour(drift: SeaDrift) -> dict[str, tuple[Any, ...]]:
    land = {"padding": f"{_LAND}: no water"}
    kinds: dict[str, list[np.ndarray]] = {"group": [], "transient_group": [], "basin": []}
    hours, leaving, probability = [], [], []
    told = [found.value.shape[0] for found in drift.ends if found is not None]
    most = max(told, default=0)
    for layer, (water, behaviour) in enumerate(zip(drift.waters, drift.behaviours, strict=True)):
        for name, values in (
            ("group", behaviour.groups.group),
            ("transient_group", behaviour.transient.group),
            ("basin", behaviour.basin),
        ):
            kinds[name].append(water.on_grid(np.asarray(values), _LAND))
        hours.append(water.on_grid(np.asarray(behaviour.hours)))
        ends = np.full((most, *water.number.shape), np.nan)
        if (found := drift.ends[layer]) is not None:
            for group, row in enumerate(np.asarray(found.value)):
                ends[group] = water.on_grid(row)
        probability.append(ends)
        leaving.append(water.on_grid(drift.leaving(layer)))
    cell = np.full((len(drift.waters), *drift.waters[0].number.shape), _LAND, np.int32)
    cell[drift.squares] = np.arange(drift.sea.cells)
    variables: dict[str, tuple[Any, ...]] = {
        "cell": (_SQUARES, cell, {"long_name": "number of the cell", **land}),
        "group": (
            _SQUARES,
            np.stack(kinds["group"]),
            {"long_name": "persistent group, -1 if transient", **land},
        ),
        "transient_group": (
            _SQUARES,
            np.stack(kinds["transient_group"]),
            {"long_name": "transient group, -1 if persistent", **land},
        ),
        "basin": (
            _SQUARES,
            np.stack(kinds["basin"]),
            {"long_name": "group in which a drifter ends for sure, -1 if there is none", **land},
        ),
        "absorption_time": (
            _SQUARES,
            np.stack(hours),
            {"long_name": "expected time until a drifter is in a group or off the grid", **_HOURS},
        ),
        "mean_shift": (
            "layer",
            np.array([one.mean_shift for one in drift.diagnoses]),
            {"long_name": "mean drift of the centres in one step, in cells", **_ONE},
        ),
    }
    chance = {"padding": "NaN: no such group, no water, or not known", **_ONE}
    variables["leaving"] = (
        _SQUARES,
        np.stack(leaving),
        {"long_name": "probability of ending off the grid", **chance},
    )
    if told:
        variables["probability"] = (
            ("layer", "group_index", "y", "x"),
            np.stack(probability),
            {"long_name": "probability of ending in the group", **chance},
        )
    return variables


def _domiciles(drift: SeaDrift) -> dict[str, tuple[Any, ...]]:
    """The transient groups of all layers, layer after layer."""
    homes = [one.transient.domiciles for one in drift.behaviours]
    layer = np.repeat(np.arange(len(homes), dtype=np.int32), [len(some) for some in homes])
    number = np.concatenate([np.arange(len(some), dtype=np.int32) for some in homes])
    flat = [one for some in homes for one in some]
    offset = np.cumsum([0, *(len(one) for one in flat)], dtype=np.int64)
    listed = np.array([home for one in flat for home in one], np.int32)
    where = {"long_name": "where a transient group begins in domicile"}
    what = {"long_name": "persistent groups that it may end in, -1 for off the grid"}
    return {
        "transient_layer": ("transient", layer, {"long_name": "layer of a transient group"}),
        "transient_number": ("transient", number, {"long_name": "its number in transient_group"}),
        "domicile_offset": ("transient_bound", offset, where),
        "domicile": ("domicile_entry", listed, what),
    }


def _chain(drift: SeaDrift) -> dict[str, tuple[Any, ...]]:
    entries = drift.sea.drift.to_scipy().tocoo()
    return {
        "from_cell": ("entry", entries.row.astype(np.int32), {"long_name": "cell"}),
        "to_cell": ("entry", entries.col.astype(np.int32), {"long_name": "cell one step later"}),
        "transition": ("entry", entries.data, {"long_name": "probability", **_ONE}),
    }


def _deployment(drift: SeaDrift) -> dict[str, tuple[Any, ...]]:
    found, water = drift.deployment, drift.waters[0]
    here = water.row[found.cells], water.column[found.cells]
    east = {"standard_name": "longitude", "units": "degrees_east"}
    north = {"standard_name": "latitude", "units": "degrees_north"}
    gained = {"long_name": "cells of its group that are reached first from it"}
    variables: dict[str, tuple[Any, ...]] = {
        "deployment_cell": ("drifter", found.cells, {"long_name": "cell to drop a drifter in"}),
        "deployment_lon": ("drifter", water.lon[here], east),
        "deployment_lat": ("drifter", water.lat[here], north),
        "deployment_group": ("drifter", found.group, {"long_name": "-1 if transient"}),
        "deployment_transient_group": (
            "drifter",
            found.transient_group,
            {"long_name": "-1 if persistent"},
        ),
        "deployment_gained": ("drifter", found.gained, gained),
        "minimum_cell": ("fewest", drift.minimum, {"long_name": "of the smallest deployment"}),
    }
    if drift.curve is not None:
        best = {"long_name": "cell to drop the first, second, ... drifter in"}
        covered = {"long_name": "cells that may be visited from these and those before"}
        variables["curve_cell"] = ("drifters", drift.curve.cells, best)
        variables["curve_covered"] = ("drifters", drift.curve.covered, covered)
    if drift.views is not None:
        kept = np.isin(drift.views.cover, drift.views.cells)
        seen = {"long_name": "cell from which the sea bed is seen", "reach_m": drift.reach}
        needed = {"long_name": "whether a drifter is dropped there"}
        variables["view_cell"] = ("view", drift.views.cover, seen)
        variables["view_kept"] = ("view", kept, needed)
    return variables


def _on_squares(drift: SeaDrift, values: Any, fill: float | int) -> np.ndarray:
    """Values of the cells of all layers on the squares of the grid."""
    return np.stack(
        [
            water.on_grid(drift.of_layer(values, layer), fill)
            for layer, water in enumerate(drift.waters)
        ]
    )


def _reached(drift: SeaDrift) -> dict[str, tuple[Any, ...]]:
    if drift.reached is None:
        return {}
    keeping, changing = (_on_squares(drift, reached, False) for reached in drift.reached)
    return {
        "start": ((), drift.start, {"long_name": "cell where the drifter is dropped"}),
        "reached": (_SQUARES, keeping, {"long_name": "by drifters that keep their depth"}),
        "reached_at_any_depth": (_SQUARES, changing, {"long_name": "by going up and down too"}),
    }


def _voyages(drift: SeaDrift) -> dict[str, tuple[Any, ...]]:
    variables: dict[str, tuple[Any, ...]] = {}
    if drift.voyage is not None:
        goal = np.flatnonzero(drift.voyage.goal).astype(np.int32)
        variables["goal"] = ("goals", goal, {"long_name": "cells of the goal"})
        variables |= _voyage(drift, drift.voyage, "")
        value = {"long_name": "value function", **_ONE}
        if drift.voyage.value is not None:
            variables["value"] = (_SQUARES, _on_squares(drift, drift.voyage.value, np.nan), value)
    if drift.surest is not None:
        variables |= _voyage(drift, drift.surest, "surest_")
    return variables


def _voyage(drift: SeaDrift, voyage: Voyage, prefix: str) -> dict[str, tuple[Any, ...]]:
    hours = drift.duration / 3600
    what = {"long_name": "what a drifter does", "meaning": "-1: up, 0: drift, 1: down"}
    chance = {"long_name": "probability of arriving", **_ONE}
    time = {"long_name": "expected time to arrive; inf where it may fail", **_HOURS}
    if_so = {"long_name": "expected time to arrive, if it arrives", **_HOURS}
    return {
        f"{prefix}action": (
            _SQUARES,
            _on_squares(drift, voyage.action, _LAND),
            {**what, "padding": f"{_LAND}: no water"},
        ),
        f"{prefix}arrival_probability": (
            _SQUARES,
            _on_squares(drift, voyage.probability, np.nan),
            chance,
        ),
        f"{prefix}arrival_time": (
            _SQUARES,
            _on_squares(drift, np.asarray(voyage.time) * hours, np.nan),
            time,
        ),
        f"{prefix}conditional_arrival_time": (
            _SQUARES,
            _on_squares(drift, np.asarray(voyage.conditional_time) * hours, np.nan),
            if_so,
        ),
    }
