"""The vocabulary of the errors of robots, which all studies share: `run=2% turn=1deg`."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, TypeAlias

import tyro

from ..base.formatting import did_you_mean
from ..base.units import number_of
from .parameters import Limit
from .study import about


if TYPE_CHECKING:
    ErrorTexts: TypeAlias = str | Sequence[str] | Mapping[str, float | str]
else:
    ErrorTexts = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE [NAME=VALUE ...]")]
_UNITS = {
    "bump_skid": "m",
    "bump_turn": "deg",
    "displacement": "m",
    "distance": "m",
    "heading": "deg",
    "late": "m",
    "run": "share",
    "slip": "share",
    "turn": "deg",
}


def read_errors(texts: ErrorTexts, known: Sequence[str], needed: str = "") -> dict[str, float]:
    """Parse errors `NAME=VALUE`. Returns lengths in metres, shares from 0 to 1, angles in radians.

    **Raises:** `ValueError` for a name that is not `known`, for a value that is not a number with a
    suitable unit, or without an error with the name `needed`.
    """
    errors = {}
    for text in (texts,) if isinstance(texts, str) else texts:
        if not isinstance(text, str):
            raise ValueError(f"errors: expected NAME=VALUE, such as {known[0]}=1, got {text!r}")
        name, _, value = text.partition("=")
        parameter = f"errors {text!r}"
        if name not in known:
            names, meant = ", ".join(known), did_you_mean(name.lower(), known)
            raise ValueError(f"{parameter}: expected NAME=VALUE, a name of {names}{meant}")
        if name in errors:
            raise ValueError(f"{parameter}: {name} is given twice")
        unit = _UNITS[name]
        with about(parameter):
            number = number_of(value, unit)
        if unit == "share":
            Limit(ge=0, le=1).check(parameter, number)
        errors[name] = math.radians(number) if unit == "deg" else number
    if needed and needed not in errors:
        raise ValueError(f"errors: expected {needed}=VALUE among them")
    return errors
