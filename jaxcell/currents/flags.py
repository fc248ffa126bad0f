"""Bad and missing values: quality flags, and gaps in time such as those of a radar."""

import dataclasses
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Shaped

from .conventions import table
from .masks import flag_meanings, read_part
from .netcdf import OceanFile


LEAST_PRESENT = 0.8
"""The least share of the records at which a cell must have a velocity to count as water."""

_BAD, _GOOD = {"bad", "fail", "failed", "suspect", "questionable", "missing"}, {"good", "pass"}


@dataclasses.dataclass(frozen=True)
class Flag:
    """A variable that marks bad values of a velocity."""

    name: str
    bad: dict[float, str]
    "The values that mark bad data, with their meanings; empty if the file gives no meanings."

    def at(
        self, file: OceanFile, block: Mapping[Any, Any], dims: tuple[str, str, str]
    ) -> Bool[np.ndarray, "#levels #y #x"]:
        """Mark the bad values in the `block` of indices, with dimensions in the order `dims`."""
        return np.isin(read_part(file, self.name, block, dims), list(self.bad))

    @property
    def note(self) -> str:
        """A note on the values that are left out, or the reason why all values are used."""
        if not self.bad:
            return f"{self.name}: its values have no flag_meanings; the flag is ignored"
        words = ", ".join(f"{value:g} ({meaning})" for value, meaning in self.bad.items())
        return f"{self.name}: values with {words} are left out"


def read_flags(file: OceanFile, velocity: str) -> list[Flag]:
    """Find the flags of a velocity by its attributes or by name; words tell their bad values."""
    variables = file.dataset.variables
    attributes = variables[velocity].attrs
    named = re.split(r"[\s,]+", str(attributes.get("ancillary_variables", "")).strip())
    known = {str(name).lower(): str(name) for name in variables}
    usual = (name.format(velocity.lower()) for row in table("flag") for name in row.names)
    names = [known[name] for name in (*map(str.lower, named), *usual) if name in known]
    flags = []
    for name in dict.fromkeys(names):
        about = variables[name].attrs
        meanings = flag_meanings(about)
        if not set(variables[name].dims) <= set(variables[velocity].dims):
            continue
        words = {value: set(re.findall("[a-z]+", text.lower())) for value, text in meanings.items()}
        bad = {v: meanings[v] for v, w in words.items() if w & _BAD and not w & _GOOD}
        mute = not meanings and "flag" in " ".join([str(about.get("standard_name", "")), *about])
        if bad or mute:
            flags.append(Flag(name, bad))
    return flags


def fill_gaps(
    values: Float[np.ndarray, "records *cells"],
    present: Bool[np.ndarray, "records *cells"],
    times: Shaped[np.ndarray, " records"],
    cells: Bool[np.ndarray, "*cells"],
) -> None:
    """Fill in, by interpolation in time, the values of the marked `cells` that are not `present`.

    A gap at the beginning or at the end gets the nearest known value of the cell.
    """
    seconds = (times - times[0]) / np.timedelta64(1, "s")
    for cell in zip(*np.nonzero(cells), strict=True):
        at = (slice(None), *cell)
        known = present[at]
        values[at] = np.interp(seconds, seconds[known], values[at][known])
