from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb
from jaxtyping import Int, UInt8

from ...base.formatting import in_time
from ...drift import Layer, SeaDrift
from ...drift.results.layer_ends import LayerEnds
from ..canvas.marks import log_labels
from ..canvas.palette import CATEGORIES, CLEAR, FREE, Color, PictureClass, mix, tint
from ..canvas.prose import Spec, counted, described, made_with
from .currents import currents_of
from .map import DRIFTER, SeaMap


HOMES = [CATEGORIES[name] for name in ("orange", "sky blue", "green", "blue", "vermilion")]
"""Colours of persistent groups by rank; the group of rank 0 has the largest basin in layer 0."""
_SEVERAL: Color = FREE
_AWAY: Color = tint(CATEGORIES["yellow"], 0.3)
_OTHERS: Color = (96, 82, 72)
_PALE = 0.6
# The largest number of groups with separate classes; pictures have at most 255 classes.
_MAX_CLASSES = 120
# The least share of the map for a group to get a label, because labels hide smaller groups.
_MIN_LABELLED = 0.01


def log_groups(maps: Sequence[SeaMap], text: str) -> rrb.Container:
    """Log a tab that shows persistent groups, and the cells that lead to them."""
    drift, views = maps[0].drift, []
    ranks = drift.group_ranks
    for map in maps:
        layer, number = drift.layers[map.number], map.number
        kind, classes = group_classes(layer, ranks[number])
        picture = map.picture(f"groups_{number}", classes, kind)
        # Each large group gets a label with its rank, if it has a colour of its own.
        shown = np.argsort(ranks[number])[: (ranks[number] < len(HOMES)).sum()]
        large = shown[layer.groups_cells[shown] >= _MIN_LABELLED * layer.cells].tolist()
        rank = {k: int(ranks[number][k]) for k in large}
        labels = [(f"group {rank[k]}", *map.middle(layer.group == k)) for k in large]
        grounds = [home_color(rank[k]) for k in large]
        log_labels(map.stream, f"map/numbers_{number}", labels, grounds)
        title = f"{map.title}: {counted(layer.persistent_groups, 'persistent group')}"
        if isinstance(layer, Layer):
            title += (
                f", {layer.distance:.2%} of drifters elsewhere after {in_time(layer.asked_hours)}"
            )
        views.append(map.view(title, [picture, f"numbers_{number}", f"drifters_{number}/here"]))
    legend = _legend(drift.layers, max(int(rank.max(initial=-1)) + 1 for rank in ranks))
    if isinstance(drift, SeaDrift):
        legend.append(("a drifter", DRIFTER))
    return maps[0].tab("groups", "Groups", views, text, legend)


def home_color(rank: int) -> Color:
    """Return the colour of a persistent group, by its rank."""
    return HOMES[rank] if rank < len(HOMES) else _OTHERS


def group_classes(
    layer: LayerEnds, rank: Int[np.ndarray, "groups"]
) -> tuple[UInt8[np.ndarray, "cells"], list[PictureClass]]:
    """Return the class of each cell in a picture of groups, and all classes; class 0 is land.

    A cell of a persistent group has the colour of the group; a cell that surely leads to the group
    has a paler shade.
    """
    transient = layer.begins.transient
    groups = np.argsort(rank)[:_MAX_CLASSES].tolist()
    parts = np.argsort(-np.asarray(transient.size), kind="stable")[:_MAX_CLASSES].tolist()
    classes = [
        PictureClass("land", CLEAR),
        *(PictureClass(f"persistent group {rank[k]}", home_color(int(rank[k]))) for k in groups),
        PictureClass("a smaller persistent group", _OTHERS),
        *(_transient_class(transient.domiciles[k], rank) for k in parts),
        PictureClass("transient", _SEVERAL),
    ]
    # The last entry of each array is for the cells of the other kind.
    of_group = np.full(rank.size + 1, 1 + len(groups))
    of_group[groups] = 1 + np.arange(len(groups))
    of_part = np.full(transient.count + 1, len(classes) - 1)
    of_part[parts] = 2 + len(groups) + np.arange(len(parts))
    part = of_part[np.asarray(transient.group)]
    return np.where(layer.transient, part, of_group[layer.group]).astype(np.uint8), classes


def _transient_class(homes: tuple[int, ...], rank: Int[np.ndarray, "groups"]) -> PictureClass:
    if homes == (-1,):
        return PictureClass("leaves the map for sure", _AWAY)
    if len(homes) == 1:
        color = mix(home_color(int(rank[homes[0]])), FREE, _PALE)
        return PictureClass(f"ends in group {rank[homes[0]]} for sure", color)
    named = ["off the map"] * (-1 in homes)
    named += [str(one) for one in sorted(int(rank[home]) for home in homes if home >= 0)[:8]]
    more = ", ..." if len(homes) > 8 else ""
    return PictureClass(f"may end in groups {', '.join(named)}{more}", _SEVERAL)


def _legend(layers: Sequence[LayerEnds], most: int) -> list[tuple[str, Color]]:
    ends = {homes for layer in layers for homes in layer.begins.transient.domiciles}
    named = [f"group {rank}" for rank in range(len(HOMES))]
    colors = dict(zip(named, HOMES, strict=True)) | {"another persistent group": _OTHERS}
    entries: list[tuple[str, Color]] = []
    for name, color in [*colors.items()][:most]:
        entries += [(name, color), ("... leads there for sure", tint(color, _PALE))]
    if any(len(homes) > 1 for homes in ends):
        entries.append(("may end in several", _SEVERAL))
    if (-1,) in ends:
        entries.append(("leaves the map for sure", _AWAY))
    return entries


GROUPS_SEEN = """Sooner or later a drifter is in a *persistent group* of cells, which it never
leaves, or off the map.

- **Full colours**: persistent groups.
- **Pale colours**: a drifter from there surely ends in the group of that colour.
- **White**: it may end in several groups. Hover over a cell to read in which."""


def groups_text(drift: SeaDrift, spec: Spec) -> str:
    """Compose the text of the tab that shows the groups of drifters in a current."""
    columns = "depth", "cells", "persistent_groups", "groups_cells"
    domiciles = "single_domicile_cells", "multiple_domicile_cells"
    ways = "mean_leaving_into_gaps", "mean_leaving_off_edge", "mean_stranding"
    distances = "asked_hours", "distance", "distance_noise", "release_distance"
    left = "release_distance_noise", "drifters_left", "map_left"
    hours = f"**{drift.step / 3600:.3g} hours**"
    current = "the mean current" if drift.phases is None else "the current, as it changes,"
    spread = "on points of its cell"
    if drift.layers[0].step.spread != "sampled":
        spread = "or to a cell beside that"
    warnings = [
        f"- **{layer.depth:g} m**: {layer.warning}." for layer in drift.layers if layer.warning
    ]
    beware = "\n".join(["## Beware", "", *warnings]) if warnings else ""
    return f"""# Where drifters end up

{GROUPS_SEEN}

{described(drift.layers, *columns, *domiciles)}

{described(drift.layers, "depth", "mean_leaving", *ways)}

{beware}

## How sure

Drifters that the current itself carries, without cells, are the **black dots**: press play. The
share that the map has in a wrong cell, released everywhere and released in one cell, and the shares
that left:

{described(drift.layers, "depth", *distances, *left)}

## The map

{currents_of(drift)} In a step of {hours} a drifter goes where {current} takes it, {spread}: a
*Markov chain*. {_phases(drift)}

{made_with(spec)}"""


def _phases(drift: SeaDrift) -> str:
    """Describe the period of the currents and the time of release; return "" without a period."""
    if drift.phases is None:
        return ""
    return (
        f"It repeats itself after {drift.period_hours:.3g} hours, of "
        f"{counted(drift.phases, 'step')}; drifters are released at the first record."
    )
