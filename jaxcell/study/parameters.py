"""Annotations of the parameters of a study, and the checks that they require.

An annotation gives the unit and the limits of a parameter, and conditions on other parameters:

    >>> import dataclasses
    >>> from typing import Annotated
    >>> from jaxcell.study import Limit, Only
    >>> from jaxcell.study.parameters import check
    >>> @dataclasses.dataclass(frozen=True, kw_only=True)
    ... class Throw:
    ...     stones: Annotated[int, Limit(ge=1)] = 1
    ...     wind: bool = False
    ...     gust: Annotated[float, Limit(ge=0, le=30), Only(wind=True)] = 0.0
    >>> check(Throw(wind=True, gust=40.0))
    Traceback (most recent call last):
    ValueError: gust: expected 0 to 30, got 40
    >>> check(Throw(gust=3.0))
    Traceback (most recent call last):
    ValueError: gust: it has an effect only with `wind`
"""

import dataclasses
import enum
import functools
import math
import numbers
from collections.abc import Iterator, Mapping, Sequence
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeAlias,
    TypeVar,
    get_origin,
    get_type_hints,
)

from ..base.formatting import did_you_mean


Kind = TypeVar("Kind")
Headings: TypeAlias = Mapping[str, tuple[str, ...]]
"""Names of parameters by the heading of the help page under which they are."""


class Count(enum.Enum):
    """A condition on the number of values of a parameter, for `Only`."""

    ONE = "one"
    SEVERAL = "several"


@dataclasses.dataclass(frozen=True)
class Unit:
    """The unit of a parameter. `Study.spec` adds `suffix` to a parameter's name, as in `cell_m`."""

    suffix: str
    word: str
    "The unit in error messages."


@dataclasses.dataclass(frozen=True, kw_only=True)
class Limit:
    """The bounds of a parameter: at least `ge`, more than `gt`, at most `le`, less than `lt`.

    >>> from jaxcell.study import Limit
    >>> str(Limit(ge=1)), str(Limit(gt=0, le=1)), str(Limit(ge=2, le=1000))
    ('at least 1', 'more than 0 and at most 1', '2 to 1,000')
    """

    ge: int | float | None = None
    gt: int | float | None = None
    le: int | float | None = None
    lt: int | float | None = None

    def __str__(self) -> str:
        if self.ge is not None and self.le is not None:
            return f"{_number(self.ge)} to {_number(self.le)}"
        words = {"at least": self.ge, "more than": self.gt, "at most": self.le}
        words["less than"] = self.lt
        return " and ".join(f"{name} {_number(at)}" for name, at in words.items() if at is not None)

    def check(self, parameter: str, value: int | float | None, after: str = "") -> None:
        """Raise `ValueError` for a number that is beyond the bounds, or not finite.

        The error begins with the name of the parameter. The text `after`, such as a unit, follows
        the bounds. `None` is accepted.
        """
        if value is None:
            return
        holds = math.isfinite(value)
        holds = holds and (self.ge is None or value >= self.ge)
        holds = holds and (self.gt is None or value > self.gt)
        holds = holds and (self.le is None or value <= self.le)
        holds = holds and (self.lt is None or value < self.lt)
        if not holds:
            raise ValueError(f"{parameter}: expected {self}{after}, got {value:g}")


def _number(value: int | float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:g}"


class Only:
    """A condition on other parameters. Unless it is met, a parameter must keep its default value.

    `Only(strategy="capture", base=False)` is met with that strategy and without a base. `True`
    stands for any value except the default, `False` for the default, a `Count` for any values of
    this number, and a tuple for alternatives. If a parameter has several conditions, it is enough
    that one is met.
    """

    def __init__(self, **values: Any) -> None:
        self.values = values

    def holds(self, options: Any) -> bool:
        """Return whether the parameters of a study or options of a command meet the condition."""
        default = {field.name: field.default for field in dataclasses.fields(options)}
        for name, wanted in self.values.items():
            value = getattr(options, name)
            if isinstance(wanted, bool):
                met = (value != default[name]) is wanted
            elif isinstance(wanted, Count):
                met = (len(value) > 1) is (wanted is Count.SEVERAL)
            else:
                met = value in (wanted if isinstance(wanted, tuple) else (wanted,))
            if not met:
                return False
        return True

    def __str__(self) -> str:
        chosen = {name: wanted for name, wanted in self.values.items() if wanted is not False}
        absent = [f"`{name}`" for name, wanted in self.values.items() if wanted is False]
        parts = [
            f"with {wanted.value} `{name}`"
            if isinstance(wanted, Count)
            else f"with `{name}`" + ("" if wanted is True else f" {listed(wanted)}")
            for name, wanted in chosen.items()
        ]
        if absent:
            parts.append(f"without {listed(tuple(absent))}")
        return " and ".join(parts)


class Needed(Only):
    """An `Only` for a parameter that must have a value if the condition is met."""


def listed(values: Any) -> str:
    """Format several values as `a, b or c`."""
    texts = [str(value) for value in (values if isinstance(values, tuple) else (values,))]
    return " or ".join(filter(None, (", ".join(texts[:-1]), texts[-1])))


AtLeastOne: TypeAlias = Annotated[int, Limit(ge=1)]
WholeNumber: TypeAlias = Annotated[int, Limit(ge=0)]
Share: TypeAlias = Annotated[float, Limit(ge=0, le=1)]
Days: TypeAlias = Annotated[float, Unit("d", "days")]
Degrees: TypeAlias = Annotated[float, Unit("deg", "degrees")]
Metres: TypeAlias = Annotated[float, Unit("m", "m")]
Seconds: TypeAlias = Annotated[float, Unit("s", "s")]
if TYPE_CHECKING:
    Pose: TypeAlias = str | int | Sequence[float]
    """A cell, or a pose or place as a text or as numbers."""
else:
    Pose = str
# mypy takes it for true, and has no descriptors in frozen dataclasses.
MYPY = False
if MYPY:
    Angles: TypeAlias = tuple[Degrees, ...]
elif TYPE_CHECKING:
    import numpy as np

    class Angles:
        """Angles in degrees: one or several go in, and a tuple comes out."""

        def __get__(self, study: object, kind: type | None = None) -> tuple[float, ...]: ...
        def __set__(self, study: object, angles: float | Sequence[float] | np.ndarray) -> None: ...
else:
    Angles = tuple[Degrees, ...]
Length: TypeAlias = Annotated[Metres, Limit(gt=0)]
Duration: TypeAlias = Annotated[Seconds, Limit(gt=0)]


def parameters(options: type) -> dict[str, Any]:
    """Return the parameters of a study, or the options of a command, with their annotations."""
    hints = get_type_hints(options, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(options)}


def inside(annotation: Any) -> Iterator[Any]:
    """Yield an annotation and, recursively, all its type arguments."""
    yield annotation
    for part in getattr(annotation, "__args__", ()):
        yield from inside(part)


def choices_and_types(annotation: Any) -> tuple[list[Any], list[type]]:
    """List the choices in an annotation, and the types that are no containers."""
    parts = [*inside(annotation)]
    choices = [one for part in parts if get_origin(part) is Literal for one in part.__args__]
    types = [part for part in parts if isinstance(part, type) or part is Any]
    return choices, [kind for kind in types if get_origin(kind) is None and kind is not tuple]


def within(annotation: Any, kind: type[Kind]) -> Kind | None:
    """Return the first `Annotated` metadata of type `kind` in a type or its type arguments."""
    notes = (note for part in inside(annotation) for note in getattr(part, "__metadata__", ()))
    return next((note for note in notes if isinstance(note, kind)), None)


@functools.cache
def conditions(options: Any) -> dict[str, list[Only]]:
    """Return the alternative conditions of each parameter that has any."""
    notes = {
        name: [note for note in getattr(hint, "__metadata__", ()) if isinstance(note, Only)]
        for name, hint in parameters(options).items()
    }
    return {name: alternatives for name, alternatives in notes.items() if alternatives}


def without_effect(options: Any) -> list[str]:
    """Return the parameters that have no effect, because none of their conditions is met."""
    kind: Any = type(options)
    return [
        name
        for name, alternatives in conditions(kind).items()
        if not any(condition.holds(options) for condition in alternatives)
    ]


@functools.cache
def _limits(options: Any) -> dict[str, tuple[Limit, str]]:
    found = {}
    for name, hint in parameters(options).items():
        unit = within(hint, Unit)
        if (limit := within(hint, Limit)) is not None:
            found[name] = limit, "" if unit is None else f" {unit.word}"
    return found


@functools.cache
def _kinds(options: Any) -> dict[str, tuple[frozenset[type], tuple[Any, ...]]]:
    """Return the plain types and the choices of each parameter that takes nothing else."""
    found = {}
    for name, hint in parameters(options).items():
        choices, types = choices_and_types(hint)
        kinds = frozenset(types)
        plain = kinds <= {int, float, bool, type(None)}
        if plain and (kinds - {type(None)} or choices):
            found[name] = kinds, tuple(choices)
    return found


def _check_kind(parameter: str, value: Any, kinds: frozenset[type], choices: Any) -> None:
    if isinstance(value, tuple):
        for part in value:
            _check_kind(parameter, part, kinds - {type(None)}, choices)
        return
    whole = isinstance(value, numbers.Integral)
    fits = {float: isinstance(value, numbers.Real), int: whole, bool: False, type(None): False}
    fits = {bool: True} if isinstance(value, bool) else fits
    fits = {type(None): True} if value is None else fits
    if any(fits.get(kind, False) for kind in kinds) or (
        isinstance(value, str | int) and value in choices
    ):
        return
    nouns = {float: "a number", int: "a whole number", bool: "True or False"}
    expected = listed((*choices, *(noun for kind, noun in nouns.items() if kind in kinds)))
    meant = did_you_mean(str(value), map(str, choices))
    raise ValueError(f"{parameter}: expected {expected}, got {value!r}{meant}")


def check(options: Any) -> None:
    """Raise `ValueError` if a parameter has a wrong type, is out of range, idle or missing."""
    kind: Any = type(options)
    for name, about in _kinds(kind).items():
        _check_kind(name, getattr(options, name), *about)
    for name, (limit, unit) in _limits(kind).items():
        value = getattr(options, name)
        for number in value if isinstance(value, tuple) else (value,):
            if not isinstance(number, str):
                limit.check(name, number, unit)
    default = {field.name: field.default for field in dataclasses.fields(options)}
    for name in default:
        value = getattr(options, name)
        if default[name] is dataclasses.MISSING and isinstance(value, tuple) and not value:
            raise ValueError(f"{name}: expected at least one value, got none")
    one_of = getattr(options, "one_of", ())
    if one_of and all(getattr(options, name) == default[name] for name in one_of):
        raise ValueError(f"expected one of {listed(tuple(f'`{name}`' for name in one_of))}")
    idle = without_effect(options)
    for name, alternatives in conditions(kind).items():
        given = getattr(options, name) != default[name]
        if name in idle and given:
            raise ValueError(
                f"{name}: it has an effect only {', or '.join(map(str, alternatives))}"
            )
        for condition in alternatives:
            if isinstance(condition, Needed) and condition.holds(options) and not given:
                raise ValueError(f"{name}: it is needed {condition}")
