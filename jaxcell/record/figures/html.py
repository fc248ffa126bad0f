import base64
import io
from collections.abc import Iterable, Sequence
from html import escape

from ...base.optional_modules import has_module
from ...base.quantities import Result, quantities
from ...base.shown import Pictured, Shown, field_texts
from ..data.tables import tables
from .plot import picture, plot


_CELL = "text-align:left;padding:1px 12px 1px 0;vertical-align:top"
_FLOW = "display:flex;flex-wrap:wrap;gap:16px;align-items:flex-start"
_INCHES = 4.2, 3.2
# Largest number of rows of a table; the dataset has all rows.
_ROWS = 12


def html(shown: Shown) -> str:
    """Describe an object in HTML for a notebook; the HTML needs neither files nor a kernel.

    It contains a table of the fields and, if there is something to see and matplotlib is installed,
    a picture. For a result it contains the remarks, the tables that a command prints, and a list of
    arrays.
    """
    body = _of_result(shown) if isinstance(shown, Result) else _of_fields(shown)
    return f'<div style="{_FLOW}"><div>{body}</div>{_image(shown)}</div>'


def _of_fields(shown: Shown) -> str:
    fields = list(field_texts(shown).items())
    return _table(type(shown).__name__, ("quantity", "value"), fields, rows=len(fields))


def _of_result(result: Result) -> str:
    title = result.title or type(result).__name__
    body = [f"<p>{escape(remark)}</p>" for remark in result.remarks]
    body += [_table(*table) for table in tables(result, title)] or [_table(title)]
    arrays = [
        (f"{name} ({', '.join(about.dims)})", f"{about.meaning} [{about.units or '1'}]")
        for name, about in quantities(type(result)).items()
        if about.dims
    ]
    if arrays:
        listed = _table("", ("array", "meaning"), arrays, rows=len(arrays))
        body.append(f"<details><summary>{len(arrays)} arrays</summary>{listed}</details>")
    return "".join(body)


def _table(
    title: str, heads: Sequence[str] = (), lines: Sequence[Sequence[str]] = (), rows: int = _ROWS
) -> str:
    head = "" if heads == ("quantity", "value") else _row("th", heads)
    body = "".join(_row("td", line) for line in lines[:rows])
    if len(lines) > rows:
        body += _row("td", [f"and {len(lines) - rows:,} more"])
    return f"<strong>{escape(title)}</strong><table>{head}{body}</table>"


def _row(tag: str, texts: Iterable[str]) -> str:
    cells = "".join(f'<{tag} style="{_CELL}">{escape(str(text))}</{tag}>' for text in texts)
    return f"<tr>{cells}</tr>"


def _image(shown: Shown) -> str:
    """Return the picture of an object as HTML; its white background suits dark notebooks too."""
    if not isinstance(shown, Pictured) or not has_module("matplotlib"):
        return ""
    if (name := picture(shown)) is None:
        return ""
    from matplotlib.figure import Figure

    figure = Figure(figsize=_INCHES, layout="compressed")
    plot(shown, name, ax=figure.add_subplot())
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, facecolor="white")
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="{escape(name)}" src="data:image/png;base64,{data}">'
