"""Checks of numbers in arguments; each raises a `ValueError` that names the wrong number."""

import numbers
import reprlib
from typing import Any

import numpy as np
from jaxtyping import Float


# Tolerance of the sum of a distribution.
_ROUNDING = 1e-9


def check_count(name: str, value: int) -> None:
    if not isinstance(value, numbers.Integral) or value < 1:
        raise ValueError(f"{name}: expected a whole number of at least 1, got {value!r}")


def finite(name: str, values: Any) -> Float[np.ndarray, "..."]:
    """Return `values` as an array of finite numbers, of any shape."""
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{name}: expected an array of numbers, got {values!r}") from error
    if not (np.issubdtype(array.dtype, np.integer) or np.issubdtype(array.dtype, np.floating)):
        raise ValueError(f"{name}: expected an array of numbers, got {array.dtype}")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        wrong = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"{name}{wrong} is {array[tuple(wrong)]}; expected a finite number")
    return array


def one_each(
    name: str, values: Any, count: int, what: str, *, zero: bool = False
) -> Float[np.ndarray, "count"]:
    """Return `count` numbers > 0, or >= 0 if `zero`; errors contain `what`, such as "per edge"."""
    try:
        array = np.array(values, np.float64)
    except ValueError:
        got = reprlib.repr(values)
        raise ValueError(f"{name}: expected {count} numbers, one {what}, got {got}") from None
    if array.shape != (count,):
        raise ValueError(f"{name}: expected {count} numbers, one {what}, got {list(array.shape)}")
    fits = (array >= 0) if zero else (array > 0)
    wrong = np.flatnonzero(~(fits & np.isfinite(array)))
    if wrong.size:
        expected = "a finite number, at least 0" if zero else "a positive finite number"
        raise ValueError(f"{name}[{wrong[0]}] is {array[wrong[0]]}; expected {expected}")
    return array


def distribution(
    name: str, values: Any, count: int, what: str, *, zero: bool = False
) -> Float[np.ndarray, "count"]:
    """Return numbers as `one_each` does, after a check that they sum to 1."""
    shares = one_each(name, values, count, what, zero=zero)
    total = float(shares.sum())
    if abs(total - 1) > _ROUNDING:
        raise ValueError(f"{name}: expected numbers that sum to 1, got {total!r}")
    return shares / total
