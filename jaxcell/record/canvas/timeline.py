"""Timelines along values of a parameter. The viewer needs whole numbers as times."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int


_EXACT_DIGITS, _MAX_DIGITS = 6, 12


class Timeline(NamedTuple):
    """A timeline along the values of a parameter."""

    name: str
    "The name of the timeline, which includes the factor between values and times."
    times: Int[np.ndarray, "values"]
    meaning: str
    "The meaning of a time, in words."


def along_values(name: str, values: np.ndarray) -> Timeline:
    """Choose a timeline whose slider shows the values of a parameter.

    If the values are texts, or not all different, the times are their indices.
    """
    times, digits = _scaled(values) if values.dtype.kind in "iuf" else (values, None)
    if digits is None:
        return Timeline(f"{name} number", np.arange(values.size), "the number of the value, from 0")
    if digits:
        name, meaning = f"{name} x {10**digits}", f"the value times {10**digits}"
    else:
        meaning = "the value"
    return Timeline(name, times.astype(int), meaning)


def _scaled(values: np.ndarray) -> tuple[np.ndarray, int | None]:
    """Scale values to whole numbers by a power of ten. Returns the numbers and the exponent.

    The numbers are exact if six digits suffice. Otherwise they are rounded to the smallest number
    of digits, but at least four, for which the values remain different.
    """
    largest = float(np.abs(values).max())
    for exact, most in (True, _EXACT_DIGITS), (False, _MAX_DIGITS):
        for digits in range(most + 1):
            scaled = values * 10.0**digits
            whole = np.rint(scaled)
            if largest * 10.0**digits >= 2**53:
                break
            near = np.allclose(scaled, whole, rtol=0, atol=1e-6)
            fits = near if exact else largest * 10.0**digits >= 1e4
            if fits and np.unique(whole).size == values.size:
                return whole, digits
    return values, None
