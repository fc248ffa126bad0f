"""The parameters of a sweep as axes, and what is shown of its results along them."""

import dataclasses

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float, Int

from ..canvas.timeline import along_values


QUANTILES = {"least": 0.0, "quarter": 0.25, "median": 0.5, "three quarters": 0.75, "most": 1.0}
_NUMBERS = ("member", "sample")
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
    first = names[::share]
    labels = [f"{one:.6g}" if numeric else one for one in first.tolist()]
    timeline, times, meaning = along_values(name, first)
    if share > 1:
        meaning += f"; {share} neighbouring values share a step, at the first of them"
    short = tuple(map(_short, labels))
    return Axis(name, dimension, timeline, times, short, at.ravel() // share, meaning)


def _short(text: str) -> str:
    return text if len(text) <= _MAX_LETTERS else "..." + text[3 - _MAX_LETTERS :]
