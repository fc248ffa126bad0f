"""Quantities describe the numbers of a result: meaning, units, dimensions and kind.

A result is a dataclass. Its fields are annotated with a [`quantity`][]; methods decorated with
[`derived`][] compute more quantities. These descriptions determine datasets, JSON, tables in the
terminal, variables of sweeps, and checks of numbers.

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
import textwrap
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias, TypeVar, overload

from .formatting import format_value
from .quantity import PADDING as PADDING, Kind as Kind, Quantity as Quantity, quantity as quantity
from .shown import Pictured


if TYPE_CHECKING:
    import numpy as np


Value = TypeVar("Value")
_Whole: TypeAlias = Literal["cell", "count", "index", "position"]
_InArrays: TypeAlias = _Whole | Literal["distribution", "flag", "residual", "share", "time"]
# Number of numbers in the text of a result, and the width of its last line.
_NUMBERS, _WIDTH = 3, 96


class derived(functools.cached_property[Any]):  # noqa: N801 - a decorator, like a property
    """Decorate a method as a quantity, whose value the method computes once, at the first use.

    The arguments are those of [`quantity`][jaxcell.base.quantities.quantity].
    """

    def __init__(self, *description: Any, **more: Any) -> None:
        self.quantity = quantity(*description, **more)

    def __call__(self, method: Callable[[Any], Value]) -> functools.cached_property[Value]:
        super().__init__(method)
        return self


@overload
def from_part(
    path: str, dims: Literal[""], *description: Any, kind: _Whole, **more: Any
) -> functools.cached_property[int | Any]: ...
@overload
def from_part(
    path: str, dims: str, *description: Any, kind: _InArrays, **more: Any
) -> "functools.cached_property[np.ndarray | Any]": ...
@overload
def from_part(path: str, *description: Any, **more: Any) -> Any: ...
def from_part(path: str, *description: Any, **more: Any) -> Any:
    """Describe a quantity that is an attribute of a field of a result, as in `deployment.cells`.

    If the field is `None`, the result does not have the quantity; otherwise type checkers know the
    type of numbers and arrays from the dimensions and the kind. The arguments after `path` are
    those of [`quantity`][jaxcell.base.quantities.quantity].
    """

    def value(result: Any) -> Any:
        for name in path.split("."):
            result = None if result is None else getattr(result, name)
        return result

    return derived(*description, **more)(value)


class Result(Pictured):
    """The base class of results of studies: dataclasses with described quantities.

    A field may itself be a result, which is called a part. In the summary, a part is an object. In
    datasets, the names of the part's variables begin with the name of the field, but the names of
    its coordinates do not. A tuple of results, such as the field `layers`, is a list in the
    summary; in datasets its numbers are variables `layer_...` along a dimension `layer`. If a field
    `cells` is a cell space, datasets have its coordinates.
    """

    title: ClassVar[str] = ""
    "The title of datasets."
    leading: ClassVar[tuple[str, ...]] = ()
    "Names of the quantities that answer the question of the study; summaries begin with them."
    brief: ClassVar[tuple[str, ...]] = ()
    "The quantities, and the dimensions of tables, that a terminal shows; if empty, all of them."
    tables: ClassVar[Mapping[str, str]] = {}
    """Names of the tables in the summary, keyed by the dimension of their quantities. In a table
    `deployment` the column of a quantity `deployment_lon` is named `lon`."""
    picture: ClassVar[str] = ""
    "The quantity that `plot` draws by default; if empty, the first quantity on a map."

    def __repr__(self) -> str:
        """List the first numbers that are already computed, and the names of arrays."""
        described = quantities(type(self))
        known = {
            name: _stored(vars(self)[name])
            for name in described
            if vars(self).get(name) is not None
        }
        numbers = [
            f"{name}: {format_value(value, described[name])}"
            for name, value in known.items()
            if is_single(described[name])
        ]
        arrays = [name for name, about in described.items() if about.dims and name in known]
        rest = [f"{len(numbers) - _NUMBERS} more numbers"] if numbers[_NUMBERS:] else []
        rest += [f"arrays: {', '.join(arrays)}"] if arrays else []
        last = [textwrap.shorten("; ".join(rest), _WIDTH, placeholder=" ...")] if rest else []
        head = f"<{type(self).__name__}: {self.title or 'a part of a result'}>"
        return "\n    ".join([head, *numbers[:_NUMBERS], *last])

    @property
    def answered(self) -> bool:
        """False if the question has no answer; for example, if no path was found."""
        return True

    @property
    def quiet(self) -> tuple[str, ...]:
        """Names of the parts that a terminal does not show; files and JSON include them."""
        return ()

    @property
    def answer(self) -> tuple[str, ...]:
        """Sentences that answer the question; the most important sentence is first."""
        return ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences about the limitations of the answer."""
        return ()

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Attributes of the dataset of this result, in addition to the provenance."""
        return {}

    def checks(self) -> "Checks":
        """Return the checks of this class; the kind of each quantity determines further checks."""
        return {}


# Tolerance for probabilities: sums of 10^6 of them, and solvers, are accurate to 1e-10.
PROBABILITY = 1e-8

Checks: TypeAlias = Mapping[str, tuple[float | int, float | int]]
"""The value of each check and the largest value that is accepted, keyed by the name of the check.
If this limit is `inf`, the value is only reported."""


def quantities(result: type) -> dict[str, Quantity]:
    """Find the description of each quantity of a result class, keyed by name.

    Coordinates come first, then the leading quantities, then the other quantities in the order of
    their definition.
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
    result: Any, wanted: Callable[[str, Quantity], bool] = lambda *_: True
) -> dict[str, tuple[Quantity, Any]]:
    """Compute the quantities of a result that `wanted` selects and that are not `None`.

    Members of enumerations become names in lower case. Zeros become positive, because their sign
    may depend on the processor.
    """
    named_values = {}
    for name, one in quantities(type(result)).items():
        value = getattr(result, name) if wanted(name, one) else None
        if value is not None:
            named_values[name] = one, _stored(value)
    return named_values


def _stored(value: Any) -> Any:
    """Replace a member of an enumeration by its name, and remove the sign of zeros."""
    return unsigned(value.name.lower() if isinstance(value, enum.Enum) else value)


def unsigned(value: Any) -> Any:
    """Remove the sign of zeros; leave other values unchanged.

    The sign may depend on the processor: the minimum of `0.0` and `-0.0` may be either of them.
    """
    if isinstance(value, float):
        return value + 0.0
    if getattr(getattr(value, "dtype", None), "kind", "") != "f":
        return value
    import numpy as np

    # Copy an array only if it has negative zeros.
    return value + 0.0 if (np.signbit(value) & (value == 0)).any() else value


def summarized(result: Any) -> dict[str, tuple[Quantity, Any]]:
    """Compute the quantities in a result's summary: single numbers, lists, and table columns."""
    return values(
        result,
        lambda _, one: (
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
    """Check whether a quantity is one entry of the summary: a number, a text, or a list."""
    return not about.dims or (about.listed and len(about.dims) == 1)


def columns(result: Any) -> dict[str, dict[str, tuple[Quantity, Any]]]:
    """Compute the columns of each table of a result, keyed by the dimension of the table.

    Coordinates in radians are left out because tables also have them in degrees.
    """
    tables: dict[str, dict[str, tuple[Quantity, Any]]] = {dim: {} for dim in result.tables}
    for name, (about, value) in summarized(result).items():
        dim = about.dims[0] if about.dims else ""
        label = about.kind == "coordinate" and about.units == "rad"
        if dim in tables and (len(about.dims) == 1) != about.listed and not label:
            tables[dim][name] = (about, value)
    return tables
