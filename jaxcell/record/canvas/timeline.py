"""Timelines along a parameter; a time is a value of the parameter, scaled to an integer."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int


_EXACT_DIGITS, _MAX_DIGITS = 6, 12


class Timeline(NamedTuple):
    """A timeline along the values of a parameter."""

    name: str
    """The name of the timeline. It contains the factor that converts values to times, as in `angle
    x 10`."""
    times: Int[np.ndarray, "values"]
    meaning: str
    "The meaning of a time, such as `the value times 10`."


def along_values(name: str, values: np.ndarray) -> Timeline:
    """Create the timeline along the values of a parameter.

    A time is a value times a power of ten. If values are texts, or not all different, their indices
    are the times.
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
    """Scale values by a power of ten to whole numbers, and return the numbers and the exponent.

    The numbers are exact if at most six decimals suffice. Otherwise they are rounded, with the
    fewest decimals for which all numbers differ and the largest has at least five digits. If that
    is impossible, the exponent is `None`.
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
