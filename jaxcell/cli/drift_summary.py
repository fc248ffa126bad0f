"""What a person or a script wants to know of drifters."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from .terminal import note, table


if TYPE_CHECKING:
    from ..drift import Voyage
    from ..record import SeaDrift


_MOST_LISTED = 20
_REMEDIES = {"duration": "a longer --duration", "spread": "--spread sampled"}


def describe(drift: "SeaDrift", counts: dict[str, Any] | None, spread: str) -> dict[str, Any]:
    """The numbers of a sea.

    **Arguments:**

    - `drift`: what was found.
    - `counts`: the numbers of persistent groups for other steps, if there are any.
    - `spread`: that of the maps.
    """
    currents = drift.currents
    times = np.datetime_as_string(currents.time.values, unit="s").tolist()
    found = drift.deployment
    return {
        "east_from": currents.attrs["east_from"],
        "north_from": currents.attrs["north_from"],
        "notes": currents.attrs["notes"].splitlines(),
        "records": times,
        "layers": [_layer(drift, layer, spread) for layer in range(len(drift.waters))],
        "sensitivity": counts,
        "deployment": [
            {
                "lon": lon,
                "lat": lat,
                "group": group if group >= 0 else None,
                "transient_group": transient if transient >= 0 else None,
            }
            for (lon, lat, _), group, transient in zip(
                drift.places(found.cells),
                found.group.tolist(),
                found.transient_group.tolist(),
                strict=True,
            )
        ],
        "minimum_deployment": [[lon, lat] for lon, lat, _ in drift.places(drift.minimum)],
        "coverage_curve": None if drift.curve is None else drift.curve.covered.tolist(),
        "visibility": _visibility(drift),
        "reach": _reach(drift),
        "voyage": _voyage(drift),
    }


def _layer(drift: "SeaDrift", layer: int, spread: str) -> dict[str, Any]:
    from ..certificate import Outcome

    water, behaviour = drift.waters[layer], drift.behaviours[layer]
    diagnosis, transient = drift.diagnoses[layer], behaviour.transient
    hours = np.asarray(behaviour.hours)
    group, basin = np.asarray(behaviour.groups.group), np.asarray(behaviour.basin)
    leads = np.bincount(basin[(basin >= 0) & (group < 0)], minlength=behaviour.groups.count)
    _, first = np.unique(group[group >= 0], return_index=True)
    smallest = np.flatnonzero(group >= 0)[first]
    size = np.asarray(transient.size)
    transient_hours = hours[group < 0] if (group < 0).any() else np.zeros(1)
    return {
        "depth_m": water.depth,
        "cells": water.cells,
        "pieces": diagnosis.pieces.tolist(),
        "mean_shift_cells": diagnosis.mean_shift,
        "self_image_share": diagnosis.self_image,
        "warning": diagnosis.warning,
        "remedies": [_REMEDIES[name] for name in diagnosis.remedies(spread)],
        "persistent_groups": [
            {
                "cells": int(count),
                "single_domicile_cells": int(leads[number]),
                "lon": float(water.lon[water.row[cell], water.column[cell]]),
                "lat": float(water.lat[water.row[cell], water.column[cell]]),
            }
            for number, (count, cell) in enumerate(
                zip(np.asarray(behaviour.groups.size), smallest.tolist(), strict=True)
            )
        ],
        "transient_groups": [
            {
                "domiciles": list(homes),
                "cells": int(count),
                "mean_hours": _finite(hours[part].mean()),
                "longest_hours": _finite(hours[part].max()),
            }
            for homes, count, part in zip(
                transient.domiciles, size, _parts(drift, layer), strict=True
            )
        ],
        "single_domicile_cells": int(size[transient.single].sum()),
        "multiple_domicile_cells": int(size[~transient.single].sum()),
        "median_hours": _finite(float(np.median(transient_hours))),
        "mean_hours": _finite(transient_hours.mean()),
        "longest_hours": _finite(transient_hours.max()),
        "times_certified": behaviour.absorption.certificate.outcome is Outcome.CONVERGED,
        "almost_for_ever_cells": int(drift.almost_for_ever(layer).sum()),
        "leaving": _finite(drift.leaving(layer).mean()),
    }


def _parts(drift: "SeaDrift", layer: int) -> list[np.ndarray]:
    """The cells of each transient group."""
    transient = drift.behaviours[layer].transient
    part = np.asarray(transient.group)
    order = np.argsort(part, kind="stable")[int((part < 0).sum()) :]
    return np.split(order, np.cumsum(np.asarray(transient.size))[:-1]) if transient.count else []


def _visibility(drift: "SeaDrift") -> dict[str, Any] | None:
    if drift.views is None:
        return None
    return {
        "places": drift.views.cover.size,
        "drifters": [[lon, lat] for lon, lat, _ in drift.places(drift.views.cells)],
    }


def _reach(drift: "SeaDrift") -> list[dict[str, Any]] | None:
    if drift.reached is None:
        return None
    keeping, changing = drift.reached
    return [
        {
            "depth_m": depth,
            "cells": drift.waters[layer].cells,
            "at_its_depth": int(drift.of_layer(keeping, layer).sum()),
            "at_any_depth": int(drift.of_layer(changing, layer).sum()),
        }
        for layer, depth in enumerate(drift.depths)
    ]


def _voyage(drift: "SeaDrift") -> dict[str, Any] | None:
    if drift.voyage is None or drift.surest is None:
        return None
    ways = {"discounted": drift.voyage, "surest": drift.surest}
    lon, lat, depth = drift.place(int(np.flatnonzero(drift.voyage.goal)[0]))
    start = None
    if drift.start is not None:
        start = {name: _from(drift, way, drift.start) for name, way in ways.items()}
    return {
        "goal": [lon, lat, depth],
        "iterations": drift.voyage.certificate.iterations,
        "value_error": drift.voyage.certificate.residual,
        "from_start": start,
        "overall": {name: _overall(drift, way) for name, way in ways.items()},
    }


def _from(drift: "SeaDrift", way: "Voyage", cell: int) -> dict[str, Any]:
    hours = drift.duration / 3600
    return {
        "probability": float(way.probability[cell]),
        "hours": _finite(float(way.time[cell]) * hours),
        "hours_if_it_arrives": _finite(float(way.conditional_time[cell]) * hours),
    }


def _overall(drift: "SeaDrift", way: "Voyage") -> dict[str, Any]:
    from ..certificate import Outcome

    hours = drift.duration / 3600
    probability, time = np.asarray(way.probability), np.asarray(way.time) * hours
    sure = probability == 1
    return {
        "mean_probability": float(probability.mean()),
        "cells_that_arrive_for_sure": int(sure.sum()),
        "their_mean_hours": _finite(time[sure].mean()),
        "cells": probability.size,
        "policy_certified": way.certificate.outcome is Outcome.CONVERGED,
        "times_certified": way.arrival.outcome is Outcome.CONVERGED,
    }


def show(summary: dict[str, Any]) -> None:
    """Prints what becomes of drifters, for people."""
    _show_currents(summary)
    _show_layers(summary)
    _show_groups(summary)
    _show_sensitivity(summary)
    _show_deployment(summary)
    _show_reach(summary)
    _show_voyage(summary)
    for layer in summary["layers"]:
        if layer["warning"]:
            told = f"At {layer['depth_m']:g} m: {layer['warning']}"
            if layer["remedies"]:
                told += f"; take {' or '.join(layer['remedies'])}"
            note(f"{told}.")
        if layer["almost_for_ever_cells"]:
            note(
                f"At {layer['depth_m']:g} m: from {layer['almost_for_ever_cells']:,} transient "
                "cells it takes almost for ever; what holds drifters there is as good as a "
                "persistent group."
            )


def _show_currents(summary: dict[str, Any]) -> None:
    times = [one.replace("T", " ") for one in summary["records"]]
    when = times[0] if len(times) == 1 else f"mean of {len(times)}, {times[0]} to {times[-1]}"
    rows = [
        ("towards the East", summary["east_from"]),
        ("towards the North", summary["north_from"]),
        *(("note", text) for text in summary["notes"]),
        ("records", when),
        ("a step", f"{summary['duration_s'] / 3600:.4g} h"),
        *([] if summary["spread"] == "sampled" else [("rho", f"{summary['rho']:g}")]),
        ("spread, edge", f"{summary['spread']}, {summary['edge']}"),
        ("seconds", f"{summary['seconds']:g}"),
    ]
    table(summary["file"], ("the current", ""), rows)


def _show_layers(summary: dict[str, Any]) -> None:
    columns = ("", *(f"{layer['depth_m']:g} m" for layer in summary["layers"]))
    lines = {
        "cells of water": lambda one: one["cells"],
        "connected pieces": lambda one: len(one["pieces"]),
        "mean drift in a step, in cells": lambda one: f"{one['mean_shift_cells']:.2f}",
        "cells that are mapped to themselves": lambda one: f"{one['self_image_share']:.1%}",
        "persistent groups": lambda one: len(one["persistent_groups"]),
        "their cells": lambda one: sum(group["cells"] for group in one["persistent_groups"]),
        "transient cells with one end": lambda one: one["single_domicile_cells"],
        "transient cells with several": lambda one: one["multiple_domicile_cells"],
        "hours to the end, transient cells, mean": lambda one: _hours(one["mean_hours"]),
        "... median": lambda one: _hours(one["median_hours"]),
        "... longest": lambda one: _hours(one["longest_hours"]),
        "chance to leave the map": lambda one: _percent(one["leaving"]),
    }
    rows = [(name, *(of(layer) for layer in summary["layers"])) for name, of in lines.items()]
    table("Where drifters end up", columns, rows)


def _show_groups(summary: dict[str, Any]) -> None:
    rows: list[tuple[object, ...]] = []
    total = 0
    for layer in summary["layers"]:
        groups = list(enumerate(layer["persistent_groups"]))
        total += len(groups)
        groups.sort(key=lambda one: -one[1]["cells"] - one[1]["single_domicile_cells"])
        for number, group in groups:
            if len(rows) < _MOST_LISTED:
                rows.append(
                    (
                        f"{layer['depth_m']:g} m",
                        number,
                        group["cells"],
                        group["single_domicile_cells"],
                        f"{group['lon']:.3f}, {group['lat']:.3f}",
                    )
                )
    if rows:
        more = f", the first {len(rows)} of {total:,}" if total > len(rows) else ""
        columns = ("depth", "group", "cells", "others that lead there for sure", "lon, lat")
        table(f"Persistent groups{more}", columns, rows)


def _show_sensitivity(summary: dict[str, Any]) -> None:
    counts = summary["sensitivity"]
    if counts is None:
        return
    rows = [
        (f"{duration / 3600:.3g}", *found)
        for duration, found in zip(counts["durations_s"], counts["groups"], strict=True)
    ]
    columns = ("step in hours", *(f"rho {rho:g}" for rho in counts["rhos"]))
    table("Persistent groups at the surface, by other steps", columns, rows)


def _show_deployment(summary: dict[str, Any]) -> None:
    found, views = summary["deployment"], summary["visibility"]
    rows: list[tuple[object, ...]] = [
        ("drifters that cover every group", len(found)),
        ("fewest from which each cell may be visited", len(summary["minimum_deployment"])),
    ]
    if views is not None:
        rows.append(("places from which the sea bed is seen", views["places"]))
        rows.append(("drifters that get to all of them", len(views["drifters"])))
    table("Deployment at the surface", ("quantity", "number"), rows)
    listed = [
        (
            number + 1,
            f"{one['lon']:.3f}, {one['lat']:.3f}",
            f"transient {one['transient_group']}"
            if one["group"] is None
            else f"persistent {one['group']}",
        )
        for number, one in enumerate(found[:_MOST_LISTED])
    ]
    more = f", the first {_MOST_LISTED}" if len(found) > _MOST_LISTED else ""
    table(f"Where to drop drifters{more}", ("drifter", "lon, lat", "group"), listed)


def _show_reach(summary: dict[str, Any]) -> None:
    if summary["reach"] is None:
        return
    rows = [
        (f"{one['depth_m']:g} m", one["at_its_depth"], one["at_any_depth"], one["cells"])
        for one in summary["reach"]
    ]
    columns = ("depth", "cells, if it keeps its depth", "if it goes up and down", "of")
    table(f"Reached from {summary['start']}", columns, rows)


def _show_voyage(summary: dict[str, Any]) -> None:
    voyage = summary["voyage"]
    if voyage is None:
        return
    rows: list[tuple[object, ...]] = []
    if voyage["from_start"] is not None:
        start = [voyage["from_start"][name] for name in ("discounted", "surest")]
        rows += [
            ("chance to arrive from the start", *(f"{one['probability']:.6g}" for one in start)),
            ("hours that it takes", *(_hours(one["hours"], "may fail") for one in start)),
            (
                "hours, if it arrives",
                *(_hours(one["hours_if_it_arrives"], "cannot") for one in start),
            ),
        ]
    overall = [voyage["overall"][name] for name in ("discounted", "surest")]
    rows += [
        ("mean chance from all cells", *(f"{one['mean_probability']:.6g}" for one in overall)),
        (
            "cells that arrive for sure",
            *(f"{one['cells_that_arrive_for_sure']:,} of {one['cells']:,}" for one in overall),
        ),
        ("their mean hours", *(_hours(one["their_mean_hours"]) for one in overall)),
        ("sweeps of value iteration", f"{voyage['iterations']:,}", ""),
        ("bound of the error of a value", f"{voyage['value_error']:.1e}", ""),
        ("policy is certified", *(_yes(one["policy_certified"]) for one in overall)),
        ("all times are certified", *(_yes(one["times_certified"]) for one in overall)),
    ]
    title = f"To the goal {summary['goal']}"
    table(title, ("quantity", f"discount {summary['discount']:g}", "surest"), rows)
    if not all(one["policy_certified"] and one["times_certified"] for one in overall):
        note(
            "What is not certified is beyond 64-bit numbers somewhere: an eddy holds drifters "
            "almost for ever. It may be right elsewhere; --duration takes another step."
        )


def _hours(hours: float | None, otherwise: str = "for ever") -> str:
    return otherwise if hours is None else f"{hours:.4g}"


def _yes(certified: bool) -> str:
    return "yes" if certified else "no"


def _percent(share: float | None) -> str:
    return "not known" if share is None else f"{share:.1%}"


def _finite(number: float) -> float | None:
    return float(number) if math.isfinite(number) else None
