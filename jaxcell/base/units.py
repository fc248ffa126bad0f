"""Read numbers with units, as people write them: `45deg`, `50cm`, `2%`."""

import contextlib
import math
import re
from fractions import Fraction


# For each unit of a parameter: what an error asks for, and the size of the units that are read.
# Fractions are exact: 20mm is the float64 nearest to 0.02.
_CENT, _DAY = Fraction(1, 100), 86_400
_UNITS: dict[str, tuple[str, dict[str, Fraction | float | int]]] = {
    "": ("a number such as 0.5", {}),
    "d": (
        "days such as 3, 3d or 12h",
        {"d": 1, "h": Fraction(1, 24), "min": Fraction(1, 1440), "s": Fraction(1, _DAY)},
    ),
    "deg": ("degrees such as 45 or 45deg", {"deg": 1, "°": 1, "rad": math.degrees(1)}),
    "m": (
        "metres such as 0.5, 0.5m or 50cm",
        {"m": 1, "cm": _CENT, "mm": Fraction(1, 1000), "km": 1000},
    ),
    "s": ("seconds such as 90, 90s, 1.5min or 2h", {"s": 1, "min": 60, "h": 3600, "d": _DAY}),
    "share": ("a number from 0 to 1, or a percentage such as 2%", {"%": _CENT}),
}
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*([^\d\s]+)", re.IGNORECASE)


def number_of(text: str, unit: str) -> float:
    """Convert a number, with or without a unit, to the unit of a parameter.

    `unit` is "m", "deg", "s", "d", "share", or "" for a number without unit. A number that is
    written without a unit has the unit of the parameter. **Raises:** `ValueError` for another text,
    with examples of what is accepted.

        >>> from jaxcell.base.units import number_of
        >>> number_of("45°", "deg"), number_of("20mm", "m"), number_of("1.5min", "s")
        (45.0, 0.02, 90.0)
        >>> number_of("45m", "deg")
        Traceback (most recent call last):
        ValueError: expected degrees such as 45 or 45deg, got '45m'
    """
    expected, sizes = _UNITS[unit]
    with contextlib.suppress(ValueError):
        return float(text)
    found = _NUMBER.fullmatch(text.strip())
    with contextlib.suppress(OverflowError):
        if found and found[2] in sizes:
            return float(Fraction(found[1]) * sizes[found[2]])
    raise ValueError(f"expected {expected}, got {text!r}")
