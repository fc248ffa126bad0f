import dataclasses

import numpy as np
from jaxtyping import Int, Integer, UInt8

from ..space import CellSpace
from .canvas.palette import (
    CATEGORIES,
    FREE,
    GROUP_CLASSES,
    OBSTACLE,
    ON_GROUP,
    LegendEntry,
    PictureClass,
    group_class,
    ramp,
    step_classes,
)
from .tables import GroupTable, HostGroups


CYCLE_CLASSES = [*GROUP_CLASSES, PictureClass("on no such group", FREE)]
_NO_GROUP = len(GROUP_CLASSES)
HEADING_ROW = len(CATEGORIES) + 2
LEGEND_ROWS = HEADING_ROW + 8


@dataclasses.dataclass(frozen=True, eq=False)
class GroupPictures:
    """The periodic groups of a map as pictures of classes, one for each direction.

    The first row of a picture is the lowest.
    """

    groups: UInt8[np.ndarray, "directions rows columns"]
    "The group that each cell leads to, in `GROUP_CLASSES`."
    steps: UInt8[np.ndarray, "directions rows columns"]
    "The mappings it takes."
    cycles: UInt8[np.ndarray, "directions rows columns"]
    "Where, in any direction, the groups run that are met in this one, in `CYCLE_CLASSES`."
    step_classes: list[PictureClass]
    "The classes of `steps`."
    legends: list[list[LegendEntry]]
    "What the colours mean, for each direction."


def on_squares(
    cells: CellSpace, kind: Integer[np.ndarray, "*pictures positions"]
) -> UInt8[np.ndarray, "*pictures rows columns"]:
    """Classes of positions as pictures, with 0 for what is not free; the first row is lowest."""
    pictures = np.zeros((*kind.shape[:-1], cells.free.size), np.uint8)
    pictures[..., cells.square] = kind
    return pictures.reshape(*kind.shape[:-1], *cells.free.shape)


def group_pictures(cells: CellSpace, groups: HostGroups, table: GroupTable) -> GroupPictures:
    """Draws the periodic groups of a map.

    Groups have ranks, and by these their colours, among those that are met in the same directions:
    a bounce by 90 of 360 degrees has 90 such families, and no picture shows two of them.
    """
    rank = _rank(table)
    kind = group_class(rank)[groups.group] + groups.periodic
    by_direction = kind.reshape(cells.directions, -1)
    family = table.direction[groups.group[:: cells.positions]]

    on_group = np.where(groups.periodic, kind, np.uint8(_NO_GROUP)).reshape(by_direction.shape)
    cycles = np.empty_like(on_group)
    for one in np.unique(family):
        # Larger basins have smaller classes, so the largest group that passes a square shows there.
        cycles[family == one] = on_group[family == one].min(axis=0)

    longest = int(table.transient.max())
    share, classes = step_classes(longest)
    steps = np.where(groups.periodic, 1, 2 + (groups.step - 1) // share).astype(np.uint8)
    return GroupPictures(
        groups=on_squares(cells, by_direction),
        steps=on_squares(cells, steps.reshape(by_direction.shape)),
        cycles=on_squares(cells, cycles),
        step_classes=classes,
        legends=_legends(cells, table, rank, family),
    )


def _rank(table: GroupTable) -> Int[np.ndarray, "groups"]:
    """The rank of each group by its basin among those of its family, 0 for the largest."""
    order = np.lexsort((-table.basin, table.direction))
    direction = table.direction[order]
    rank = np.empty(order.size, np.int64)
    rank[order] = np.arange(order.size) - np.searchsorted(direction, direction)
    return rank


def _legends(
    cells: CellSpace,
    table: GroupTable,
    rank: Int[np.ndarray, "groups"],
    family: Int[np.ndarray, "directions"],
) -> list[list[LegendEntry]]:
    scale = _scale(int(table.transient.max()))
    legends = {one: _family_legend(table, rank, one) for one in np.unique(family).tolist()}
    _, _, theta = cells.centre(np.arange(cells.directions) * cells.positions)
    return [
        # An arrow is drawn in the place of this swatch, which has the colour of the ground.
        [*legends[one], LegendEntry(HEADING_ROW, f"heading {angle:.6g}°", OBSTACLE), *scale]
        for one, angle in zip(family.tolist(), np.rad2deg(theta).tolist(), strict=True)
    ]


def _scale(longest: int) -> list[LegendEntry]:
    away = np.unique(np.linspace(1, max(longest, 1), 5).round().astype(int))
    colors = ramp((away - 1) / max(longest - 1, 1)).tolist()
    first = LEGEND_ROWS - 1 - away.size
    scale = [LegendEntry(first, "0 mappings: on a group", ON_GROUP)]
    for row, (steps, (red, green, blue)) in enumerate(zip(away, colors, strict=True), first + 1):
        unit = "mapping" if steps == 1 else "mappings"
        scale.append(LegendEntry(row, f"{steps} {unit} to a group", (red, green, blue)))
    return scale


def _family_legend(
    table: GroupTable, rank: Int[np.ndarray, "groups"], direction: int
) -> list[LegendEntry]:
    """The groups whose lowest direction this is."""
    members = np.flatnonzero(table.direction == direction)
    members = members[np.argsort(rank[members])]
    basin = table.basin[members]
    shares = 100 * basin / basin.sum()
    entries: list[LegendEntry] = []
    for group, share, color in zip(members, shares, CATEGORIES.values(), strict=False):
        about = f"group {group}: period {table.period[group]}, {share:.3g} % of cells"
        entries.append(LegendEntry(len(entries), about, color))
    more = members.size - len(entries)
    if more:
        pale = GROUP_CLASSES[group_class(np.array([len(CATEGORIES)]))[0]].color
        about = f"{more} more, pale: {shares[len(entries) :].sum():.3g} % of cells"
        entries.append(LegendEntry(len(entries), about, pale))
    return entries
