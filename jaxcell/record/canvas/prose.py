"""Sentences, numbers and tables for the texts of recordings, in Markdown."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

from ...base.formatting import format_value
from ...base.quantities import Result, quantities, values
from ...space import CellSpace
from ..data.summary import cells_of


_MAX_ROWS = 60
# If the meanings of columns have more letters than this, tables have names as heads.
_MAX_HEAD = 72

Spec: TypeAlias = Mapping[str, Any]
"""The parameters of the study that computed a result, keyed by name."""


def describe(cells: CellSpace) -> str:
    if cells.workspace is not None:
        place = cells.workspace.describe()
    else:
        rows, columns = cells.free.shape
        place = f"a grid of {columns} x {rows} squares"
    return (
        f"{place[:1].upper()}{place[1:]}: {cells.positions:,} squares of {cells.cell:g} m, "
        f"{cells.directions} directions, **{cells.size:,} cells**."
    )


def bouncing(bounce: float) -> str:
    """Describe the motion of a robot with one bouncing angle, which is given in radians."""
    return (
        f"A robot runs straight. Where it bumps it turns by **{degrees(bounce)}** "
        "(counter-clockwise), and runs on."
    )


def degrees(angle: float) -> str:
    """Convert an angle in radians to a text in degrees."""
    return f"{math.degrees(angle):.6g}°"


def made_with(spec: Spec, cells: CellSpace | None = None) -> str:
    """Format the section "Made with": the map, and a table of the parameters, if any."""
    given = [(key, value) for key, value in spec.items() if value is not None]
    parts = [] if cells is None else [describe(cells)]
    parts += [table(("parameter", "value"), given)] if given else []
    return "\n\n".join(["## Made with", *parts]) if parts else ""


def table(columns: Sequence[str], rows: Sequence[Sequence[object]], most: int = _MAX_ROWS) -> str:
    """Format a table in Markdown, with at most `most` rows."""
    body = [[str(cell).replace("|", "&#124;") for cell in row] for row in rows[:most]]
    if len(rows) > most:
        body.append([f"{len(rows) - most:,} more"] + [""] * (len(columns) - 1))
    lines = [columns, ["---"] * len(columns), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def numbers(result: Result, cells: CellSpace | None = None) -> str:
    """Format the single numbers and texts of a result, if any, as a table in Markdown."""
    singles, cells = values(result, lambda _, about: not about.dims), cells or cells_of(result)
    rows = [(about.meaning, format_value(value, about, cells)) for about, value in singles.values()]
    return table(("quantity", "value"), rows) if rows else ""


def described(
    results: Result | Sequence[Result],
    *names: str,
    first: Mapping[str, Sequence[object]] | None = None,
    most: int = _MAX_ROWS,
) -> str:
    """Format a table in Markdown with a column for each quantity in `names`.

    For one result, the quantities are arrays of one length, and the table has a row per entry. For
    several results of one class, it has a row per result. Quantities that are `None` in all results
    are left out. `first` maps the headings of further columns, on the left, to their values.
    """
    several = [results] if isinstance(results, Result) else results
    about, cells = quantities(type(several[0])), cells_of(several[0])
    columns: dict[str, Sequence[object]] = dict(first or {})
    known = [name for name in names if any(getattr(one, name) is not None for one in several)]
    heads = {name: about[name].meaning for name in known}
    if sum(map(len, heads.values())) > _MAX_HEAD:
        of = several[0].tables.get(" ".join(about[known[0]].dims), "")
        heads = {name: name.removeprefix(f"{of}_").replace("_", " ") for name in known}
    for name, head in heads.items():
        column = [getattr(one, name) for one in several]
        column = list(column[0]) if isinstance(results, Result) else column
        columns[head] = [
            "" if value is None else format_value(value, about[name], cells) for value in column
        ]
    return table([*columns], list(zip(*columns.values(), strict=True)), most)


def times(count: int) -> str:
    """Format a number of times: `once`, `twice`, `3 times`."""
    return {1: "once", 2: "twice"}.get(count, f"{count:,} times")


def counted(count: int, noun: str) -> str:
    """Format a number with a noun in the singular or plural: `1 group`, `2,000 groups`."""
    return f"{count:,} {noun}{'s' * (count != 1)}"
