"""The maps of all layers, with steps of one duration."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr

from ...base import memory
from ...mapping import Chain, ChainSequence
from ...space import estimates
from ..drift_step import DriftStep
from ..flow import Flow, crossing_time
from ..validation.distance import Distance, nearest_maps, whole_days
from ..water import Water
from .current_layer import Layer
from .layer_ends import EndTotals


def choose_step(
    waters: Sequence[Water],
    flows: Sequence[Flow],
    by: Sequence[Flow],
    step: DriftStep,
    until: float | int | None,
    say: Callable[..., None],
) -> tuple[DriftStep, list[tuple[Chain | ChainSequence, Distance]] | None]:
    """Choose the step's duration; return the step, and each layer's map if it is known by then."""
    if step.duration is not None:
        return step.lasting(by[0].fitted(step.duration)), None
    if step.spread != "sampled":
        return step.lasting(by[0].fitted(max(map(crossing_time, waters, by)))), None
    say("choosing the duration of a step")
    return nearest_maps(waters, flows, by, step, until)


def map_layers(
    waters: Sequence[Water],
    flows: Sequence[Flow],
    by: Sequence[Flow],
    step: DriftStep,
    made: list[tuple[Chain | ChainSequence, Distance]] | None,
    start: int | None,
    until: float | int | None,
    say: Callable[..., None],
) -> tuple[Layer, ...]:
    """Map each layer, or use the maps in `made`; drifters are released in `start` of the first."""
    layers = [
        Layer.of(water, flows[k], step, by=by[k], made=made[k] if made else None, say=say)
        for k, water in enumerate(waters)
    ]
    if made is None:
        # Layers are compared at the same times.
        asked = whole_days(EndTotals(layers).transient_hours) if until is None else until
        layers = [dataclasses.replace(layer, asked=asked) for layer in layers]
    surface, *below = layers
    return dataclasses.replace(surface, release=start), *below


def notices_on(
    currents: xr.Dataset, by: Flow, step: DriftStep, chosen: DriftStep, backward: bool
) -> tuple[str, ...]:
    """Note the differences between the requested `step` and time, and those of the maps."""
    notices = []
    if backward:
        notices.append(
            "Time runs backward from the last record: drifters end where the drifters that are "
            "in their cells at the last record came from."
        )
    if (records := currents.attrs.get("mean_of", 1)) > 1:
        notices.append(
            f"Maps and simulated drifters are for the mean of {records} records: a steady "
            "current, which is not any of them."
        )
    if step.duration is not None and not np.isclose(chosen.duration or 0, step.duration):
        notices.append(
            f"A step takes {chosen.duration:g} s in place of {step.duration:g} s, to fit the "
            f"{float(by.period or 0) / 3600:g} h after which the current repeats."
        )
    return tuple(notices)


def check_size(waters: Sequence[Water], phases: int, most: int | None) -> None:
    """Refuse maps of all phases that exceed the free memory, or `most` cells times phases."""
    cells = [phases * water.cells for water in waters]
    doing = f"the current has {sum(cells):,} cells at its {phases} phases"
    less = (
        "choose smaller bounds or fewer depths, or map the mean of the records (--current mean, "
        "mean=True)"
    )
    memory.check(estimates.drift(cells), f"{doing}; that", less)
    if most is not None and sum(cells) > most:
        raise ValueError(
            f"{doing}, and above {most:,} they take minutes to hours; {less}, or "
            "ask for the changing current all the same (--current changing, mean=False)"
        )
