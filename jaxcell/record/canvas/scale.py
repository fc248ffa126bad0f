"""Colour scales, which convert numbers to classes of a picture, with their legends."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Num, UInt8

from .palette import CLEAR, Color, Level, PictureClass, ramp


LEVELS = 32
# A picture has 255 classes; the rest is for special classes.
_MOST_LEVELS = 250
_LEGEND_ROWS = 5


@dataclasses.dataclass(frozen=True, eq=False)
class Scale:
    """A scale of colours for numbers, which are divided into levels.

    In a picture, class 0 is the background. Next come the special classes, in the order of
    `special` and with the colours given there, and then one class per level.
    """

    bounds: Float[np.ndarray, "bounds"]
    "The ends of the levels, ascending; numbers outside belong to the first or the last level."
    label: Callable[[str], str] = "{}".format
    'A function that formats the label of a number or range, such as `"{} h".format`.'
    special: Mapping[str, Color] = dataclasses.field(default_factory=dict)
    "The meanings and colours of special classes, which are not levels."
    ground: str = "not free"
    digits: int = 3
    open: bool = False
    "If true, the legend shows that the last level includes all larger numbers."
    whole: bool = False
    "If true, all numbers are whole, so a level with the bounds 2 and 5 has the label `2 to 4`."

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
        """Create a scale over the range of the finite values.

        `least` and `most` replace the ends of the range. `spaced` is a function that computes the
        bounds of the levels, such as `numpy.geomspace`. Further keywords are fields of the scale.
        """
        finite = values[np.isfinite(values)]
        low = float(finite.min(initial=np.inf)) if least is None else least
        high = float(finite.max(initial=-np.inf)) if most is None else most
        low, high = (low, high) if low <= high else (0.0, 0.0)
        # Equal ends would make levels of width 0.
        high = max(high, low + max(1e-6, 1e-9 * abs(low)))
        return cls(spaced(low, high, levels + 1), label, **about)

    @classmethod
    def counting(
        cls,
        least: int,
        most: int,
        label: Callable[[str], str] = "{}".format,
        *,
        levels: int = _MOST_LEVELS,
        **about: Any,
    ) -> "Scale":
        """Create a scale of the whole numbers from `least` to `most`, with at most `levels` levels.

        The other arguments are those of [`Scale.over`][].
        """
        most = max(least, most)
        share = -(-(most - least + 1) // levels)
        bounds = np.append(np.arange(least, most + 1, share), most + 1).astype(float)
        return cls(bounds, label, whole=True, **about)

    @property
    def colors(self) -> list[Color]:
        rows = ramp(np.linspace(0, 1, self.bounds.size - 1)).tolist()
        return [(red, green, blue) for red, green, blue in rows]

    @property
    def classes(self) -> list[PictureClass]:
        ground = [(self.ground, CLEAR), *self.special.items()]
        named = zip(map(self._range, range(len(self.colors))), self.colors, strict=True)
        return [PictureClass(*one) for one in (*ground, *named)]

    def levels(
        self,
        values: Num[np.ndarray, "*shape"],
        special: Mapping[str, Bool[np.ndarray, "*shape"]] | None = None,
    ) -> UInt8[np.ndarray, "*shape"]:
        """Return the class of each number.

        `special` maps the meaning of each special class to a mask. If masks overlap, the last mask
        applies. A NaN outside of all masks gets the last level.
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
        """Return at most `rows` levels, the largest first, and the special classes in `shown`.

        By default all special classes are shown.
        """
        colors = self.colors
        last = len(colors) - 1
        name, ends = (self._range, last) if self.whole else (self._bound, last + 1)
        at = np.unique(np.linspace(0, ends, rows).round().astype(int))[::-1].tolist()
        # Levels with equal texts become one entry.
        entries = {name(i): colors[min(i, last)] for i in at}
        names = self.special if shown is None else shown
        levels = [Level(*entry) for entry in entries.items()]
        return levels + [(name, self.special[name]) for name in names]

    def _bound(self, number: int) -> str:
        more = " or more" if self.open and number == self.bounds.size - 1 else ""
        return self.label(self._written(self.bounds[number])) + more

    def _range(self, level: int) -> str:
        low, high = self.bounds[level], self.bounds[level + 1] - self.whole
        if self.open and level == self.bounds.size - 2:
            return f"{self.label(self._written(low))} or more"
        if self.whole and low == high:
            return self.label(self._written(low))
        return self.label(f"{self._written(low)} to {self._written(high)}")

    def _written(self, value: float) -> str:
        large = 1000 <= abs(value) < 1e9
        return f"{value:,.0f}" if large else f"{value:z.{self.digits}g}"
