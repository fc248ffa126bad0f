"""Where drifters end up: persistent groups, those that lead to them, and how long it takes."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int, UInt8

from ..drift import LongTermBehaviour
from .blueprint import log_classes, log_text
from .canvas.palette import CATEGORIES, CLEAR, FREE, PLAIN, TEXT, Color, PictureClass, mix, ramp
from .drift_text import absorption_text, groups_text
from .sea_drift import ALMOST_FOR_EVER
from .sea_map import LAND, SeaMap, log_legend, tab


HOMES = {name: CATEGORIES[name] for name in ("orange", "sky blue", "green", "blue", "vermilion")}
"""The colours of persistent groups, the largest basin first."""
SEVERAL: Color = FREE
"""Where drifters may end in several ways."""
AWAY: Color = mix(CATEGORIES["yellow"], FREE, 0.3)
"""Where drifters leave the map for sure."""
DRIFTER: Color = (20, 20, 24)
_OTHERS: Color = (96, 82, 72)
_LATE: Color = mix(PLAIN, (0, 0, 0), 0.4)
_PALE = 0.6
# Pictures have at most 255 classes; so many transient groups have one of their own.
_MOST_CLASSES = 120
# Smaller parts of the map would lie hidden under their labels.
_LEAST_LABELLED = 100
_LEVELS = 32
_LEGEND_ROWS = 7


def basin_rank(behaviour: LongTermBehaviour) -> Int[np.ndarray, "groups"]:
    """The rank of each persistent group by the cells that lead to it for sure, its own included."""
    basin = np.asarray(behaviour.basin)
    size = np.bincount(basin[basin >= 0], minlength=behaviour.groups.count)
    rank = np.empty(size.size, np.int64)
    rank[np.argsort(-size, kind="stable")] = np.arange(size.size)
    return rank


def home_color(rank: int) -> Color:
    """The colour of a persistent group."""
    colors = list(HOMES.values())
    return colors[rank] if rank < len(colors) else _OTHERS


def group_classes(
    behaviour: LongTermBehaviour,
) -> tuple[UInt8[np.ndarray, "cells"], list[PictureClass]]:
    """The class of each cell in a picture of groups, and what the classes mean; 0 is land.

    A cell of a persistent group has its colour, one that leads there for sure a paler shade.
    """
    rank = basin_rank(behaviour)
    classes = [PictureClass("land", CLEAR)]
    groups = min(behaviour.groups.count, _MOST_CLASSES)
    shown = np.argsort(rank)[:groups]
    of_group = np.full(behaviour.groups.count, 1 + groups)
    for group in shown.tolist():
        of_group[group] = len(classes)
        classes.append(PictureClass(f"persistent group {group}", home_color(int(rank[group]))))
    classes.append(PictureClass("a smaller persistent group", _OTHERS))
    transient = behaviour.transient
    order = np.argsort(-np.asarray(transient.size), kind="stable")[:_MOST_CLASSES]
    of_transient = np.full(transient.count, len(classes) + order.size)
    for number in order.tolist():
        of_transient[number] = len(classes)
        classes.append(_transient_class(transient.domiciles[number], rank))
    classes.append(PictureClass("transient", SEVERAL))
    group, part = np.asarray(behaviour.groups.group), np.asarray(transient.group)
    kind = np.where(
        group >= 0,
        np.append(of_group, 0)[group],
        np.append(of_transient, 0)[part],
    )
    return kind.astype(np.uint8), classes


def _transient_class(homes: tuple[int, ...], rank: Int[np.ndarray, "groups"]) -> PictureClass:
    if len(homes) == 1:
        (home,) = homes
        if home < 0:
            return PictureClass("leaves the map for sure", AWAY)
        color = mix(home_color(int(rank[home])), FREE, _PALE)
        return PictureClass(f"ends in group {home} for sure", color)
    named = ["off the map" if home < 0 else str(home) for home in homes[:8]]
    more = ", ..." if len(homes) > 8 else ""
    return PictureClass(f"may end in groups {', '.join(named)}{more}", SEVERAL)


def log_groups(stream: rr.RecordingStream, sea: SeaMap, spec: Mapping[str, Any]) -> rrb.Container:
    """Logs the groups of each layer."""
    drift = sea.drift
    views = []
    for layer in sea.layers:
        behaviour = drift.behaviours[layer]
        kind, classes = group_classes(behaviour)
        path = f"map/grid/groups_{layer}"
        log_classes(stream, path, classes)
        stream.log(path, sea.picture(layer, kind), static=True)
        count = behaviour.groups.count
        name = f"{sea.depth(layer)}: {count:,} persistent {'group' if count == 1 else 'groups'}"
        _log_numbers(stream, sea, layer)
        shown = [f"grid/water_{layer}", f"grid/groups_{layer}", f"numbers_{layer}"]
        shown.append(f"drifters_{layer}/here")
        views.append(sea.view(name, shown))
    entries = _group_legend(sea)
    log_legend(stream, sea, "groups/legend", entries)
    log_text(stream, "groups/text", groups_text(sea, spec))
    return tab("Groups", views, "groups", len(entries))


def _log_numbers(stream: rr.RecordingStream, sea: SeaMap, layer: int) -> None:
    """Logs the numbers of groups that have a colour of their own and are not tiny, over them."""
    behaviour = sea.drift.behaviours[layer]
    group, size = np.asarray(behaviour.groups.group), np.asarray(behaviour.groups.size)
    shown = np.argsort(basin_rank(behaviour))[: len(HOMES)]
    shown = shown[size[shown] * _LEAST_LABELLED >= group.size]
    if not shown.size:
        return
    centres = sea.centres(layer)
    middle = [np.median(centres[group == number], axis=0) for number in shown.tolist()]
    text = rr.Points2D(
        middle,
        labels=[f"group {number}" for number in shown.tolist()],
        colors=TEXT,
        radii=0.001,
        show_labels=True,
        draw_order=60,
    )
    stream.log(f"map/numbers_{layer}", text, static=True)


def _group_legend(sea: SeaMap) -> list[tuple[str, Color]]:
    behaviours = [sea.drift.behaviours[layer] for layer in sea.layers]
    most = max(one.groups.count for one in behaviours)
    ends = {homes for one in behaviours for homes in one.transient.domiciles}
    entries: list[tuple[str, Color]] = []
    ordinals = ("largest", "second", "third", "fourth", "fifth")
    for ordinal, color in zip(ordinals[:most], HOMES.values(), strict=False):
        entries.append((f"group of the {ordinal} basin", color))
        entries.append(("... leads there for sure", mix(color, FREE, _PALE)))
    if most > len(HOMES):
        entries.append(("another persistent group", _OTHERS))
        entries.append(("... leads there for sure", mix(_OTHERS, FREE, _PALE)))
    if any(len(homes) > 1 for homes in ends):
        entries.append(("may end in several", SEVERAL))
    if (-1,) in ends:
        entries.append(("leaves the map for sure", AWAY))
    return [*entries, ("land", LAND), ("a drifter", DRIFTER)]


def log_absorption(stream: rr.RecordingStream, sea: SeaMap) -> rrb.Container:
    """Logs how long it takes until drifters are in a persistent group, layer by layer."""
    hours = [np.asarray(sea.drift.behaviours[layer].hours) for layer in sea.layers]
    late = [sea.drift.almost_for_ever(layer) for layer in sea.layers]
    told = np.concatenate([one[(one > 0) & ~two] for one, two in zip(hours, late, strict=True)])
    # A few that take very long would leave one colour for all others.
    most = min(float(told.max()), 3 * float(np.quantile(told, 0.9))) if told.size else 1.0
    classes, bounds = _hour_classes(most)
    views = []
    for layer in sea.layers:
        path = f"map/grid/absorption_{layer}"
        kind = _hour_class(hours[layer], bounds)
        kind[late[layer]] = len(classes) - 1
        log_classes(stream, path, classes)
        stream.log(path, sea.picture(layer, kind), static=True)
        views.append(
            sea.view(sea.depth(layer), [f"grid/water_{layer}", f"grid/absorption_{layer}"])
        )
    entries = _hour_legend(classes, bounds)
    if not any(one.any() for one in late):
        entries.pop()
    entries.append(("land", LAND))
    log_legend(stream, sea, "absorption/legend", entries)
    log_text(stream, "absorption/text", absorption_text(sea))
    return tab("Absorption times", views, "absorption", len(entries))


def _hour_classes(most: float) -> tuple[list[PictureClass], Float[np.ndarray, "bounds"]]:
    """The classes of times as far as a longest one; the last two are for longer ones."""
    bounds = np.linspace(0, most, _LEVELS + 1)
    classes = [PictureClass("land", CLEAR), PictureClass("in a persistent group", FREE)]
    colors = ramp(np.linspace(0, 1, _LEVELS)).tolist()
    for low, high, (red, green, blue) in zip(bounds, bounds[1:], colors, strict=False):
        classes.append(PictureClass(f"{low:.3g} to {high:.3g} h", (red, green, blue)))
    classes[-1] = PictureClass(f"{bounds[-2]:.3g} h or more", classes[-1].color)
    classes.append(PictureClass(f"almost for ever: over {ALMOST_FOR_EVER:,} steps", _LATE))
    return classes, bounds


def _hour_class(
    hours: Float[np.ndarray, "cells"], bounds: Float[np.ndarray, "bounds"]
) -> UInt8[np.ndarray, "cells"]:
    level = np.clip(np.searchsorted(bounds, hours, side="right"), 1, _LEVELS)
    return np.where(hours > 0, 1 + level, 1).astype(np.uint8)


def _hour_legend(
    classes: Sequence[PictureClass], bounds: Float[np.ndarray, "bounds"]
) -> list[tuple[str, Color]]:
    shown = np.linspace(_LEVELS, 0, _LEGEND_ROWS).round().astype(int).tolist()
    entries = [(f"{bounds[at]:.3g} h", classes[2 + min(at, _LEVELS - 1)].color) for at in shown]
    entries[0] = (f"{entries[0][0]} or more", entries[0][1])
    return entries + [(one.label, one.color) for one in (classes[1], classes[-1])]
