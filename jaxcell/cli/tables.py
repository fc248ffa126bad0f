"""The tables of any result in the terminal, from the descriptions of its quantities."""

import math
from typing import Any

import numpy as np

from ..base.quantities import Quantity, Result, columns, parts, values
from ..space import CellSpace
from .terminal import table


_MAX_ROWS = 30
_MAX_TEXT = 60
# Columns of a table whose meanings are in its head; beyond, their names are.
_MAX_LONG = 8


def show(
    result: Result, heading: str, seconds: float | None = None, cells: CellSpace | None = None
) -> None:
    """Print the numbers of a result: a table for each of its tables, and one for single numbers.

    **Arguments:**

    - `result`: what a study gave.
    - `heading`: the line above.
    - `seconds`: how long it took.
    - `cells`: those on which its positions are; by default its own.
    """
    cells = getattr(result, "cells", None) if cells is None else cells
    single = [
        (about.meaning, written(value, about, cells))
        for about, value in values(result).values()
        if not about.dims or (about.listed and len(about.dims) == 1)
    ]
    if seconds is not None:
        single.append(("seconds", f"{seconds:g}"))
    if single:
        table(heading, ("quantity", "value"), single)
    for dim, heading in result.tables.items():
        found = columns(result, dim)
        shown = {
            # There is no space for many that are long.
            name.replace("_", " ") if len(found) > _MAX_LONG else about.meaning: [
                written(one, about, cells) for one in np.asarray(value)[:_MAX_ROWS].tolist()
            ]
            for name, (about, value) in found.items()
            if not about.listed
        }
        if shown:
            rows = list(zip(*shown.values(), strict=True))
            table(heading.replace("_", " ").capitalize(), tuple(shown), rows)
    for name, part in parts(result).items():
        show(part, name.replace("_", " ").capitalize(), cells=cells)


def written(value: Any, about: Quantity, cells: CellSpace | None = None) -> str:
    """A value as people read it, with its unit; positions with their places on the cells."""
    if isinstance(value, np.ndarray | list | tuple):
        text = ", ".join(written(one, about, cells) for one in np.asarray(value).tolist()) or "none"
        return text if len(text) <= _MAX_TEXT else f"{text[: _MAX_TEXT - 3]}..."
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    number = float(value)
    if math.isnan(number) or (about.kind == "position" and number < 0):
        return "none"
    if about.kind == "position" and cells is not None:
        x, y, _ = cells.centre(int(number))
        return f"({float(x):g}, {float(y):g})"
    if not math.isfinite(number):
        return "never" if about.kind == "time" else f"{number}"
    if about.kind in ("share", "distribution"):
        return f"{round(100 * number, 9):.4g} %"
    if about.kind == "residual":
        return f"{number:.1e}"
    text = f"{int(number):,}" if number == int(number) and abs(number) < 1e15 else f"{number:.6g}"
    unit = {None: "", "1": "", "degree": "°"}.get(about.units, f" {about.units}")
    return text + unit
