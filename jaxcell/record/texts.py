"""What a stranger reads beside the pictures, in Markdown."""

import math
from collections.abc import Mapping
from typing import Any

from ..automata import Filter
from ..bounce import Localization
from ..space import CellSpace
from .canvas.palette import cycle_color
from .graph import Drawing
from .tables import GroupTable


_MOST_OBSERVATIONS = 240
_MOST_ROWS = 12


def groups_text(cells: CellSpace, angle: float, table: GroupTable, spec: Mapping[str, Any]) -> str:
    """What the pictures of periodic groups show."""
    count, shortest, longest = table.period.size, table.period.min(), table.period.max()
    if count == 1:
        groups = f"There is **one**, with period {longest:,}"
    else:
        groups = f"There are **{count:,}**, with periods from {shortest:,} to {longest:,}"
    return f"""# Periodic groups

{_robot(angle)}

{describe(cells)} Each cell has one next cell, its *image*, so that from every cell the robot
comes in the end to a cycle of cells, a *periodic group*. {groups}. From the farthest cell it takes
**{table.transient.max():,}** mappings to get there.

## The three maps

Each shows one direction at a time; the slider `direction` at the bottom goes through all
{cells.directions}, from East (0) counter-clockwise. Hover over a square to read its class.

- **The group that each cell leads to**: cells of one colour end in the same group. Cells that are
  on it already are darker.
- **The mappings that it takes**, from white (on a group) over blue to yellow.
- **Where these groups run**, in whatever direction: the cycles themselves.

The legend is for the direction that is shown. Groups with larger basins come first; those past the
seventh have pale shades.

{made_with(spec)}"""


def localization_text(
    cells: CellSpace,
    angle: float,
    filter: Filter,
    run: Localization,
    drawing: Drawing,
    most_arrows: int,
    spec: Mapping[str, Any],
) -> str:
    """What the recording of a localization shows."""
    steps, bumps = run.observations.size, int(run.observations.sum())
    word = "".join(map(str, run.observations[:_MOST_OBSERVATIONS].tolist()))
    word += "..." if steps > _MOST_OBSERVATIONS else ""
    x, y, theta = (float(value) for value in cells.centre(int(run.path[0])))
    return f"""# Where is the robot?

{_robot(angle)} It has the map, a bump sensor and a clock; it does not know where it starts.

{describe(cells)} The *filter* keeps the set of cells where the robot may be.

**This run** starts at x = {x:.4g} m, y = {y:.4g} m, heading {math.degrees(theta):.4g}°. It takes
{steps:,} observations (0: it moved, 1: it bumped, {bumps:,} times):

`{word or "none"}`

{_outcome(filter, run)}

## How to look

Press play, or drag the slider `step` at the bottom.

- **vermilion arrow**: the robot, which the filter does not see; the line is its trail.
- **blue arrows**: the cells where the robot may be. While these are more than {most_arrows},
  squares are blue instead, the darker the more headings are possible.
- **green squares**, at the end: where the robot may be, with the truth among them.
- **the filter**: a dot is a state, a set of cells, larger if it has more of them.
  {_drawn(filter, drawing)} The state of the filter is violet, those it has been in are vermilion.
  Each coloured loop is a *knowledge cycle*, which nothing leaves: there the robot is localized.

The tab **Groups** shows, for the heading of the robot, where all cells lead in the end. Its slider
is `direction`: choose it at the bottom left, in the place of `step`.

{_cycles(filter)}

{made_with(spec)}"""


def _robot(angle: float) -> str:
    return (
        f"A robot runs straight. Where it bumps it turns by **{math.degrees(angle):.6g}°** "
        "(counter-clockwise), and runs on."
    )


def describe(cells: CellSpace) -> str:
    if cells.workspace is not None:
        place = cells.workspace.describe()
    else:
        rows, columns = cells.free.shape
        place = f"a grid of {columns} x {rows} squares"
    return (
        f"The map is {place}. Squares of {cells.cell:g} m make {cells.positions:,} free positions; "
        f"with {cells.directions} directions these are **{cells.size:,} cells**. A step leads from "
        "the centre of a square to that of another, so paths follow the grid more than the heading."
    )


def _outcome(filter: Filter, run: Localization) -> str:
    state = int(run.states[-1])
    if state == filter.trap:
        return "The last of them cannot occur on this map: the robot is **somewhere else**."
    count = int(filter.uncertainty[state])
    if filter.color[state] == 1:
        return f"In the end the robot may be in {count:,} cells; it is **not localized** yet."
    where = "it is in **one** cell" if count == 1 else f"it is in one of **{count:,}** cells"
    truth = "" if run.contains_truth else ", but the truth is **not** among them"
    return (
        f"Then the filter is in a knowledge cycle, of colour {filter.color[state]}, and the robot "
        f"is **localized**: {where}{truth}."
    )


def _drawn(filter: Filter, drawing: Drawing) -> str:
    if drawing.whole:
        text = "The start is at the left, and each column is one observation farther from it."
    else:
        text = (
            f"There are {len(filter.transition):,}, too many to draw: the rows at the top are the "
            "last states of this run, to and fro, and after them come knowledge cycles, first the "
            "one that the run ends in."
        )
        if drawing.cycles_left_out:
            text += f" {drawing.cycles_left_out:,} cycles are left out."
    if filter.trap is not None and filter.trap not in drawing.state:
        text += " The trap, where observations lead that cannot occur, is left out."
    return text


def _cycles(filter: Filter) -> str:
    count = len(filter.cycles)
    lines = [f"## {count:,} knowledge {'cycle' if count == 1 else 'cycles'}", ""]
    lines += ["| colour | uncertainty (cells) | length |", "| --- | --- | --- |"]
    for cycle in filter.cycles[:_MOST_ROWS]:
        color = f"{cycle.color} ({cycle_color(cycle.color)[0]})"
        lines.append(f"| {color} | {cycle.uncertainty} | {len(cycle.states)} |")
    doubt = [cycle.uncertainty for cycle in filter.cycles[_MOST_ROWS:]]
    if doubt:
        lines.append(f"| {len(doubt):,} more | {min(doubt)} to {max(doubt)} | |")
    return "\n".join(lines)


def made_with(spec: Mapping[str, Any]) -> str:
    if not spec:
        return ""
    lines = ["## Made with", "", "| what | value |", "| --- | --- |"]
    # A bar would end the column.
    lines += [f"| {key} | {str(value).replace('|', '&#124;')} |" for key, value in spec.items()]
    return "\n".join(lines)
