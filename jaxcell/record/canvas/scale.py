"""Numbers as colours: the classes of a picture, the class of each number, and the legend."""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from .palette import CLEAR, Color, Level, PictureClass, ramp


LEVELS = 32
_LEGEND_ROWS = 5


@dataclasses.dataclass(frozen=True, eq=False)
class Scale:
    """A ramp of colours over levels of numbers, and colours for what is not a number.

    Class 0 of a picture is its ground, the next are the special ones in their order, and from there
    on each level has a class.
    """

    bounds: Float[np.ndarray, "bounds"]
    "The ends of the levels, ascending; numbers outside belong to the first or the last."
    label: Callable[[str], str] = "{}".format
    'What a number or a range means, given how it is written: `"{} h".format`.'
    special: Mapping[str, Color] = dataclasses.field(default_factory=dict)
    "The meanings and colours of squares without a level."
    ground: str = "not free"
    digits: int = 3
    open: bool = False
    "Whether the legend says that the last level holds all larger numbers."
    whole: bool = False
    "Whether levels are of whole numbers, each from its bound to before the next."

    @classmethod
    def over(
        cls,
        values: Float[np.ndarray, "*values"],
        label: Callable[[str], str] = "{}".format,
        *,
        levels: int = LEVELS,
        least: float | int | None = None,
        most: float | int | None = None,
        spaced: Callable[[float, float, int], np.ndarray] = np.linspace,
        **about: Any,
    ) -> "Scale":
        """The scale over the range of some numbers, or between given ends.

        **Arguments:**

        - `values`: the numbers; those that are not finite are passed over.
        - `levels`: how many.
        - `least`, `most`: the ends, instead of those of the numbers.
        - `spaced`: how bounds lie between the ends, `numpy.linspace` or `numpy.geomspace`.
        - `label`, and further keywords: the other fields.
        """
        finite = values[np.isfinite(values)]
        low = float(finite.min(initial=np.inf)) if least is None else least
        high = float(finite.max(initial=-np.inf)) if most is None else most
        low, high = (low, high) if low <= high else (0.0, 0.0)
        # A range of nothing has no levels.
        high = max(high, low + max(1e-6, 1e-9 * abs(low)))
        return cls(spaced(low, high, levels + 1), label, **about)

    @property
    def colors(self) -> list[Color]:
        """The colour of each level."""
        rows = ramp(np.linspace(0, 1, self.bounds.size - 1)).tolist()
        return [(red, green, blue) for red, green, blue in rows]

    @property
    def classes(self) -> list[PictureClass]:
        """The classes of a picture."""
        named = [PictureClass(self.ground, CLEAR)]
        named += [PictureClass(*one) for one in self.special.items()]
        ends = itertools.pairwise(self.bounds.tolist())
        for (low, high), color in zip(ends, self.colors, strict=True):
            named.append(PictureClass(self.label(self._range(low, high - self.whole)), color))
        if self.open:
            last = self._or_more(self.bounds[-2])
            named[-1] = PictureClass(last, named[-1].color)
        return named

    def levels(
        self,
        values: Float[np.ndarray, "*shape"],
        special: Mapping[str, Bool[np.ndarray, "*shape"]] | None = None,
    ) -> UInt8[np.ndarray, "*shape"]:
        """The class of each number.

        **Arguments:**

        - `values`: the numbers.
        - `special`: by its meaning, where a special class stands; later ones win.
        """
        level = np.searchsorted(self.bounds[1:-1], values, side="right")
        kind = 1 + len(self.special) + level
        names = list(self.special)
        for name, where in (special or {}).items():
            kind = np.where(where, 1 + names.index(name), kind)
        return kind.astype(np.uint8)

    def legend(
        self, rows: int = _LEGEND_ROWS, shown: Sequence[str] | None = None
    ) -> list[tuple[str, Color]]:
        """What some levels mean, the largest first, and what the special colours do.

        **Arguments:**

        - `rows`: how many levels.
        - `shown`: the special ones that are part of it; by default all.
        """
        count = self.bounds.size - 1
        at = np.unique(np.linspace(0, count, rows).round().astype(int))[::-1].tolist()
        # Levels of a range of nothing are written alike.
        entries = {
            self._or_more(self.bounds[i])
            if self.open and i == count
            else self.label(self._written(float(self.bounds[i]))): self.colors[min(i, count - 1)]
            for i in at
        }
        names = self.special if shown is None else shown
        levels = [Level(*entry) for entry in entries.items()]
        return levels + [(name, self.special[name]) for name in names]

    def _or_more(self, value: float) -> str:
        return f"{self.label(self._written(float(value)))} or more"

    def _range(self, low: float, high: float) -> str:
        if self.whole and low == high:
            return self._written(low)
        return f"{self._written(low)} to {self._written(high)}"

    def _written(self, value: float) -> str:
        large = 1000 <= abs(value) < 1e9
        return f"{value:,.0f}" if large else f"{value:.{self.digits}g}"


def ramp_legend(label: str, most: float, rows: int) -> list[tuple[str, Color]]:
    """What the colours of a ramp mean: so many numbers down from the largest to 0.

    **Arguments:**

    - `label`: how a number is written, as for `str.format`.
    """
    shares = np.linspace(1, 0, rows)
    colors = zip(shares.tolist(), ramp(shares).tolist(), strict=True)
    return [
        Level(label.format(most * one), (red, green, blue)) for one, (red, green, blue) in colors
    ]
