"""Check arrays, and whole numbers, such as those that refer to cells, actions or phases."""

from collections.abc import Sequence
from numbers import Number
from typing import Any

import jax
import numpy as np


def as_array(values: Any, name: str, instead: str = "") -> np.ndarray | jax.Array:
    """Convert an array, a list or a number to an array whose bytes are in the order of the machine.

    **Raises:** `ValueError` that begins with `name` and ends with `instead` for other values, for
    lists of different lengths, and for things other than numbers.
    """
    if isinstance(values, jax.Array):
        return values
    got = type(values).__name__
    if hasattr(values, "__array__") or isinstance(values, Sequence | Number):
        try:
            array = np.asarray(values)
        except ValueError:
            got = "lists of different lengths"
        else:
            if array.dtype.kind in "biufc":
                return array.astype(array.dtype.newbyteorder("="), copy=False)
            got = str(array.dtype) if array.ndim else got
    raise ValueError(f"{name}: expected an array of numbers, got {got}{instead}")


def check_indices(
    values: Any, count: int, name: str, noun: str = "cell", instead: str = ""
) -> np.ndarray | jax.Array:
    """Return whole numbers as an array, after checking that they are from 0 to `count - 1`.

    Traced arrays have no values, so only their type is checked.

    **Arguments:** an array, a list or a number; how many things there are; the name of the
    argument, with which errors begin; what a number refers to; and advice.
    """
    array = values if isinstance(values, jax.Array) else np.asarray(values)
    if not array.size:
        return array.astype(np.int32)
    if not np.issubdtype(array.dtype, np.integer):
        named = "; the number of a named vertex is list(graph).index(name)"
        raise ValueError(
            f"{name}: expected whole numbers of {noun}s, got {array.dtype}"
            f"{named if array.dtype.kind in 'UO' else ''}"
        )
    array = as_array(array, name)
    if not isinstance(array, jax.core.Tracer):
        # Values stay on an accelerator; on a CPU NumPy needs no compilation.
        away = isinstance(array, jax.Array) and any(d.platform != "cpu" for d in array.devices())
        here = array if away else np.asarray(array)
        if here.min() < 0 or here.max() >= count:
            place = np.argwhere((here < 0) | (here >= count))[0]
            at = f"[{', '.join(map(str, place))}]" if place.size else ""
            raise ValueError(
                f"{name}{at}: {noun} {here[tuple(place)]} does not exist; {noun}s are 0 to "
                f"{count - 1}{instead}"
            )
    return array


def check_whole(name: str, value: Any, least: int = 0) -> int:
    """Return a whole number; raise `ValueError` if it is another value, or less than `least`."""
    try:
        number = None if isinstance(value, str | bytes) else int(value)
    except (TypeError, ValueError, OverflowError):
        number = None
    if number is None or number != value or number < least:
        raise ValueError(f"{name}: expected a whole number from {least}, got {value!r}")
    return number
