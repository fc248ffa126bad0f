"""The output of commands: JSON objects, and files that are written atomically."""

import dataclasses
import os
import tempfile
from collections.abc import Callable, Collection
from json import dumps
from pathlib import Path
from typing import Annotated, Any

import tyro

from ..base.paths import replacing
from .help import option
from .terminal import say


@dataclasses.dataclass(frozen=True, kw_only=True)
class Printing:
    """Base class of commands that print a result, with the option `--json`."""

    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""

    def report(self, summary: dict[str, Any], show: Callable[[], None]) -> None:
        """Print a summary as JSON with `--json`, and otherwise call the function that shows it."""
        if self.json:
            say(dumps(summary))
        else:
            show()


def check_out(out: Path, folder: bool, option: str = "--out ") -> None:
    """Check that results can be written to `out`; error messages begin with `option`."""
    wanted = out.absolute()
    if not folder:
        if wanted.is_dir():
            raise IsADirectoryError(f"{option}{out}: expected a file, and this is a directory")
        wanted = wanted.parent
    place = next(place for place in (wanted, *wanted.parents) if os.path.lexists(place))
    if not place.is_dir():
        raise NotADirectoryError(f"{option}{out}: {place} is no directory")
    try:
        # Beside missing permissions, a disk may be full, or mounted read-only.
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise PermissionError(f"{option}{out}: {place} cannot be written to") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def option_words(
    options: Any, names: Collection[str], named: Callable[[Path], str] = str
) -> list[str]:
    """Convert the options with these `names`, except defaults, to words of a command line.

    `named` returns the word for a path.
    """
    first: list[str] = []
    words: list[str] = []
    for field in dataclasses.fields(options):
        value, name = getattr(options, field.name), option(type(options), field.name)
        if field.name not in names or value == field.default:
            continue
        values = [
            named(part) if isinstance(part, Path) else str(part)
            for part in (value if isinstance(value, tuple) else (value,))
        ]
        if not name.startswith("--"):
            first += values
        elif value is True:
            words.append(name)
        elif values[0].startswith("-"):
            # It would be read as an option.
            words.append(f"{name}={values[0]}")
        else:
            words += [name, *values]
    return first + words
