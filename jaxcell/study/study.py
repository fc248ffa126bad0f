import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, TypeVar

from .. import verify as verification
from ..base.bundled import with_path
from ..base.documents import about as about
from ..base.formatting import did_you_mean
from ..base.paths import digest, existing, files_read, name_in_results
from ..base.quantities import Quantity, Result, values
from ..base.units import number_of
from ..base.wide import widened
from .parameters import Headings, Unit, check, inside, parameters, within, without_effect


if TYPE_CHECKING:
    import numpy as np


Own = TypeVar("Own", bound="Study")
Say: TypeAlias = Callable[..., None]
"""A function that reports work and its progress, such as `say("mapping", 3, 10)` for 3 of 10."""


Wanted: TypeAlias = Callable[[str], bool]
"""A function that takes the name of a quantity, and returns whether it is wanted."""


def every(name: str) -> bool:
    """Want all quantities."""
    return True


def silent(doing: str, done: int = 0, total: int = 0) -> None:
    """Ignore a report of progress."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """A question. Its fields are the parameters, each with a type, a default and a docstring.

    A subclass states the question in the first line of its docstring. Its `run` returns the answer
    as a [`Result`][jaxcell.base.quantities.Result]. The annotation of a parameter gives its bounds
    ([`Limit`][jaxcell.study.Limit]) and the parameters that it depends on
    ([`Only`][jaxcell.study.Only], [`Needed`][jaxcell.study.Needed]). A subclass makes other checks
    in `__post_init__`, with `ValueError`s that begin with the name of a parameter. A parameter with
    several values, such as `tuple[float, ...]`, also accepts a single value, and one with texts
    `NAME=VALUE`, such as `errors`, a dict.
    """

    name: ClassVar[str] = "result"
    "Base name of the result files."
    command: ClassVar[str] = ""
    "Words of the command after `jaxcell`; empty for a study without a command."
    example: ClassVar[str] = ""
    "Options of the command in the example on its help page."
    task: ClassVar[str] = ""
    "Name of the task in specifications of sweeps; empty for a study that is not a built-in task."
    varied: ClassVar[tuple[str, ...]] = ()
    """Parameters of single numbers, or `params`. Members of a sweep that differ only in them are
    computed together, by `numbers`."""
    headings: ClassVar[Headings] = {}
    "Parameters that are not in the first part of the help page, by the heading of their part."

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        widened(cls)

    def __new__(cls: type[Own], *_: Any, **given: Any) -> Own:
        known = [field.name for field in dataclasses.fields(cls)]
        for name in given:
            if name not in known:
                meant = did_you_mean(name, known) or f"; it has {', '.join(known)}"
                raise TypeError(f"{name}: {cls.__name__} has no such parameter{meant}")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for name, kinds in _kinds(kind).items():
            value = getattr(self, name)
            if Path in kinds and isinstance(value, str | Path):
                value = Path(with_path(str(value)))
            object.__setattr__(self, name, _several(value) if Ellipsis in kinds else value)
        check(self)

    def run(self, say: Say = silent) -> Result:
        """Answer the question of the study. `say` is called with the progress.

        **Raises:** `ValueError` for a wrong parameter, with a message that begins with its name;
        `RuntimeError` if there is no answer.
        """
        raise NotImplementedError

    def numbers(
        self, columns: Mapping[str, "np.ndarray"], wanted: Wanted = every
    ) -> dict[str, tuple[Quantity, "np.ndarray"]]:
        """Compute the quantities of many studies that are single numbers.

        **Arguments:** for parameters in `varied`, arrays with a value for each study; in the other
        parameters the studies are equal to this one; and a function that returns whether a quantity
        is wanted, from its name. **Returns:** for each quantity, keyed by its name, its description
        and an array with a number for each study, or the number that they share.
        """
        return scalars(self.run(), (), wanted)

    def check_files(self) -> None:
        """Raise `FileNotFoundError` if a file among the parameters is missing."""
        for path in self._paths():
            existing(path)

    def _paths(self) -> Iterator[Path]:
        for name in parameters(type(self)):
            value = getattr(self, name)
            for path in value if isinstance(value, tuple) else (value,):
                if isinstance(path, Path):
                    yield path

    def digests(self) -> dict[str, str]:
        """Compute the SHA-256 of each file among the parameters, keyed by its name in results."""
        files = {file for path in self._paths() for file in files_read(path)}
        return {name_in_results(file): digest(file) for file in sorted(files)}

    def memory(self, written: bool = False) -> float | int:
        """Estimate the peak memory in bytes that it takes to compute the answer; 0 if unknown.

        With `written`, the estimate includes the memory for writing the files. **Raises:**
        `MemoryError` with advice, if less memory is free.
        """
        return 0

    def spec(self, result: Result) -> dict[str, Any]:
        """Return the parameters, keyed by name, with which a result can be computed again.

        Parameters without effect are left out, and defaults that depend on the map are replaced by
        their values. The name of a parameter with a unit ends in the unit, such as `cell_m`.
        """
        idle = without_effect(self)
        return {
            self.spec_name(name): _plain(getattr(self, name))
            for name in parameters(type(self))
            if name not in idle
        }

    @classmethod
    def spec_name(cls, parameter: str) -> str:
        """Return the name of a parameter in `spec`, which ends in the unit, if any: `cell_m`."""
        unit = within(parameters(cls)[parameter], Unit)
        return f"{parameter}_{unit.suffix}" if unit is not None and unit.suffix else parameter

    def headline(self, spec: dict[str, Any]) -> str:
        """Return the line above the tables of a result, from its `spec`."""
        return self.name

    def at_once(self, result: Any) -> bool:
        """Return whether the arrays of a result fit in one dataset and one recording.

        Larger results are written piece by piece in `write`.
        """
        return True

    def write(self, result: Any, out: Path) -> None:
        """Write the files of a result other than its dataset and its recording."""

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        """Compute parts of a result independently with other libraries, and compare them."""
        return []


def scalars(
    result: Result, dims: tuple[str, ...], wanted: Wanted = every
) -> dict[str, tuple[Quantity, "np.ndarray"]]:
    """Return the wanted quantities of a result that are numbers, or numbers along `dims`."""
    import numpy as np

    described = values(
        result,
        lambda name, about: (
            about.dims in ((), dims) and about.kind != "coordinate" and wanted(name)
        ),
    )
    arrays = {name: (about, np.asarray(value)) for name, (about, value) in described.items()}
    return {
        name: (about, array)
        for name, (about, array) in arrays.items()
        if array.dtype.kind in "biuf"
    }


def one_each(
    parameter: str, columns: Mapping[str, "np.ndarray"], own: Sequence[float | int]
) -> "np.ndarray":
    """Return a parameter's value in each study, which is `own` where it is not in `columns`."""
    import numpy as np

    if parameter in columns:
        return columns[parameter]
    if len(own) != 1:
        raise ValueError(f"{parameter}: expected one value for each member, got {len(own)}")
    return np.asarray(own)


def _several(value: Any) -> Any:
    """Convert a single value, an array, a list or a dict to a tuple; leave others as they are."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return tuple(f"{part}={number}" for part, number in value.items())
    if isinstance(value, str | Path | float | int):
        return (value,)
    return tuple(value) if isinstance(value, list) else value


@functools.cache
def _kinds(study: Any) -> dict[str, list[Any]]:
    return {name: [*inside(annotation)] for name, annotation in parameters(study).items()}


@contextlib.contextmanager
def renamed(**parameters: str) -> Iterator[None]:
    """Let a `ValueError` about an argument of a function name the parameter of the study instead.

    `parameters` are the names of parameters by the names of arguments.
    """
    try:
        yield
    except ValueError as error:
        name, colon, message = str(error).partition(":")
        if name not in parameters:
            raise
        raise ValueError(f"{parameters[name]}{colon}{message}") from None


def numbers(parameter: str, text: Any, units: Sequence[str], expected: str) -> list[float]:
    """Parse finite numbers that commas separate, one for each of `units`, or several numbers.

    A number may have its unit, as in `50cm`. `expected` describes the numbers in the error.
    """
    several = text if isinstance(text, tuple | list) else (text,)
    parts = text.split(",") if isinstance(text, str) else [str(part) for part in several]
    with contextlib.suppress(ValueError):
        read = [number_of(*pair) for pair in zip(parts, units, strict=True)]
        if all(map(math.isfinite, read)):
            return read
    raise ValueError(f"{parameter} {text!r}: expected {expected}")


def radians(degrees: Sequence[float]) -> "np.ndarray":
    import numpy as np

    return np.radians(degrees)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    if isinstance(value, Path):
        return name_in_results(value)
    if value is None or isinstance(value, str | bool | int | float):
        return value
    # A map or a graph of the program.
    return getattr(value, "name", "") or f"a {type(value).__name__} of the program"
