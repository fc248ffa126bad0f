from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...base.formatting import format_value
from ...base.quantities import Quantity, Result, columns, is_single, parts, summarized
from ...space import CellSpace
from .summary import cells_of


_MAX_ROWS = 30
# Up to this number of columns, the heads are meanings; otherwise the heads are names.
_MAX_LONG = 8
# Up to this number of results of one kind, each has a column; otherwise each has a row.
_MAX_COLUMNS = 3


class Table(NamedTuple):
    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


def tables(result: Result, heading: str, cells: CellSpace | None = None) -> Iterator[Table]:
    """Build the tables that a terminal shows for a result and for the results in its fields.

    `heading` is the title of the first table. `cells` is the cell space of the positions, by
    default that of the result.
    """
    described, below = _brief(result), parts(result)
    for part in below.values():
        if isinstance(part, tuple) and len(part) == 1:
            # The numbers of a single part go into the first table.
            new = {key: one for key, one in _brief(part[0]).items() if key not in described}
            described = new | described
    cells = cells_of(result) if cells is None else cells
    # Numbers along the dimension of another table are columns of that table.
    single = [
        (about.meaning, format_value(value, about, cells))
        for about, value in described.values()
        if is_single(about) and not set(about.dims) & set(result.tables)
    ]
    if single:
        yield Table(heading, ("quantity", "value"), single)
    yield from _tables(result, "" if single else f"{heading}: ", cells)
    for name, part in below.items():
        if name in result.quiet:
            continue
        title = name.replace("_", " ").capitalize()
        if isinstance(part, tuple):
            yield from _side_by_side(part, title)
        else:
            yield from tables(part, title, cells=cells)


def _brief(result: Result) -> dict[str, tuple[Quantity, Any]]:
    numbers = summarized(result)
    return {name: numbers[name] for name in result.brief if name in numbers} or numbers


def _tables(result: Result, of: str, cells: CellSpace | None) -> Iterator[Table]:
    described = summarized(result)
    for dim, table in columns(result).items():
        if result.brief and dim not in result.brief:
            continue
        listed = {
            key: one for key, one in described.items() if one[0].listed and one[0].dims == (dim,)
        }
        several = table | listed
        length = max((len(np.asarray(value)) for _, value in several.values()), default=0)
        # Meanings do not fit as heads of many columns.
        short = _MAX_LONG < len(several) <= length
        shown = {
            name.replace("_", " ") if short else about.meaning: [
                format_value(one, about, cells) for one in np.asarray(value).tolist()
            ]
            for name, (about, value) in several.items()
        }
        if shown and dim not in described:
            count = len(next(iter(shown.values())))
            shown = {dim.replace("_", " "): [str(i) for i in range(count)], **shown}
        rows = list(zip(*shown.values(), strict=True))
        if len(rows) > _MAX_ROWS:
            rest = f"and {len(rows) - _MAX_ROWS:,} more"
            rows[_MAX_ROWS:] = [(rest, *[""] * (len(shown) - 1))]
        if rows:
            title = f"{of}{result.tables[dim].replace('_', ' ')}"
            yield Table(f"{title[:1].upper()}{title[1:]}", tuple(shown), rows)


def _side_by_side(several: tuple[Result, ...], title: str) -> Iterator[Table]:
    """Build a table that compares several results of one class, and the tables of each result.

    In the first table each result has a column, or a row if there are more than three results.
    """
    across = len(several) <= _MAX_COLUMNS
    rows: dict[str, list[str]] = {}
    for column, one in enumerate(several):
        for name, (about, value) in _brief(one).items():
            if is_single(about) and len(several) > 1:
                key = about.meaning if across else name.replace("_", " ")
                rows.setdefault(key, [""] * len(several))[column] = format_value(value, about)
    numbers = [*map(str, range(len(several)))]
    if across and rows:
        yield Table(title, ("quantity", *numbers), [(name, *row) for name, row in rows.items()])
    elif rows:
        yield Table(title, ("", *rows), [*zip(numbers, *rows.values(), strict=True)])
    for number, part in enumerate(several):
        yield from _tables(part, f"{title.removesuffix('s')} {number}: ", None)
