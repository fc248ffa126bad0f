"""Which values are no measurements: those with a bad flag, and the gaps of a radar."""

import dataclasses
import re

import numpy as np
from jaxtyping import Bool, Float, Shaped

from .conventions import table
from .masks import flag_meanings, part
from .netcdf import OceanFile


# A cell with a velocity at so many of the records is water, and what is missing is interpolated.
LEAST_PRESENT = 0.8

_BAD, _GOOD = {"bad", "fail", "failed", "suspect", "questionable", "missing"}, {"good", "pass"}


@dataclasses.dataclass(frozen=True)
class Flag:
    """A variable that says of each value of a velocity whether it is good.

    **Attributes:**

    - `name`: of the variable.
    - `bad`: its values that stand for what is not, with their meanings; none if it gives no
        meanings.
    """

    name: str
    bad: dict[float, str]

    def at(
        self, file: OceanFile, block: dict[str, object], dims: tuple[str, str, str]
    ) -> Bool[np.ndarray, "#levels #y #x"]:
        """Where a value is bad, on a part of the dimensions of the velocity."""
        own = {dim: where for dim, where in block.items() if dim in file.dataset[self.name].dims}
        return np.isin(file.read(part(file, self.name, own), dims), list(self.bad))

    @property
    def note(self) -> str:
        """What was left out, or why nothing was."""
        if not self.bad:
            return f"{self.name}: its values have no flag_meanings, and are not heeded"
        words = ", ".join(f"{value:g} ({meaning})" for value, meaning in self.bad.items())
        return f"{self.name}: values with {words} are left out"


def read_flags(file: OceanFile, velocity: str) -> list[Flag]:
    """Find the flags of a velocity: those that it names, and those with the names of conventions.

    Those that are bad are said by `flag_meanings`, a word for each value.
    """
    variables = file.dataset.variables
    attributes = variables[velocity].attrs
    named = re.split(r"[\s,]+", str(attributes.get("ancillary_variables", "")).strip())
    known = {str(name).lower(): str(name) for name in variables}
    usual = (name.format(velocity.lower()) for row in table("flag") for name in row.names)
    names = [known[name] for name in (*map(str.lower, named), *usual) if name in known]
    found = []
    for name in dict.fromkeys(names):
        about = variables[name].attrs
        meanings = flag_meanings(about)
        if not set(variables[name].dims) <= set(variables[velocity].dims):
            continue
        words = {value: set(re.findall("[a-z]+", text.lower())) for value, text in meanings.items()}
        bad = {v: meanings[v] for v, said in words.items() if said & _BAD and not said & _GOOD}
        mute = not meanings and "flag" in " ".join([str(about.get("standard_name", "")), *about])
        if bad or mute:
            found.append(Flag(name, bad))
    return found


def fill_gaps(
    values: Float[np.ndarray, "records *cells"],
    present: Bool[np.ndarray, "records *cells"],
    times: Shaped[np.ndarray, " records"],
    cells: Bool[np.ndarray, "*cells"],
) -> None:
    """Interpolate in time what is missing in some cells; before the first and after the last value
    of a cell, that holds.

    **Arguments:**

    - `values`: to be filled, in place.
    - `present`: where there is a value.
    - `times`: of the records.
    - `cells`: those to be filled.
    """
    seconds = (times - times[0]) / np.timedelta64(1, "s")
    for cell in zip(*np.nonzero(cells), strict=True):
        here = (slice(None), *cell)
        there = present[here]
        values[here] = np.interp(seconds, seconds[there], values[here][there])
