"""Format values of quantities as text for people."""

import difflib
import math
from collections.abc import Iterable
from typing import Any

from .quantity import PADDING, Quantity


_MAX_TEXT = 60
# Times of at least this number of hours are written in days.
_DAYS = 72
# Seconds or hours in an hour: times of at least an hour are written in hours, days or years.
_HOURS = {"h": 1, "s": 3600}
# Times of at least this number of hours are written in years.
_YEARS = 10 * 24 * 365.25
# Numbers from here on are written as whole numbers.
_WHOLE = 1000
# Smaller extents are written as smaller than this length in metres, not as 0.
_SMALLEST_EXTENT = 1e-3
_UNITS = {None: "", "1": "", "degree": "°", "degrees_east": "°", "degrees_north": "°"}


def format_value(value: Any, about: Quantity, cells: Any = None) -> str:
    """Format a value with its unit.

    Numbers have three digits, but coordinates six. The number of a cell is shown after its pose in
    `cells`, and another index with a `#`, so that neither is taken for a count. A list of texts is
    shown whole.
    """
    # Imported here because pages of help do not need NumPy.
    import numpy as np

    if isinstance(value, np.ndarray | list | tuple):
        row = [entry for entry in np.asarray(value).tolist() if entry != PADDING.get(about.kind)]
        every = [format_value(one, about, cells) for one in row]
        if about.kind in ("cell", "position") and sum(len(one) + 2 for one in every) > _MAX_TEXT:
            every = [f"{about.kind}s {row[0]}", *map(str, row[1:])]
        lengths = np.cumsum([len(one) + 2 for one in every])
        shown = max(1, int(np.searchsorted(lengths, _MAX_TEXT, side="right")))
        shown = len(every) if about.kind == "text" else shown
        rest = [f"and {len(every) - shown:,} more"] if shown < len(every) else []
        poses = about.kind in ("cell", "position") and cells is not None and len(every) > 1
        return ("; " if poses and "(" in every[0] else ", ").join(every[:shown] + rest) or "none"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    number = float(value)
    located = about.kind in ("cell", "place", "position")
    if math.isnan(number) and "not known" in about.attributes.get("padding", ""):
        return "not known"
    if math.isnan(number) or (located and number < 0):
        return "none"
    if about.kind == "place" and cells is not None:
        x, y, _ = cells.centre(int(number))
        return f"({float(x):zg} m, {float(y):zg} m)"
    if located and cells is not None:
        return configuration(cells, int(number), heading=about.kind == "cell")
    if located:
        return f"{'cell' if about.kind == 'place' else about.kind} {int(number)}"
    if about.kind == "index" and about.units is None:
        return f"#{int(number)}" if number >= 0 else "none"
    if not math.isfinite(number):
        return {"time": "never", "extent": "anywhere"}.get(about.kind, f"{number}")
    if about.kind == "extent" and number < _SMALLEST_EXTENT:
        return f"< {1000 * _SMALLEST_EXTENT:g} mm"
    if about.kind in ("share", "distribution"):
        return percent(number)
    if about.kind == "residual":
        return f"{number:z.1e}"
    if about.units in _HOURS and number >= _HOURS[about.units]:
        return in_time(number / _HOURS[about.units])
    precise = about.kind == "coordinate" or str(about.units).startswith("degrees_")
    whole = number == int(number) or (abs(number) >= _WHOLE and not precise)
    digits = 6 if precise else 3
    text = f"{round(number):,}" if whole and abs(number) < 1e15 else f"{number:.{digits}g}"
    return text + _UNITS.get(about.units, f" {about.units}")


def percent(share: float) -> str:
    """Format a share as a percentage, which is 100 % only if nothing is missing.

    >>> from jaxcell.base.formatting import percent
    >>> percent(0.5934), percent(0.9999), percent(1.0)
    ('59.3 %', 'over 99.9 %', '100 %')
    """
    hundredths = round(100 * share, 9)
    text = f"{hundredths:z.3g}"
    return "over 99.9 %" if text == "100" and hundredths < 100 else f"{text} %"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of an error that names the known word most similar to `word`, if any."""
    near = difflib.get_close_matches(word, [*known], 1)
    return f"; did you mean {near[0]}?" if near else ""


def counted(number: float | int, noun: str) -> str:
    """Format a number of things, as in `1 bump`, `2.5 bumps` and `2,000 bumps`."""
    return f"{f'{number:,}'.removesuffix('.0')} {noun}{'s' if number != 1 else ''}"


def in_time(hours: float) -> str:
    """Format a time: in hours below three days, in days below ten years, and otherwise in years.

    >>> from jaxcell.base.formatting import in_time
    >>> in_time(16.9), in_time(720.0), in_time(200_000.0)
    ('16.9 h', '30 days', '22.8 years')
    """
    if hours < _DAYS:
        return f"{hours:.3g} h"
    if hours < _YEARS:
        return f"{hours / 24:.3g} days"
    years = hours / (24 * 365.25)
    return f"{years:.3g} years" if years < 1e6 else "over 1,000,000 years"


def configuration(cells: Any, z: int, heading: bool = True) -> str:
    """Format a cell as its pose and its number, or a position if `heading` is false."""
    if z < 0:
        return "none"
    x, y, theta = cells.centre(z)
    facing = f", heading {math.degrees(float(theta)):zg}°" if heading else ""
    number = f"{'cell' if heading else 'position'} {z}"
    return f"{float(x):zg} m, {float(y):zg} m{facing} ({number})"
