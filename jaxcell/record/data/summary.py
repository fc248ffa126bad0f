from typing import Any

import numpy as np

from ...base.quantities import PADDING, Quantity, Result, columns, is_single, parts, summarized
from ...space import CellSpace


def summary(result: Result, cells: CellSpace | None = None) -> dict[str, Any]:
    """Summarize a result as a JSON object, for people and scripts.

    The object has the single numbers and texts, the arrays of quantities with `listed=True`, a list
    of rows for each of `result.tables`, and an object for each field that is itself a result.
    Infinity and NaN become `None`.

    **Arguments:**

    - `result`: the result of a study.
    - `cells`: the cell space of the positions in the result; by default that of the result.

    **Returns:** an object for `json.dumps`.

    The groups of a robot that bounces in a lab:

        >>> from jaxcell import record, study
        >>> groups = study.Groups(map="@lab_a", bounce=(45.0,)).run()
        >>> record.summary(groups)["groups"][0]["longest_period"]
        20
    """
    cells = cells_of(result) if cells is None else cells
    numbers = {
        name: _plain(value, about, cells)
        for name, (about, value) in summarized(result).items()
        if is_single(about)
    }
    for dim, table in columns(result).items():
        title = result.tables[dim]
        plain = {
            name.removeprefix(f"{title}_"): _plain(value, about, cells)
            for name, (about, value) in table.items()
        }
        if plain:
            rows = zip(*plain.values(), strict=True)
            numbers[title] = [dict(zip(plain, row, strict=True)) for row in rows]
    nested = {
        name: [summary(member, cells) for member in part]
        if isinstance(part, tuple)
        else summary(part, cells)
        for name, part in parts(result).items()
    }
    sentences = {"answer": list(result.answer)} if result.answer else {}
    return {**sentences, **numbers, **nested}


def cells_of(result: Result) -> CellSpace | None:
    """Return the cell space of a result, or `None`."""
    cells = getattr(result, "cells", None)
    return cells if isinstance(cells, CellSpace) else None


def place(cells: CellSpace, position: int) -> dict[str, Any] | None:
    """Return the index of a position and its coordinates in metres; `None` for the index -1."""
    if position < 0:
        return None
    x, y, _ = cells.centre(position)
    return {"cell": position, "x": float(x), "y": float(y)}


def _plain(value: Any, about: Quantity, cells: CellSpace | None) -> Any:
    if isinstance(value, str | bool | None):
        return value
    array = np.asarray(value)
    if about.kind == "place" and cells is not None:
        places = [place(cells, position) for position in array.ravel().tolist()]
        return places if array.ndim else places[0]
    if about.kind in PADDING and array.ndim == 2:
        padding = PADDING[about.kind]
        return [[entry for entry in row if entry != padding] for row in array.tolist()]
    if array.dtype.kind == "f":
        infinite, array = ~np.isfinite(array), array.astype(object)
        array[infinite] = None
    return array.tolist()
