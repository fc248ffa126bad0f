"""Quantities: what a result says of each of its numbers, once, where it is defined.

A result is a dataclass whose fields are annotated with a [`quantity`][], or computed from others
by a method under [`derived`][]. Its dataset, its JSON, its tables in the terminal, the variables of
a sweep over it and the checks of its numbers all follow from these descriptions.

Two robots that share a corridor:

    >>> import dataclasses
    >>> from typing import Annotated
    >>> import numpy as np
    >>> from jaxcell.base.quantities import Result, derived, quantities, quantity
    >>> @dataclasses.dataclass(frozen=True, eq=False)
    ... class Shared(Result):
    ...     time: Annotated[np.ndarray, quantity("robot", "time in the corridor", "s")]
    ...
    ...     @derived("", "longest time in the corridor", "s")
    ...     def longest(self) -> float:
    ...         return float(self.time.max())
    ...
    >>> {name: one.units for name, one in quantities(Shared).items()}
    {'time': 's', 'longest': 's'}
    >>> Shared(np.array([3.0, 5.0])).longest
    5.0
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Literal, TypeAlias


Kind: TypeAlias = Literal[
    "coordinate",
    "count",
    "distribution",
    "flag",
    "index",
    "number",
    "position",
    "residual",
    "share",
    "time",
]
"""What numbers are, which decides how they are shown, and what is checked of them.

- `share`: from 0 to 1. `distribution`: shares that sum to 1 over the last dimensions, those that
    the attribute `over` names (by default the last one).
- `count`: whole numbers from 0. `index`: whole numbers from -1, which stands for none.
- `position`: the index of a position on the cells of the result, shown with its place in metres.
- `time`: not negative, or infinite. `flag`: true or false.
- `residual`: what a solve leaves. `coordinate`: labels of a dimension. `number`: any other.
"""


@dataclasses.dataclass(frozen=True)
class Quantity:
    """The description of one quantity of a result."""

    dims: tuple[str, ...]
    "The dimensions of its array; none for a single number or text."
    meaning: str
    "What it is, as a noun phrase; the `long_name` of datasets and the label of tables."
    units: str | None
    kind: Kind
    listed: bool
    """Whether an array is listed in the summary: one of one dimension under its own name, one of
    two in the rows of the table of its first dimension, without the -1 that pad an index."""
    attributes: Mapping[str, Any]
    "More attributes of its variable in datasets."


def quantity(
    dims: str,
    meaning: str,
    units: str | None = None,
    *,
    kind: Kind = "number",
    listed: bool = False,
    **attributes: Any,
) -> Quantity:
    """Describe a field of a result, in its annotation: `Annotated[float, quantity("", ...)]`.

    **Arguments:**

    - `dims`: the names of its dimensions, with spaces between them.
    - `meaning`: what it is, as a noun phrase.
    - `units`: as CF has them: `m`, `s`, `rad`; none for what has no dimension.
    - `kind`: a [`Kind`][].
    - `listed`: whether an array that is not part of the summary anyway is listed there.
    - further keywords: attributes of its variable in datasets.
    """
    return Quantity(tuple(dims.split()), meaning, units, kind, listed, attributes)


class derived(functools.cached_property):  # noqa: N801 - used as a decorator, like a property
    """Describe a quantity that a method computes from the fields, when it is first asked for.

    The arguments are those of [`quantity`][].
    """

    def __init__(self, *description: Any, **more: Any) -> None:
        self.quantity = quantity(*description, **more)

    def __call__(self, method: Callable[[Any], Any]) -> Any:
        super().__init__(method)
        return self


class Result:
    """What a study gives: a base for dataclasses with described quantities.

    A field that is a result itself is a part of it: its summary stands below the name of the field,
    and its variables begin with that name, those that label dimensions apart. A field `cells` gives
    datasets their coordinates.
    """

    title: ClassVar[str] = ""
    "What datasets are called."
    tables: ClassVar[Mapping[str, str]] = {}
    "Dimensions whose quantities make a table, and the names of these tables in the summary."

    @property
    def answered(self) -> bool:
        """Whether the question has an answer: a path was found, say."""
        return True

    def checks(self) -> "Checks":
        """Relations between quantities that hold, beside what their kinds say."""
        return {}


# Sums of some 10^6 probabilities are good to 1e-10, and so are the solves behind them.
PROBABILITY = 1e-8

Checks: TypeAlias = Mapping[str, tuple[float | int, float | int]]
"""By name: the value of a check, and its limit; `inf` to report it without a limit."""


def quantities(result: type) -> dict[str, Quantity]:
    """The described quantities of a class of results: coordinates, and then in their order.

    **Arguments:**

    - `result`: a dataclass.

    **Returns:** the description of each, by name.
    """
    fields = {
        field.name: described
        for field in dataclasses.fields(result)
        for described in getattr(field.type, "__metadata__", ())
        if isinstance(described, Quantity)
    }
    methods = {
        name: value.quantity
        for kind in reversed(result.__mro__)
        for name, value in vars(kind).items()
        if isinstance(value, derived)
    }
    found = fields | methods
    return dict(sorted(found.items(), key=lambda item: item[1].kind != "coordinate"))


def values(result: Any) -> dict[str, tuple[Quantity, Any]]:
    """The quantities that a result has, with their values; those that are missing are left out."""
    described = (
        (name, one, getattr(result, name)) for name, one in quantities(type(result)).items()
    )
    return {name: (one, value) for name, one, value in described if value is not None}


def parts(result: Any) -> dict[str, Any]:
    """The fields of a result that are results themselves."""
    fields = ((field.name, getattr(result, field.name)) for field in dataclasses.fields(result))
    return {name: value for name, value in fields if isinstance(value, Result)}


def flat(result: Any, prefix: str = "") -> dict[str, tuple[Quantity, Any]]:
    """The quantities of a result and of its parts, whose names begin with that of the part."""
    found = {
        name if about.kind == "coordinate" else prefix + name: (about, value)
        for name, (about, value) in values(result).items()
    }
    for name, part in parts(result).items():
        found |= flat(part, f"{prefix}{name}_")
    return found


def columns(result: Any, dim: str) -> dict[str, tuple[Quantity, Any]]:
    """The quantities in the table over a dimension.

    Labels in radians are not: programs need those, and people have degrees beside them.
    """
    return {
        name: (about, value)
        for name, (about, value) in values(result).items()
        if about.dims[:1] == (dim,)
        and (len(about.dims) == 2 if about.listed else len(about.dims) == 1)
        and not (about.kind == "coordinate" and about.units == "rad")
    }
