import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

from .. import verify as verification
from ..base.bundled import bundled
from ..base.paths import existing, name_in_results
from ..base.quantities import Result
from .parameters import Unit, check, inside, parameters, within, without_effect


Say: TypeAlias = Callable[..., None]
"""Called with the work that begins, and with its progress: `say("mapping", 3, 10)`."""


def silent(doing: str, done: int = 0, total: int = 0) -> None:
    """Say nothing."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """One question: the fields are the parameters, each with its type, default and a line of doc.

    A subclass states its question in the first line of its docstring, and answers it in `run` with
    a [`Result`][jaxcell.base.quantities.Result]. The annotation of a parameter bounds it
    ([`Limit`][jaxcell.study.Limit]) and names the parameters that it depends on
    ([`Only`][jaxcell.study.Only], [`Needed`][jaxcell.study.Needed]). A subclass checks everything
    else in `__post_init__`, by `ValueError`s that begin with the name of a parameter. A parameter
    of several values, such as `tuple[float, ...]`, accepts a single one.
    """

    name: ClassVar[str] = "result"
    "Name of the files of its results."
    command: ClassVar[str] = ""
    "Words of its command after `jaxcell`; empty for a study that has no command of its own."
    example: ClassVar[str] = ""
    "Options of its command that make a good first example, for the page of help."
    task: ClassVar[str] = ""
    "Name of its task in the specification of a sweep; empty for a study that is no built-in task."
    one_of: ClassVar[tuple[str, ...]] = ()
    "Parameters of which one is needed."
    batch: ClassVar[str | None] = None
    """A parameter that takes several values, along which the result has a dimension of that name: a
    sweep runs members that differ in it alone as one study."""

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for name, kinds in _kinds(kind).items():
            value = getattr(self, name)
            if Path in kinds and str(value).startswith("@"):
                object.__setattr__(self, name, bundled(str(value)))
            if Ellipsis in kinds and isinstance(value, str | Path | float | int):
                object.__setattr__(self, name, (value,))
        check(self)

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
            for path in value if isinstance(value, tuple) else (value,):
                if isinstance(path, Path):
                    existing(path)

    def memory(self, written: bool = False) -> float | int:
        """Estimate the peak memory of the answer in bytes; 0 if it is unknown.

        **Arguments:**

        - `written`: whether the result is written to files, which hold all of it.

        **Raises:** `MemoryError` that says what would fit, if less memory is free.
        """
        return 0

    def spec(self, result: Result) -> dict[str, Any]:
        """Describe how a result came about: the parameters that have an effect, by name.

        Defaults that depend on the map are filled in. Names of parameters with a unit end in the
        unit, as `cell_m`.
        """
        idle = without_effect(self)
        return {
            self.spec_name(name): _plain(getattr(self, name))
            for name in parameters(type(self))
            if name not in idle
        }

    @classmethod
    def spec_name(cls, parameter: str) -> str:
        """Return the name of a parameter in a specification, which ends in its unit."""
        unit = within(parameters(cls)[parameter], Unit)
        return parameter if unit is None else f"{parameter}_{unit.suffix}"

    def headline(self, spec: dict[str, Any]) -> str:
        """Return the line above the tables of a result."""
        return self.name

    def at_once(self, result: Any) -> bool:
        """Return whether the arrays of a result fit in one dataset and one recording.

        Larger results are written piece by piece in `write`.
        """
        return True

    def write(self, result: Any, out: Path) -> None:
        """Write the files that a result has beside its dataset and its recording."""

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        """Compute parts of a result again with other libraries, and compare."""
        return []


@functools.cache
def _kinds(study: Any) -> dict[str, list[Any]]:
    """The types that the annotation of each parameter is made of."""
    return {name: [*inside(annotation)] for name, annotation in parameters(study).items()}


@contextlib.contextmanager
def about(parameter: str) -> Iterator[None]:
    """Put the name of a parameter before the errors of a block."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{parameter}: {error}") from None


def numbers(parameter: str, text: str, count: int, expected: str) -> list[float]:
    """Read the finite numbers of a text, which commas separate."""
    with contextlib.suppress(ValueError):
        read = [float(part) for part in text.split(",")]
        if len(read) == count and all(map(math.isfinite, read)):
            return read
    raise ValueError(f"{parameter} {text!r}: expected {expected}")


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    return name_in_results(value) if isinstance(value, Path) else value
