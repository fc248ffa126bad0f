"""Read numbers with units, as people write them: `45deg`, `50cm`, `2%`."""

import contextlib
import math
import re
from fractions import Fraction


EXPECTED = {
    "": "a number such as 0.5",
    "d": "days such as 3, 3d or 12h",
    "deg": "degrees such as 45 or 45deg",
    "m": "metres such as 0.5, 0.5m or 50cm",
    "m/s": "metres per second such as 0.5, 0.5m/s or 2km/h",
    "m2/s": "m2/s such as 10 or 10m2/s",
    "s": "seconds such as 90, 90s, 1.5min or 2h",
    "share": "a number from 0 to 1, or a percentage such as 2%",
}
"""Examples of numbers with each unit of a parameter, for errors."""

SAME_ANGLE = math.radians(0.01)
"""Angles that differ by less, such as 1.5708 and a right angle, are one number of directions."""
# The size of each unit that may be written. Fractions are exact: 20mm is the float64 nearest to
# 0.02.
_CENT, _DAY = Fraction(1, 100), 86_400
_SIZES: dict[str, dict[str, Fraction | float | int]] = {
    "": {},
    "d": {"d": 1, "h": Fraction(1, 24), "min": Fraction(1, 1440), "s": Fraction(1, _DAY)},
    "deg": {"deg": 1, "°": 1, "rad": math.degrees(1)},
    "m/s": {"m/s": 1, "cm/s": _CENT, "mm/s": Fraction(1, 1000), "km/h": Fraction(1000, 3600)},
    "m2/s": {"m2/s": 1, "m²/s": 1},
    "m": {"m": 1, "cm": _CENT, "mm": Fraction(1, 1000), "km": 1000},
    "s": {"s": 1, "min": 60, "h": 3600, "d": _DAY},
    "share": {"%": _CENT},
}
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d{1,3})?)\s*([^\d\s]\S*)", re.IGNORECASE)


def number_of(text: str, unit: str) -> float:
    """Convert a number, with or without a unit, to the unit of a parameter.

    `unit` is "m", "m/s", "m2/s", "deg", "s", "d", "share", or "" for a number without unit. A
    number that is written without a unit has the unit of the parameter. **Raises:** `ValueError`
    for another text, with examples of what is accepted.

        >>> from jaxcell.base.units import number_of
        >>> number_of("45°", "deg"), number_of("20mm", "m"), number_of("1.5min", "s")
        (45.0, 0.02, 90.0)
        >>> number_of("45m", "deg")
        Traceback (most recent call last):
        ValueError: expected degrees such as 45 or 45deg, got '45m'
    """
    with contextlib.suppress(ValueError):
        return float(text)
    found = _NUMBER.fullmatch(text.strip())
    with contextlib.suppress(OverflowError):
        if found and found[2] in _SIZES[unit]:
            return float(Fraction(found[1]) * _SIZES[unit][found[2]])
    raise ValueError(f"expected {EXPECTED[unit]}, got {text!r}")
