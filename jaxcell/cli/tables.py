"""The tables of any result in the terminal, from the descriptions of its quantities."""

import math
from typing import Any

import numpy as np

from ..base.quantities import Quantity, Result, parts, summarized
from .terminal import table


_MAX_ROWS = 30
_MAX_TEXT = 60


def show(result: Result, heading: str, seconds: float | None = None) -> None:
    """Print the numbers of a result: a table for each of its tables, and one for single numbers.

    **Arguments:**

    - `result`: what a study gave.
    - `heading`: the line above.
    - `seconds`: how long it took.
    """
    described = summarized(result)
    single = [
        (about.meaning, written(value, about))
        for about, value in described.values()
        if not about.dims or about.listed
    ]
    if seconds is not None:
        single.append(("seconds", f"{seconds:g}"))
    if single:
        table(heading, ("quantity", "value"), single)
    for dim, name in result.tables.items():
        columns = {
            about.meaning: [written(one, about) for one in np.asarray(value)[:_MAX_ROWS].tolist()]
            for key, (about, value) in described.items()
            if about.dims == (dim,) and key != dim and not about.listed
        }
        if columns:
            rows = list(zip(*columns.values(), strict=True))
            more = max(
                np.size(value) for about, value in described.values() if about.dims == (dim,)
            )
            if more > len(rows):
                rows.append((f"{more - len(rows):,} more", *[""] * (len(columns) - 1)))
            table(name.replace("_", " ").capitalize(), tuple(columns), rows)
    for name, part in parts(result).items():
        show(part, name.replace("_", " ").capitalize())


def written(value: Any, about: Quantity) -> str:
    """A value as people read it, with its unit."""
    if isinstance(value, np.ndarray | list | tuple):
        text = ", ".join(written(one, about) for one in np.asarray(value).tolist()) or "none"
        return text if len(text) <= _MAX_TEXT else f"{text[: _MAX_TEXT - 3]}..."
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
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
