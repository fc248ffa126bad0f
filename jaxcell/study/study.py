import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias, TypeVar, get_type_hints

from ..base.bundled import bundled
from ..base.paths import existing, name_in_results
from ..base.quantities import Result


if TYPE_CHECKING:
    from ..verify import Comparison


Kind = TypeVar("Kind")


@dataclasses.dataclass(frozen=True)
class Unit:
    """The unit of a parameter; its name in a specification ends in the suffix."""

    suffix: str


@dataclasses.dataclass(frozen=True)
class Limit:
    """What a parameter is to be: each of its numbers is refused otherwise, and unless finite."""

    expected: str
    "In words, for the error."
    holds: Callable[[float], bool]


AtLeastOne: TypeAlias = Annotated[int, Limit("at least 1", lambda n: n >= 1)]
Days: TypeAlias = Annotated[float, Unit("d")]
Degrees: TypeAlias = Annotated[float, Unit("deg")]
Metres: TypeAlias = Annotated[float, Unit("m")]
Length: TypeAlias = Annotated[Metres, Limit("more than 0 m", lambda x: x > 0)]
Seconds: TypeAlias = Annotated[float, Unit("s")]
WholeNumber: TypeAlias = Annotated[int, Limit("a whole number from 0", lambda n: n >= 0)]


Say: TypeAlias = Callable[..., None]
"""Called with what is being done, and with how much of it is done: `say("mapping", 3, 10)`."""


def silent(doing: str, done: int = 0, total: int = 0) -> None:
    """Say nothing."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """One question: the fields are the parameters, each with its type, default and a line of doc.

    A subclass says what it does in the first line of its docstring, gives itself a `name`, and
    answers in `run` with a [`Result`][jaxcell.base.quantities.Result]. What each parameter is to be
    stands in its annotation as a [`Limit`][jaxcell.study.Limit]; what they are to be together is
    checked in `__post_init__` (`ValueError`s that begin with the name of a field).
    """

    name: ClassVar[str] = "result"
    "What files with its results are called."
    batch: ClassVar[str | None] = None
    """A parameter that takes several values, along which the result has a dimension of that name: a
    sweep runs members that differ in it alone as one study."""

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for name in _paths(kind):
            if str(value := getattr(self, name)).startswith("@"):
                object.__setattr__(self, name, bundled(str(value)))
        for name, limit in _limits(kind).items():
            value = getattr(self, name)
            for number in value if isinstance(value, tuple) else (value,):
                if not isinstance(number, str):
                    require(name, number, limit.expected, limit.holds)

    def run(self, say: Say = silent) -> Result:
        """Answer the question.

        **Raises:** `ValueError` that begins with the name of a parameter, if no answer can be
        sought; `RuntimeError` if there is none.
        """
        raise NotImplementedError

    def check_files(self) -> None:
        """Refuse parameters that name files which do not exist, before anything slow is imported.

        **Raises:** `FileNotFoundError` that names the file.
        """
        for name in parameters(type(self)):
            value = getattr(self, name)
            for one in value if isinstance(value, tuple) else (value,):
                if isinstance(one, Path):
                    existing(one)

    def memory(self, written: bool = False) -> float | int:
        """The bytes that the answer takes at its peak, by estimate; 0 where that is not known.

        **Arguments:**

        - `written`: whether it is to be written to files, which hold all of it.

        **Raises:** `MemoryError` that says what would fit, if more is needed than is free.
        """
        return 0

    def spec(self, result: Result) -> dict[str, Any]:
        """What determines a result: the parameters, with defaults that depend on the map filled in.

        Names of parameters with a unit end in it, as `cell_m`.
        """
        return {
            self.spec_name(name): _plain(getattr(self, name)) for name in parameters(type(self))
        }

    @classmethod
    def spec_name(cls, parameter: str) -> str:
        """The name of a parameter in a specification, which ends in its unit."""
        suffix = unit(parameters(cls)[parameter])
        return parameter if suffix is None else f"{parameter}_{suffix}"

    def headline(self, spec: dict[str, Any]) -> str:
        """The line above the tables of a result."""
        return self.name

    def at_once(self, result: Any) -> bool:
        """Whether the arrays of a result are few enough for a dataset and a recording of it.

        Of another one `write` writes them piece by piece.
        """
        return True

    def write(self, result: Any, out: Path) -> None:
        """Write the files that a result has beside its dataset and its recording."""

    def verify(self, result: Any) -> "Sequence[Comparison]":
        """Compute parts of a result again with other libraries, and compare."""
        return []


def parameters(study: type[Study]) -> dict[str, Any]:
    """The parameters of a study with their annotations, in their order."""
    hints = get_type_hints(study, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(study)}


@functools.cache
def _paths(study: Any) -> list[str]:
    """The parameters that are paths, or names of bundled data such as `@lab_a`."""

    def is_path(annotation: Any) -> bool:
        return annotation is Path or any(map(is_path, getattr(annotation, "__args__", ())))

    return [name for name, annotation in parameters(study).items() if is_path(annotation)]


def unit(annotation: Any) -> str | None:
    """The suffix of the unit that an annotation names, within tuples and options too."""
    found = _said(annotation, Unit)
    return None if found is None else found.suffix


@functools.cache
def _limits(study: Any) -> dict[str, Limit]:
    found = {name: _said(one, Limit) for name, one in parameters(study).items()}
    return {name: limit for name, limit in found.items() if limit is not None}


def _said(annotation: Any, kind: type[Kind]) -> Kind | None:
    """What an annotation says of a kind, within tuples and options too."""
    given = (one for one in getattr(annotation, "__metadata__", ()) if isinstance(one, kind))
    inner = (_said(one, kind) for one in getattr(annotation, "__args__", ()))
    return next((one for one in (*given, *inner) if one is not None), None)


def require(
    parameter: str, value: int | float | None, expected: str, holds: Callable[[float], bool]
) -> None:
    """Refuse a number that is not finite, or that a condition does not hold for.

    **Raises:** `ValueError` that names the parameter, what was expected, and the value.
    """
    if value is not None and not (math.isfinite(value) and holds(value)):
        raise ValueError(f"{parameter}: expected {expected}, got {value:g}")


@contextlib.contextmanager
def about(parameter: str) -> Iterator[None]:
    """Begin the errors of the block with a parameter: they are about it."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{parameter}: {error}") from None


def numbers(parameter: str, text: str, count: int, expected: str) -> list[float]:
    """The finite numbers of a parameter that is a text, with commas between them.

    **Raises:** `ValueError` that says what was expected, unless there are so many.
    """
    with contextlib.suppress(ValueError):
        found = [float(part) for part in text.split(",")]
        if len(found) == count and all(map(math.isfinite, found)):
            return found
    raise ValueError(f"{parameter} {text!r}: expected {expected}")


def refuse(study: Study, where: str, *names: str) -> None:
    """Refuse parameters where they have no effect: `refuse(self, "without a base", "lost")`.

    **Raises:** `ValueError` that names the first that is given, and is not as by default.
    """
    for name in names:
        if getattr(study, name) != getattr(type(study), name):
            raise ValueError(f"{name} has no meaning {where}")


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    return name_in_results(value) if isinstance(value, Path) else value
