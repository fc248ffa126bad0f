"""The parameters of a sweep as axes, and what is shown of its results along them."""

import dataclasses

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int


QUANTILES = {"least": 0.0, "quarter": 0.25, "median": 0.5, "three quarters": 0.75, "most": 1.0}
_NUMBERS = ("member", "sample")
_EXACT_DIGITS, _MOST_DIGITS = 6, 12
_MOST_LETTERS = 16


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
    told: str
    "What a time of the timeline is, in words."

    @property
    def steps(self) -> int:
        return self.times.size

    @property
    def number(self) -> bool:
        """Whether it only counts the members of a list or the samples."""
        return self.name in _NUMBERS


def axes(dataset: xr.Dataset, most: int) -> list[Axis]:
    """The axes of a sweep: parameters of a grid, those along a list or samples, then its number.

    **Arguments:**

    - `dataset`: the result of a sweep.
    - `most`: how many steps an axis may have. Of more values, neighbours share a step.
    """
    found = []
    for dimension in map(str, dataset["status"].dims):
        names = [str(name) for name, one in dataset.coords.items() if one.dims == (dimension,)]
        for name in names:
            found.append(_axis(name, dimension, dataset[name].values, most))
    return sorted(found, key=lambda axis: axis.number)


def pairs(some: list[Axis], most: int) -> list[tuple[Axis, Axis]]:
    """Pairs of axes that span a picture, across and up; those whose squares are many come first."""
    found = [
        (a, b)
        for i, a in enumerate(some)
        for b in some[i + 1 :]
        # The number of a sample says nothing of its own parameters.
        if a.dimension != b.dimension or not (a.number or b.number)
    ]
    # A dimension of one value has nothing to compare.
    found = [(a, b) for a, b in found if a.steps > 1 and b.steps > 1]
    found.sort(key=lambda pair: pair[0].number or pair[1].number)
    return [(a, b) if a.steps >= b.steps else (b, a) for a, b in found[:most]]


def statistics(
    values: Float[np.ndarray, "*sizes"],
    known: Bool[np.ndarray, "*sizes"],
    place: int,
    axis: Axis,
) -> tuple[Int[np.ndarray, "shown"], Float[np.ndarray, "quantiles shown"], bool]:
    """Quantiles of the members of each step of an axis.

    **Arguments:**

    - `values`: the numbers of all members.
    - `known`: which of them count.
    - `place`: which dimension of `values` is that of the axis.
    - `axis`: the axis.

    **Returns:** the steps that have members, their `QUANTILES`, and whether each has one only.
    """
    step = _along(axis, place, values.shape)[known]
    number = values[known]
    order = np.lexsort((number, step))
    number = number[order]
    count = np.bincount(step, minlength=axis.steps)
    shown = np.flatnonzero(count)
    first = (np.cumsum(count) - count)[shown]
    last = count[shown] - 1
    rows = []
    for quantile in QUANTILES.values():
        low = np.floor(quantile * last).astype(int)
        share = quantile * last - low
        high = np.minimum(low + 1, last)
        rows.append(number[first + low] * (1 - share) + number[first + high] * share)
    return shown, np.array(rows), bool((last == 0).all())


def means(
    values: Float[np.ndarray, "*sizes"],
    known: Bool[np.ndarray, "*sizes"],
    places: tuple[int, int],
    pair: tuple[Axis, Axis],
) -> Float[np.ndarray, "up across"]:
    """The mean of the members of each step of two axes, across and up; NaN where are none."""
    across, up = pair
    square = _along(up, places[1], values.shape) * across.steps
    square = (square + _along(across, places[0], values.shape))[known]
    size = across.steps * up.steps
    count = np.bincount(square, minlength=size)
    total = np.bincount(square, weights=values[known], minlength=size)
    mean = np.divide(total, count, out=np.full(size, np.nan), where=count > 0)
    return mean.reshape(up.steps, across.steps)


def _along(axis: Axis, place: int, shape: tuple[int, ...]) -> Int[np.ndarray, "*sizes"]:
    """The step of each member."""
    one = axis.step.reshape([-1 if i == place else 1 for i in range(len(shape))])
    return np.broadcast_to(one, shape)


def _axis(name: str, dimension: str, values: np.ndarray, most: int) -> Axis:
    numeric = values.dtype.kind in "iuf"
    if numeric:
        known, at = np.unique(values, return_inverse=True)
        labels = [f"{value:.6g}" for value in known.tolist()]
    else:
        # In the order of the specification.
        texts = [str(value) for value in values.tolist()]
        labels = list(dict.fromkeys(texts))
        order = {text: i for i, text in enumerate(labels)}
        at = np.array([order[text] for text in texts])
        known = np.arange(len(labels))
    share = -(-known.size // most)
    first = known[::share]
    times, digits = _scaled(first) if numeric else (first, 0)
    if not numeric or digits is None:
        timeline, told = f"{name} number", "the number of the value, from 0"
        times = np.arange(first.size)
    elif digits:
        timeline, told = f"{name} x {10**digits}", f"the value times {10**digits}"
    else:
        timeline, told = name, "the value"
    if share > 1:
        told += f"; {share} neighbouring values share a step, at the first of them"
    shortened = tuple(_short(text) for text in labels[::share])
    return Axis(
        name, dimension, timeline, times.astype(np.int64), shortened, at.reshape(-1) // share, told
    )


def _scaled(values: np.ndarray) -> tuple[np.ndarray, int | None]:
    """Whole numbers in proportion to different values, and how many decimal digits they took.

    They are exact where six digits do, and else rounded to the fewest digits that tell the values
    apart, at least four.
    """
    largest = float(np.abs(values).max())
    for exact, most in (True, _EXACT_DIGITS), (False, _MOST_DIGITS):
        for digits in range(most + 1):
            scaled = values * 10.0**digits
            whole = np.rint(scaled)
            if largest * 10.0**digits >= 2**53:
                break
            if exact:
                fits = np.allclose(scaled, whole, rtol=0, atol=1e-6)
            else:
                fits = largest * 10.0**digits >= 1e4
            if fits and np.unique(whole).size == values.size:
                return whole, digits
    return values, None


def _short(text: str) -> str:
    return text if len(text) <= _MOST_LETTERS else "..." + text[3 - _MOST_LETTERS :]
