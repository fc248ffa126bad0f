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
    _tables(result, "")
    for name, part in parts(result).items():
        title = name.replace("_", " ").capitalize()
        if isinstance(part, tuple):
            _side_by_side(part, title)
        else:
            show(part, title)


def _tables(result: Result, of: str) -> None:
    """Print the tables of a result."""
    described = summarized(result)
    for dim, name in result.tables.items():
        columns = {
            about.meaning: (about, np.asarray(value))
            for key, (about, value) in described.items()
            if about.dims == (dim,) and key != dim and not about.listed
        }
        if columns:
            count = min(map(len, (value for _, value in columns.values())))
            first = f", the first {_MAX_ROWS} of {count:,}" if count > _MAX_ROWS else ""
            cells = [
                [written(one, about) for one in value[:_MAX_ROWS].tolist()]
                for about, value in columns.values()
            ]
            title = f"{of}{name.replace('_', ' ')}"
            rows = list(zip(*cells, strict=True))
            table(f"{title[:1].upper()}{title[1:]}{first}", tuple(columns), rows)


def _side_by_side(several: tuple[Result, ...], title: str) -> None:
    """Print the numbers of results of one kind, a column for each, and the tables of each."""
    described = [summarized(one) for one in several]
    rows: dict[str, list[str]] = {}
    for column, one in enumerate(described):
        for about, value in one.values():
            if not about.dims or about.listed:
                rows.setdefault(about.meaning, [""] * len(several))[column] = written(value, about)
    numbers = map(str, range(len(several)))
    table(title, ("quantity", *numbers), [(name, *row) for name, row in rows.items()])
    for number, part in enumerate(several):
        _tables(part, f"{title.removesuffix('s')} {number}: ")


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
    unit = {None: "", "1": "", "degree": "°", "degrees_east": "°", "degrees_north": "°"}.get(
        about.units, f" {about.units}"
    )
    return text + unit
