"""The parameters of a sweep as axes, and what is shown of its results along them."""

import dataclasses

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float, Int


QUANTILES = {"least": 0.0, "quarter": 0.25, "median": 0.5, "three quarters": 0.75, "most": 1.0}
_NUMBERS = ("member", "sample")
_EXACT_DIGITS, _MAX_DIGITS = 6, 12
_MAX_LETTERS = 16


@dataclasses.dataclass(frozen=True, eq=False)
class Axis:
    """A parameter along which results are shown, in steps of a value or of a few neighbours."""

    name: str
    dimension: str
    timeline: str
    "Name of its timeline, which says how times follow from values."
    times: Int[np.ndarray, "steps"]
    labels: tuple[str, ...]
    "The value of each step, the first of it if it has several."
    step: Int[np.ndarray, "places"]
    "The step of each place along the dimension."
    meaning: str
    "What a time of the timeline is."

    @property
    def steps(self) -> int:
        return self.times.size

    @property
    def number(self) -> bool:
        """Whether it only counts the members of a list or the samples."""
        return self.name in _NUMBERS

    def along(self, place: int, shape: tuple[int, ...]) -> Int[np.ndarray, "*sizes"]:
        """The step of each member, where the dimension of the axis is at a place of the shape."""
        one = self.step.reshape([-1 if i == place else 1 for i in range(len(shape))])
        return np.broadcast_to(one, shape)


def axes(dataset: xr.Dataset, most: int) -> list[Axis]:
    """List the axes of a sweep: parameters of a grid, those along a list or samples, its number.

    **Arguments:**

    - `dataset`: the result of a sweep.
    - `most`: how many steps an axis may have. Of more values, neighbours share a step.
    """
    found = [
        _axis(str(name), str(dimension), one.values, most)
        for dimension in dataset["status"].dims
        for name, one in dataset.coords.items()
        if one.dims == (dimension,)
    ]
    return sorted(found, key=lambda axis: axis.number)


def pairs(some: list[Axis], most: int) -> list[tuple[Axis, Axis]]:
    """Pairs of axes that span a picture, across and up; those whose squares are many come first."""
    found = [
        (a, b)
        for i, a in enumerate(some)
        for b in some[i + 1 :]
        # The number of a sample says nothing of its own parameters, and one value compares nothing.
        if (a.dimension != b.dimension or not b.number) and min(a.steps, b.steps) > 1
    ]
    found.sort(key=lambda pair: pair[1].number)
    return [(a, b) if a.steps >= b.steps else (b, a) for a, b in found[:most]]


def statistics(
    values: Float[np.ndarray, "*sizes"], known: Bool[np.ndarray, "*sizes"], place: int, axis: Axis
) -> tuple[Int[np.ndarray, "shown"], Float[np.ndarray, "quantiles shown"], bool]:
    """Quantiles of the members of each step of an axis.

    **Arguments:**

    - `values`: the numbers of all members.
    - `known`: which of them count.
    - `place`: which dimension of `values` is that of the axis.
    - `axis`: the axis.

    **Returns:** the steps that have members, their `QUANTILES`, and whether each has one only.
    """
    members = pd.Series(values[known]).groupby(axis.along(place, values.shape)[known])
    rows = members.quantile([*QUANTILES.values()]).unstack()
    table = rows.to_numpy().reshape(len(rows), len(QUANTILES))
    return rows.index.to_numpy(int), table.T, bool((members.size() < 2).all())


def means(
    values: Float[np.ndarray, "*sizes"],
    known: Bool[np.ndarray, "*sizes"],
    places: tuple[int, int],
    pair: tuple[Axis, Axis],
) -> Float[np.ndarray, "up across"]:
    """The mean of the members of each step of two axes, across and up; NaN where there are none."""
    across, up = pair
    square = up.along(places[1], values.shape) * across.steps
    square = (square + across.along(places[0], values.shape))[known]
    mean = pd.Series(values[known]).groupby(square).mean()
    return mean.reindex(range(up.steps * across.steps)).to_numpy().reshape(up.steps, across.steps)


def _axis(name: str, dimension: str, values: np.ndarray, most: int) -> Axis:
    numeric = values.dtype.kind in "iuf"
    if numeric:
        known, at = np.unique(values, return_inverse=True)
        names = known
    else:
        # In the order of the specification.
        at, names = pd.factorize(values.astype(str))
        known = np.arange(len(names))
    share = -(-known.size // most)
    first = known[::share]
    labels = [f"{one:.6g}" if numeric else one for one in names[::share].tolist()]
    times, digits = _scaled(first) if numeric else (first, None)
    if digits is None:
        timeline, meaning = f"{name} number", "the number of the value, from 0"
        times = np.arange(first.size)
    elif digits:
        timeline, meaning = f"{name} x {10**digits}", f"the value times {10**digits}"
    else:
        timeline, meaning = name, "the value"
    if share > 1:
        meaning += f"; {share} neighbouring values share a step, at the first of them"
    short = tuple(map(_short, labels))
    return Axis(name, dimension, timeline, times.astype(int), short, at.ravel() // share, meaning)


def _scaled(values: np.ndarray) -> tuple[np.ndarray, int | None]:
    """Whole numbers in proportion to different values, and how many decimal digits they took.

    They are exact where six digits do, and else rounded to the fewest digits that
    distinguish the values, at least four.
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


def _short(text: str) -> str:
    return text if len(text) <= _MAX_LETTERS else "..." + text[3 - _MAX_LETTERS :]
