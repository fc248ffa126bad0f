"""A result as HTML for a notebook: its numbers, its arrays, and a picture where it has a map."""

import base64
import html as markup
import io
from collections.abc import Iterable

from ...base.formatting import format_value
from ...base.optional_modules import has_module
from ...base.quantities import Quantity, Result, is_single, parts, quantities, summarized
from ..data.summary import cells_of
from .plot import picture, plot


# Colours follow the notebook, light or dark.
_STYLE = "text-align:left;padding:1px 12px 1px 0;vertical-align:top"
_INCHES = 4.2, 3.2


def html(result: Result) -> str:
    """Describe a result in HTML that needs nothing else, neither files nor a kernel.

    **Arguments:**

    - `result`: the result of a study.

    **Returns:** its title, a table of its single numbers, the dimensions of its arrays, and a
    picture, if it has an array and matplotlib is installed.
    """
    title = markup.escape(result.title or type(result).__name__)
    body = [f"<strong>{title}</strong>", *(f"<p>{markup.escape(s)}</p>" for s in result.remarks)]
    cells = cells_of(result)
    for heading, part in _with_parts(result):
        singles = (
            (about.meaning, format_value(value, about, cells))
            for about, value in summarized(part).values()
            if is_single(about)
        )
        body += _table(heading, singles)
    arrays = {name: about for name, about in quantities(type(result)).items() if about.dims}
    if arrays:
        rows = ((f"{name} ({', '.join(a.dims)})", _described(a)) for name, a in arrays.items())
        summary = f"<summary>{len(arrays)} arrays</summary>"
        body.append(f"<details>{summary}{''.join(_table('', rows))}</details>")
    image = _image(result)
    flow = "display:flex;flex-wrap:wrap;gap:16px;align-items:flex-start"
    return f'<div style="{flow}"><div>{"".join(body)}</div>{image}</div>'


def _with_parts(result: Result) -> list[tuple[str, Result]]:
    """List a result and the results that are parts of it, with their headings."""
    below = [("", result)]
    for name, part in parts(result).items():
        heading = name.replace("_", " ").capitalize()
        several = part if isinstance(part, tuple) else (part,)
        below += [
            (f"{heading} {i}" if len(several) > 1 else heading, one)
            for i, one in enumerate(several)
        ]
    return below


def _described(about: Quantity) -> str:
    units = "" if about.units in (None, "1") else f", {about.units}"
    return f"{about.meaning}{units}"


def _table(heading: str, rows: Iterable[tuple[str, str]]) -> list[str]:
    """Make a table of two columns, if there are rows."""
    lines = [
        f'<tr><td style="{_STYLE}">{markup.escape(name)}</td>'
        f'<td style="{_STYLE}">{markup.escape(value)}</td></tr>'
        for name, value in rows
    ]
    caption = f"<em>{markup.escape(heading)}</em>" if heading else ""
    return [f"{caption}<table>{''.join(lines)}</table>"] if lines else []


def _image(result: Result) -> str:
    """Draw the picture of a result on a white ground, which is legible in both themes."""
    name = picture(result)
    if name is None or not has_module("matplotlib"):
        return ""
    from matplotlib.figure import Figure

    figure = Figure(figsize=_INCHES, layout="compressed")
    plot(result, name, ax=figure.add_subplot())
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, facecolor="white")
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="{markup.escape(name)}" src="data:image/png;base64,{data}">'
