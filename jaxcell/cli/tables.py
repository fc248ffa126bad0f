"""The tables of any result in the terminal, from the descriptions of its quantities."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.quantities import Quantity, Result, parts, values
from .terminal import configuration, table


if TYPE_CHECKING:
    from ..space import CellSpace


_MAX_ROWS = 30
_MAX_TEXT = 60


def show(result: Result, heading: str, seconds: float | None = None) -> None:
    """Print the numbers of a result: a table for each of its tables, and one for single numbers.

    **Arguments:**

    - `result`: what a study gave.
    - `heading`: the line above.
    - `seconds`: how long it took.
    """
    described, cells = values(result), getattr(result, "cells", None)
    single = [
        (about.meaning, written(value, about, cells))
        for about, value in described.values()
        if not about.dims or (about.listed and about.dims[0] not in result.tables)
    ]
    if seconds is not None:
        single.append(("seconds", f"{seconds:g}"))
    if single:
        table(heading, ("quantity", "value"), single)
    for dim, name in result.tables.items():
        columns = {
            about.meaning: [written(one, about, cells) for one in np.asarray(value).tolist()]
            for key, (about, value) in described.items()
            if about.dims == (dim,) and key != dim
        }
        if columns and dim not in described:
            count = len(next(iter(columns.values())))
            columns = {dim: [str(i) for i in range(count)], **columns}
        rows = list(zip(*columns.values(), strict=True))
        if len(rows) > _MAX_ROWS:
            rest = f"and {len(rows) - _MAX_ROWS:,} more"
            rows[_MAX_ROWS:] = [(rest, *[""] * (len(columns) - 1))]
        if rows:
            table(name.replace("_", " ").capitalize(), tuple(columns), rows)
    for name, part in parts(result).items():
        show(part, name.replace("_", " ").capitalize())


def written(value: Any, about: Quantity, cells: "CellSpace | None" = None) -> str:
    """A value as people read it, with its unit; a place in some cells with its pose."""
    if isinstance(value, np.ndarray | list | tuple):
        every = [written(one, about, cells) for one in np.asarray(value).tolist()]
        lengths = np.cumsum([len(one) + 2 for one in every])
        shown = max(1, int(np.searchsorted(lengths, _MAX_TEXT, side="right")))
        rest = [f"and {len(every) - shown:,} more"] if shown < len(every) else []
        return ", ".join(every[:shown] + rest) or "none"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if about.kind in ("cell", "position") and cells is not None:
        return configuration(cells, int(value), heading=about.kind == "cell")
    number = float(value)
    if not math.isfinite(number):
        return "never" if about.kind == "time" else f"{number}"
    if about.kind in ("share", "distribution"):
        return f"{100 * number:.4g} %"
    if about.kind == "residual":
        return f"{number:.1e}"
    text = f"{int(number):,}" if number == int(number) and abs(number) < 1e15 else f"{number:.6g}"
    unit = {None: "", "1": "", "degree": "°"}.get(about.units, f" {about.units}")
    return text + unit
