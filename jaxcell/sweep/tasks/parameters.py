"""How tasks read their parameters, from the batch or from the fixed values alike."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np


_NEEDED = object()
Parsed = TypeVar("Parsed")


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A parameter of a task."""

    read: Callable[[Any], Any]
    "Checks a value and gives what the task wants of it; raises `ValueError` that says what."
    default: Any = _NEEDED
    "Value where none is given; without it the parameter has to be given."
    file: bool = False
    "Whether values are names of files."


def members(
    task: str,
    parameters: Mapping[str, Parameter],
    batch: Mapping[str, np.ndarray],
    fixed: Mapping[str, Any],
) -> list[dict[str, Any]]:
    """The parameters of each member of a batch.

    **Raises:** `ValueError` that names a parameter that is not known, missing, or wrong.
    """
    known = ", ".join(parameters)
    for name in [*batch, *fixed]:
        if name not in parameters:
            raise ValueError(f"{name}: expected a parameter of {task!r}, one of {known}")
    columns = {}
    length = len(next(iter(batch.values())))
    for name, parameter in parameters.items():
        if name in batch:
            values = batch[name].tolist()
        elif name in fixed:
            values = [fixed[name]] * length
        elif parameter.default is _NEEDED:
            raise ValueError(f"{name}: {task!r} needs it; expected it among {known}")
        else:
            columns[name] = [parameter.default] * length
            continue
        # A value that many share is read once.
        read: dict[str, Any] = {}
        for value in values:
            if repr(value) not in read:
                try:
                    read[repr(value)] = parameter.read(value)
                except ValueError as error:
                    raise ValueError(f"{name}: expected {error}, got {value!r}") from None
        columns[name] = [read[repr(value)] for value in values]
    return [dict(zip(columns, one, strict=True)) for one in zip(*columns.values(), strict=True)]


def whole(least: int, most: int = 2**31 - 1) -> Callable[[Any], int]:
    """Reads a whole number in a range."""

    def read(value: Any) -> int:
        known = isinstance(value, int | float) and not isinstance(value, bool)
        if not known or value != value or not least <= value <= most or int(value) != value:
            raise ValueError(f"a whole number from {least} to {most}")
        return int(value)

    return read


def number(what: str, fits: Callable[[float], bool]) -> Callable[[Any], float]:
    """Reads a finite number that fits."""

    def read(value: Any) -> float:
        known = isinstance(value, int | float) and not isinstance(value, bool)
        if not known or not np.isfinite(value) or not fits(value):
            raise ValueError(what)
        return float(value)

    return read


def one_of(*choices: str) -> Callable[[Any], str]:
    """Reads one of some words."""

    def read(value: Any) -> str:
        if value not in choices:
            raise ValueError(" or ".join(map(repr, choices)))
        return str(value)

    return read


def text(value: Any) -> str:
    """Reads a text."""
    if not isinstance(value, str) or not value:
        raise ValueError("a text")
    return value


def numbers(value: Any) -> tuple[float, ...]:
    """Reads a list of finite numbers, at least one."""
    some = value if isinstance(value, list | tuple) else [value]
    read = number("", lambda _: True)
    try:
        found = tuple(read(one) for one in some)
    except ValueError:
        found = ()
    if not found:
        raise ValueError("one finite number or more")
    return found


angle = number("a finite number of degrees", lambda _: True)
