import numpy as np
import pandas as pd
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import UInt8

from ...bounce import BounceGroups
from ..canvas import palette
from ..canvas.map import CellMap, Directions, directions_shown
from ..canvas.page import log_legends, log_tab
from ..canvas.palette import Color, PictureClass
from ..canvas.prose import Spec, bouncing, made_with
from ..canvas.scale import Scale
from ..canvas.stream import pace, send_blueprint, send_changing


_NO_GROUP = len(palette.GROUP_CLASSES)
# The row of the heading follows the rows of groups, of other groups, of shades, and an empty row.
_HEADING_ROW = len(palette.CATEGORIES) + 4
# After the heading come an empty row, and the rows of the steps.
_LEGEND_ROWS = _HEADING_ROW + 8
_ON_GROUP, _OFF_GROUPS = "on a group", "on no such group"
_EMPTY = "", palette.CLEAR


def log_groups(stream: rr.RecordingStream, groups: BounceGroups, spec: Spec) -> None:
    """Record periodic groups, with a tab per bouncing angle."""
    map, shown = CellMap(stream, groups.cells), directions_shown(groups.cells)
    tabs = [
        log_group_tab(map, groups, i, f"bounce {angle:.6g}°", shown, spec)
        for i, angle in enumerate(groups.bounce_deg.tolist())
    ]
    send_blueprint(stream, tabs, "direction", pace(groups.cells.directions))


def log_group_tab(
    map: CellMap, groups: BounceGroups, angle: int, title: str, shown: Directions, spec: Spec
) -> rrb.Container:
    """Log a tab for a bouncing angle; `shown` gives the direction of its pictures at each time."""
    stream, one = map.stream, _OfAngle(groups, angle)
    name = f"bounce_{groups.bounce_deg[angle]:.6g}"
    views = []
    for about, kind, classes, cells in one.pictures():
        picture = map.by_direction(f"{name}/{kind}", classes, cells, shown)
        views.append(map.view(about, [picture]))
    legends = one.legends()
    style = {"colors": palette.TEXT, "radii": 0.09, "draw_order": 50}
    for timeline, (times, headings) in shown.items():
        log_legends(stream, f"{name}/legend", [legends[k] for k in headings], timeline, times)
        theta = 2 * np.pi * headings / len(legends)
        # A legend has y down.
        vector = 0.45 * np.stack([np.cos(theta), -np.sin(theta)], axis=1)
        middle = np.array([0.25, _HEADING_ROW])
        arrows = {"origins": middle - vector, "vectors": 2 * vector}
        path = f"{name}/legend/heading"
        send_changing(stream, path, rr.Arrows2D, times, None, timeline, style=style, **arrows)
    return log_tab(stream, name, title, views, _text(groups, angle, spec), _LEGEND_ROWS)


class _OfAngle:
    """The groups of one bouncing angle as pictures and legends.

    Groups with the same directions form a family: with a bouncing angle of 90 degrees and 360
    directions there are 90 families. A picture shows one direction, and thus one family. The rank
    of a group in its family determines its colour.
    """

    def __init__(self, groups: BounceGroups, angle: int) -> None:
        self.group, self.step = groups.group[angle], groups.step[angle]
        self.period = groups.group_period[angle]
        self._basin = np.bincount(self.group.ravel())
        # The lowest direction of the cells of each group identifies the family of the group.
        self._lowest = np.zeros(self._basin.size, np.int32)
        for k in reversed(range(len(self.group))):
            self._lowest[self.group[k]] = k
        self._family = self._lowest[self.group[:, 0]]
        # The rank of each group in its family by its basin, 0 for the largest.
        sizes = pd.Series(-self._basin).groupby(self._lowest)
        self._rank = sizes.rank("first").to_numpy(np.int64) - 1
        most, special = int(self.step.max()), {_ON_GROUP: palette.ON_GROUP}
        self._steps = Scale.counting(
            1, most, lambda n: f"{n} mapping{'s' * (n != '1')} to a group", special=special
        )

    def pictures(self) -> list[tuple[str, str, list[PictureClass], UInt8[np.ndarray, "_ _"]]]:
        """Return each picture as its title, its name, its classes, and the class of each cell."""
        on_group = self.step == 0
        kind = (palette.group_class(self._rank)[self.group] + on_group).astype(np.uint8)
        passing = np.where(on_group, kind, np.uint8(_NO_GROUP))
        cycles = np.empty_like(passing)
        for one in np.unique(self._family):
            # Larger basins have smaller classes, so a square shows the largest group through it.
            cycles[self._family == one] = passing[self._family == one].min(axis=0)
        groups, none = palette.GROUP_CLASSES, PictureClass(_OFF_GROUPS, palette.FREE)
        away = self._steps.levels(self.step, {_ON_GROUP: on_group})
        return [
            ("Group that each cell leads to", "groups", groups, kind),
            ("Mappings to the group", "steps", self._steps.classes, away),
            ("Squares of these groups", "cycles", [*groups, none], cycles),
        ]

    def legends(self) -> list[list[tuple[str, Color]]]:
        scale = self._steps.legend()
        of_family = {one: self._legend(one) for one in np.unique(self._family).tolist()}
        spacing = 360 / len(self.group)
        # An arrow is drawn over the clear swatch of the heading.
        return [
            [*of_family[one], (f"heading {k * spacing:.6g}°", palette.CLEAR), _EMPTY, *scale]
            for k, one in enumerate(self._family.tolist())
        ]

    def _legend(self, direction: int) -> list[tuple[str, Color]]:
        """Return the legend of a family; `direction` is the lowest direction of its cells."""
        members = np.flatnonzero(self._lowest == direction)
        members = members[np.argsort(self._rank[members])]
        basin = self._basin[members]
        shares = 100 * basin / basin.sum()
        named = zip(members.tolist(), shares.tolist(), palette.CATEGORIES.values(), strict=False)
        entries = [(self._named(group, share), color) for group, share, color in named]
        if more := members.size - len(entries):
            about = f"{more} more, in pale colours: {shares[len(entries) :].sum():.3g} % of cells"
            if more == 1:
                about = self._named(int(members[-1]), float(shares[-1]))
            pale = palette.group_class(np.array([len(palette.CATEGORIES)]))[0]
            entries.append((about, palette.GROUP_CLASSES[pale].color))
        dark = palette.GROUP_CLASSES[2].color
        entries.append(("dark shade of a colour: on the group itself", dark))
        entries.append((_OFF_GROUPS, palette.FREE))
        return entries + [_EMPTY] * (_HEADING_ROW - len(entries))

    def _named(self, group: int, share: float) -> str:
        return f"group {group}: period {self.period[group]}, {share:.3g} % of cells"


def _text(groups: BounceGroups, i: int, spec: Spec) -> str:
    cells, count = groups.cells, groups.count[i]
    shortest, longest = groups.shortest_period[i], groups.longest_period[i]
    if count == 1:
        periods = f"There is **one**, with period {longest:,}"
    else:
        periods = f"There are **{count:,}**, with periods from {shortest:,} to {longest:,}"
    return f"""# Periodic groups

{bouncing(float(groups.bounce[i]))}

From every cell the robot ends in a cycle of cells, a *periodic group*. {periods}. The farthest cell
reaches its group in **{groups.longest_transient[i]:,}** mappings.

## The three maps

Each shows one of {cells.directions} directions: drag `direction` at the bottom.

- **Group that each cell leads to**: a colour is a group, darker on the group itself.
- **Mappings to the group**: their number, from each cell.
- **Squares of these groups**, for all directions together.

The legend names the groups with the largest basins in the direction that is shown.

{made_with(spec, cells)}"""
