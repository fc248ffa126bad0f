"""Quantities: descriptions of the numbers of a result, each written once, at its definition.

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
import enum
import functools
import importlib
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, ClassVar, Literal, TypeAlias


Kind: TypeAlias = Literal[
    "cell",
    "coordinate",
    "count",
    "distribution",
    "flag",
    "index",
    "number",
    "place",
    "position",
    "residual",
    "share",
    "text",
    "time",
]
"""Kind of a quantity, which decides its format and its checks.

- `share`: from 0 to 1. `distribution`: shares that sum to 1 over the last dimensions, those that
    the attribute `over` names (by default the last one).
- `count`: whole numbers from 0. `index`: whole numbers from -1, which stands for none.
- `cell`, `position`: an `index` of a cell or a position of the result's `cells`.
- `place`: a position that a summary gives with its place in metres.
- `time`: not negative, or infinite. `flag`: true or false.
- `residual`: error of a solve. `coordinate`: labels of a dimension. `text`: words, or an
    enumeration. `number`: any other.
"""


@dataclasses.dataclass(frozen=True)
class Quantity:
    """The description of one quantity of a result."""

    dims: tuple[str, ...]
    "The dimensions of its array; none for a single number or text."
    meaning: str
    "A noun phrase: the `long_name` in datasets and the label in tables."
    units: str | None
    kind: Kind
    listed: bool
    """If true, the summary lists a one-dimensional array under its own name, and a two-dimensional
    array in the rows of the table of its first dimension, without the -1 that pad an index."""
    attributes: Mapping[str, Any]
    "More attributes of its variable in datasets."

    @property
    def label(self) -> str:
        """The units as a label for people; empty for a quantity without units."""
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
    """Describe a field of a result, in its annotation: `Annotated[float, quantity("", ...)]`.

    **Arguments:**

    - `dims`: the names of its dimensions, with spaces between them.
    - `meaning`: a noun phrase.
    - `units`: units as in CF, such as `m`, `s`, `rad`; `None` without units.
    - `kind`: a [`Kind`][].
    - `listed`: whether a one-dimensional array is part of the summary by itself, or an array of
        more dimensions part of the rows of a table.
    - further keywords: attributes of its variable in datasets.
    """
    return Quantity(tuple(dims.split()), meaning, units, kind, listed, attributes)


class derived(functools.cached_property):  # noqa: N801 - used as a decorator, like a property
    """Describe a quantity that a method computes from the fields, at its first use.

    The arguments are those of [`quantity`][jaxcell.base.quantities.quantity].
    """

    def __init__(self, *description: Any, **more: Any) -> None:
        self.quantity = quantity(*description, **more)

    def __call__(self, method: Callable[[Any], Any]) -> Any:
        super().__init__(method)
        return self


def from_part(path: str, *description: Any, **more: Any) -> Any:
    """Describe a quantity that is an attribute of a part, such as `deployment.cells`.

    Without the part the result does not have the quantity.

    **Arguments:**

    - `path`: the names of the part and its attribute, with a dot between them.
    - further arguments: those of [`quantity`][jaxcell.base.quantities.quantity].
    """

    def value(result: Any) -> Any:
        for name in path.split("."):
            result = None if result is None else getattr(result, name)
        return result

    return derived(*description, **more)(value)


class Result:
    """A base for the results of studies: dataclasses with described quantities.

    A field may be a result. In the summary it stands below the name of the field, and in datasets
    the names of its variables, except labels of dimensions, begin with the name of the field. A
    field may be a tuple of results, such as `layers`: a list in the summary, and in datasets
    variables `layer_...` along a dimension `layer`. A field `cells` gives the coordinates of
    datasets.
    """

    title: ClassVar[str] = ""
    "The title of datasets."
    leading: ClassVar[tuple[str, ...]] = ()
    "Names of the quantities that answer the question; summaries begin with them."
    brief: ClassVar[tuple[str, ...]] = ()
    """Names of the quantities, and dimensions of the tables, that are enough for a terminal; by
    default all."""
    tables: ClassVar[Mapping[str, str]] = {}
    """Dimensions whose quantities make a table, and the names of these tables in the summary: the
    column of a quantity `deployment_lon` in a table `deployment` is `lon`."""
    picture: ClassVar[str] = ""
    "The quantity that `plot` draws by default, where it is not the first with a map."

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        # A dataclass would otherwise print all its arrays.
        cls.__repr__ = Result.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        """List the numbers that are known without computing any, and the names of arrays."""
        from .formatting import format_value

        described = quantities(type(self))
        known = {
            name: _stored(vars(self)[name])
            for name in described
            if vars(self).get(name) is not None
        }
        lines = [f"<{type(self).__name__}: {self.title or 'a part of a result'}>"]
        for name, value in known.items():
            if is_single(described[name]):
                lines.append(f"    {name}: {format_value(value, described[name])}")
        arrays = [name for name, about in described.items() if about.dims and name in known]
        return "\n".join([*lines, *([f"    arrays: {', '.join(arrays)}"] if arrays else [])])

    def _repr_html_(self) -> str:
        """Describe the result in a notebook."""
        return str(_figures("html").html(self))

    def plot(self, name: str | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw a quantity with matplotlib, as [`jaxcell.record.plot`][] does."""
        return _figures("plot").plot(self, name, ax=ax, **options)

    @property
    def answered(self) -> bool:
        """If false, the question has no answer; for example, no path was found."""
        return True

    @property
    def quiet(self) -> tuple[str, ...]:
        """Names of parts that a terminal does not show; files and JSON have them."""
        return ()

    @property
    def answer(self) -> tuple[str, ...]:
        """Sentences that answer the question, for people; the most important first."""
        return ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences with limits of the answer, for people who rely on it."""
        return ()

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Attributes of the datasets, in addition to the provenance."""
        return {}

    def checks(self) -> "Checks":
        """Checks of relations between quantities, in addition to the checks of their kinds."""
        return {}


def _figures(module: str) -> ModuleType:
    """Import a module that draws results, which is on a higher floor, when it is needed."""
    return importlib.import_module(f"jaxcell.record.figures.{module}")


# Sums of 10^6 probabilities are accurate to 1e-10, and so are the solves that give them.
PROBABILITY = 1e-8

Checks: TypeAlias = Mapping[str, tuple[float | int, float | int]]
"""Value and limit of each check, by name; the limit `inf` reports a value without a limit."""


def quantities(result: type) -> dict[str, Quantity]:
    """Find the described quantities of a class of results.

    Coordinates come first, then the leading quantities, then the others in their order.

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
    described = fields | methods
    leading = getattr(result, "leading", ())
    places = {name: place - len(leading) for place, name in enumerate(leading)}
    return dict(
        sorted(
            described.items(),
            key=lambda item: (item[1].kind != "coordinate", places.get(item[0], 0)),
        )
    )


def values(
    result: Any, wanted: Callable[[Quantity], bool] = lambda _: True
) -> dict[str, tuple[Quantity, Any]]:
    """Compute the quantities of a result; quantities of `None` are left out.

    A member of an enumeration becomes its name in lower case. Zeros have no sign, because the sign
    may depend on the processor.

    **Arguments:**

    - `result`: the result.
    - `wanted`: selects quantities; the values of others are not computed.
    """
    named_values = {}
    for name, one in quantities(type(result)).items():
        value = getattr(result, name) if wanted(one) else None
        if value is not None:
            named_values[name] = one, _stored(value)
    return named_values


def _stored(value: Any) -> Any:
    """Replace a member of an enumeration by its name, and take the sign off zeros."""
    return unsigned(value.name.lower() if isinstance(value, enum.Enum) else value)


def unsigned(value: Any) -> Any:
    """Remove the sign of zeros. Other values stay as they are.

    The minimum of `0.0` and `-0.0` may be either, depending on the processor.
    """
    if isinstance(value, float):
        return value + 0.0
    if getattr(getattr(value, "dtype", None), "kind", "") != "f":
        return value
    import numpy as np

    # Only an array that has such zeros is copied.
    return value + 0.0 if (np.signbit(value) & (value == 0)).any() else value


def summarized(result: Any) -> dict[str, tuple[Quantity, Any]]:
    """Compute the quantities of a summary: single, listed, or columns of a table."""
    return values(
        result,
        lambda one: (
            not one.dims or one.listed or (len(one.dims) == 1 and one.dims[0] in result.tables)
        ),
    )


def parts(result: Any) -> dict[str, Any]:
    """Get the fields of a result that are results or tuples of results."""
    fields = ((field.name, getattr(result, field.name)) for field in dataclasses.fields(result))
    return {
        name: value
        for name, value in fields
        if isinstance(value, Result)
        or (isinstance(value, tuple) and value and all(isinstance(one, Result) for one in value))
    }


def is_single(about: Quantity) -> bool:
    """Check whether a quantity is an entry of the summary: a number, a text, or a short list."""
    return not about.dims or (about.listed and len(about.dims) == 1)


def columns(result: Any) -> dict[str, dict[str, tuple[Quantity, Any]]]:
    """Compute the columns of the tables of a result, by the dimension of the table.

    Labels in radians are left out: programs need them, and people have degrees beside them.
    """
    tables: dict[str, dict[str, tuple[Quantity, Any]]] = {dim: {} for dim in result.tables}
    for name, (about, value) in summarized(result).items():
        dim = about.dims[0] if about.dims else ""
        label = about.kind == "coordinate" and about.units == "rad"
        if dim in tables and (len(about.dims) == 1) != about.listed and not label:
            tables[dim][name] = (about, value)
    return tables
