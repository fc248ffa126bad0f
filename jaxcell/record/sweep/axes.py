"""The parameters of a sweep as axes, and statistics of results along these axes."""

import dataclasses

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float, Int

from ..canvas.timeline import Timeline, along_values


QUANTILES = {"least": 0.0, "quarter": 0.25, "median": 0.5, "three quarters": 0.75, "most": 1.0}
_NUMBERS = ("member", "sample")
_MAX_LETTERS = 16


@dataclasses.dataclass(frozen=True, eq=False)
class Axis:
    """A parameter of a sweep as an axis.

    A step of the axis stands for one value or, if there are too many values, for several adjacent
    values.
    """

    name: str
    dimension: str
    timeline: Timeline
    labels: tuple[str, ...]
    "The text of each step: its value or, if it stands for several values, the first of them."
    step: Int[np.ndarray, "places"]
    "The step to which each index along `dimension` belongs."

    @property
    def steps(self) -> int:
        return len(self.labels)

    @property
    def number(self) -> bool:
        """True if the axis is the index of members or samples, not a parameter."""
        return self.name in _NUMBERS

    def along(self, place: int, shape: tuple[int, ...]) -> Int[np.ndarray, "*sizes"]:
        """Return the step of this axis for each array element; the axis is dimension `place`."""
        step = self.step.reshape([-1 if i == place else 1 for i in range(len(shape))])
        return np.broadcast_to(step, shape)


def axes(dataset: xr.Dataset, most: int) -> list[Axis]:
    """List the axes of a sweep: first its parameters, then the indices of list members or samples.

    An axis has at most `most` steps. If there are more values, adjacent values share a step.
    """
    all_axes = [
        _axis(str(name), str(dimension), values.values, most)
        for dimension in dataset["status"].dims
        for name, values in dataset.coords.items()
        if values.dims == (dimension,)
    ]
    return sorted(all_axes, key=lambda axis: axis.number)


def pairs(all_axes: list[Axis], most: int) -> list[tuple[Axis, Axis]]:
    """List at most `most` pairs of axes for pictures; the first axis of a pair has more steps.

    Both axes have at least two steps. The index of members or samples is only paired with
    parameters along other dimensions, and these pairs come last.
    """
    spanned = [
        (a, b)
        for i, a in enumerate(all_axes)
        for b in all_axes[i + 1 :]
        if (a.dimension != b.dimension or not b.number) and min(a.steps, b.steps) > 1
    ]
    spanned.sort(key=lambda pair: pair[1].number)
    return [(a, b) if a.steps >= b.steps else (b, a) for a, b in spanned[:most]]


def statistics(
    values: Float[np.ndarray, "*sizes"], known: Bool[np.ndarray, "*sizes"], place: int, axis: Axis
) -> tuple[Int[np.ndarray, "shown"], Float[np.ndarray, "quantiles shown"], bool]:
    """Compute quantiles of the values where `known` is true, at each step of an axis.

    The axis is the dimension `place` of the arrays. **Returns:** the steps with known values, the
    `QUANTILES` at these steps, and `True` if each step has only one value.
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
    """Compute the mean of values where `known` is true, at each pair of steps; NaN without values.

    The axes of the pair are the dimensions `places` of the arrays.
    """
    across, up = pair
    square = up.along(places[1], values.shape) * across.steps
    square = (square + across.along(places[0], values.shape))[known]
    mean = pd.Series(values[known]).groupby(square).mean()
    return mean.reindex(range(up.steps * across.steps)).to_numpy().reshape(up.steps, across.steps)


def _axis(name: str, dimension: str, values: np.ndarray, most: int) -> Axis:
    numeric = values.dtype.kind in "iuf"
    # Texts keep the order of the specification.
    at, names = pd.factorize(values if numeric else values.astype(str), sort=numeric)
    share = -(-names.size // most)
    first = names[::share]
    labels = [f"{value:.6g}" if numeric else value for value in first.tolist()]
    timeline = along_values(name, first)
    if share > 1:
        shared = f"; {share} neighbouring values share a step, at the first of them"
        timeline = timeline._replace(meaning=timeline.meaning + shared)
    short = tuple(
        label if len(label) <= _MAX_LETTERS else "..." + label[3 - _MAX_LETTERS :]
        for label in labels
    )
    return Axis(name, dimension, timeline, short, at // share)
