"""The description of one quantity of a result: meaning, units, dimensions and kind."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias


Kind: TypeAlias = Literal[
    "cell", "coordinate", "count", "distribution", "extent", "flag", "index", "number",
    "place", "position", "residual", "share", "text", "time",
]  # fmt: skip
"""Kind of a quantity, which determines its format and its checks.

- `share`: a number from 0 to 1. `distribution`: shares that sum to 1 over the dimensions in the
    attribute `over` (by default the last dimension).
- `count`: whole numbers from 0. `index`: whole numbers from -1, which stands for "no index".
- `cell`, `position`: an `index` of a cell or a position of the result's `cells`.
- `place`: a position that is written as a point in metres.
- `extent`: the length of a set of possible places; infinite if all places are possible.
- `time`: not negative; may be infinite. `flag`: true or false.
- `residual`: error of a solver. `coordinate`: labels of a dimension. `text`: words, or an
    enumeration. `number`: any other number.
"""


PADDING = {"index": -1, "text": ""}
"""The values, by kind, that fill short rows of a list of lists."""


@dataclasses.dataclass(frozen=True)
class Quantity:
    """The description of one quantity of a result."""

    dims: tuple[str, ...]
    "The dimensions of the array; empty for a single number or text."
    meaning: str
    "A noun phrase: the `long_name` in datasets and the label in tables."
    units: str | None
    kind: Kind
    listed: bool
    """If true, the summary includes the array: with one dimension as a list, and with two as a
    column in the table of the first. Each entry of this column is a list, without its
    [`PADDING`][jaxcell.base.quantities.PADDING]."""
    attributes: Mapping[str, Any]
    "Further attributes of the variable in datasets."

    @property
    def label(self) -> str:
        """The units as a label; empty for a quantity without units."""
        return "" if self.units in (None, "1") else str(self.units)


def quantity(
    dims: str,
    meaning: str,
    units: str | None = None,
    *,
    kind: Kind = "number",
    listed: bool = False,
    **attributes: Any,
) -> Quantity:
    """Describe a field of a result, in an annotation: `Annotated[float, quantity("", ...)]`.

    **Arguments:**

    - `dims`: the names of the dimensions, separated by spaces.
    - `meaning`: a noun phrase.
    - `units`: units as in the CF conventions, such as `m`, `s`, `rad`, or `None`.
    - `kind`: a [`Kind`][].
    - `listed`: if true, the summary includes the array; see [`Quantity`][].
    - further keywords: attributes of the variable in datasets.
    """
    return Quantity(tuple(dims.split()), meaning, units, kind, listed, attributes)
