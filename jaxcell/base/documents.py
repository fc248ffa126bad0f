"""Read text files such as JSON, and check the types of their fields.

A wrong field raises a `ValueError` that names the field, the expected value and the actual value.
"""

import contextlib
import dataclasses
import difflib
import json
import math
import re
import reprlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .paths import absent


if TYPE_CHECKING:
    import numpy as np


MAX_NUMBER = 1e9
"""Largest magnitude of a number, such as a length in metres, that is accepted by default."""


@contextlib.contextmanager
def about(subject: object) -> Iterator[None]:
    """Put a file, or a parameter, before the message of a `ValueError` that a block raises."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{subject}: {error}") from error


def check_file(path: Path, kind: str) -> None:
    """Raise an error if a path is not a file; `kind`, such as `a map`, describes the file."""
    if not path.exists():
        raise absent(path)
    if path.is_dir():
        raise ValueError(f"{path}: expected {kind} file, got a directory")


def read_text(path: Path) -> str:
    """Read a UTF-8 file, with or without a byte order mark."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"expected UTF-8 text; byte {error.start} is not") from None


def decode_json(text: str, kind: str) -> Any:
    """Decode the JSON of `kind`, such as `a map`; reject invalid JSON and repeated keys."""
    try:
        return json.loads(text, object_pairs_hook=_without_repeats)
    except RecursionError:
        raise ValueError(f"not {kind}: its brackets are nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"not valid JSON, or cut short: {error}") from None


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) < len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {reprlib.repr(repeated)} is repeated")
    return document


def refused(field: str, expected: str, value: Any) -> ValueError:
    """Return an error that names a field, the value that was expected, and the actual value."""
    return ValueError(f"{field}: expected {expected}, got {reprlib.repr(value)}")


def checked_list(field: str, value: Any) -> list[Any]:
    """Return `value` if it is a list; otherwise raise `ValueError`."""
    if not isinstance(value, list):
        raise refused(field, "a list", value)
    return value


def checked_pair(field: str, value: Any) -> list[Any]:
    """Return `value` if it is a list of two elements; otherwise raise `ValueError`."""
    if not isinstance(value, list) or len(value) != 2:
        raise refused(field, "a pair [x, y]", value)
    return value


def checked_number(
    field: str,
    value: Any,
    expected: str = "a finite number",
    *,
    least: float = -math.inf,
    most: float = MAX_NUMBER,
    text: bool = False,
) -> float:
    """Convert a value to a finite number, at least `least` and of magnitude at most `most`.

    If `text` is true, a string with a number is accepted too. Other values raise a `ValueError`
    that contains the text `expected`.
    """
    number = math.nan
    if type(value) in ((int, float, str) if text else (int, float)):
        with contextlib.suppress(ValueError, OverflowError):
            number = float(value)
    if not (math.isfinite(number) and least <= number and abs(number) <= most):
        raise refused(field, expected, value)
    return number


class NewerVersionError(ValueError):
    """A newer version of jaxcell wrote a file."""


def check_version(version: Any, newest: int, where: str = "") -> None:
    """Raise `NewerVersionError` above `newest`, and `ValueError` unless it is a number from 1.

    `where` is the beginning of the message, such as the name of a file.
    """
    if type(version) is not int or version < 1:
        raise refused(f"{where}version", f"a whole number from 1 to {newest}", version)
    if version > newest:
        raise NewerVersionError(
            f"{where}version: expected at most {newest}, got {reprlib.repr(version)}; a newer "
            "jaxcell wrote it, and reads it: pip install --upgrade jaxcell"
        )


@dataclasses.dataclass(frozen=True)
class Fields:
    """The fields of a JSON object, with methods that check their types."""

    values: Mapping[str, Any]
    where: str = ""
    "The beginning of error messages: a file, or a position in a file such as `robots[1].`."

    def get(self, name: str) -> Any:
        """Get a field; `None` if it is missing."""
        return self.values.get(name)

    def needed(self, name: str) -> Any:
        """Get a required field; raise `ValueError` if it is missing."""
        if name not in self.values:
            raise ValueError(f"{self.where}{name}: it is missing")
        return self.values[name]

    def text(self, name: str) -> str:
        """Get a field that is a string."""
        if not isinstance(value := self.needed(name), str):
            raise refused(self.where + name, "a string", value)
        return value

    def texts(self, name: str) -> dict[str, str]:
        """Get a field that is an object whose values are strings."""
        value = self.needed(name)
        if not isinstance(value, dict) or not all(isinstance(part, str) for part in value.values()):
            raise refused(self.where + name, "an object of strings", value)
        return value

    def check_names(self, known: Sequence[str]) -> None:
        """Raise `ValueError` if there is a field with another name."""
        for name in self.values:
            if name not in known:
                near = difflib.get_close_matches(name, known, 1)
                meant = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
                raise ValueError(f"{self.where}{name}: there is no such field; {meant}")

    def check_version(self, newest: int) -> None:
        """Check the field `version`, which is 1 if it is missing."""
        check_version(self.values.get("version", 1), newest, self.where)

    def number(self, name: str, least: float = -math.inf) -> float:
        """Get a finite number that is at least `least`."""
        expected = "a finite number" + (f" from {least:g}" if least > -math.inf else "")
        return checked_number(self.where + name, self.get(name), expected, least=least)

    def whole(self, name: str, least: int, most: int) -> int:
        """Get a whole number from `least` to `most`."""
        value = self.get(name)
        if type(value) is not int or not least <= value <= most:
            raise refused(self.where + name, f"a whole number from {least} to {most}", value)
        return value

    def numbers(self, name: str, shape: tuple[int, ...], *, whole: bool) -> "np.ndarray":
        """Get an array of finite numbers (integers if `whole`); -1 in `shape` means any length."""
        # Imported here because pages of help do not need NumPy.
        import numpy as np

        try:
            array = np.array(self.get(name))
        except ValueError:
            # A ragged list.
            array = np.empty((), object)
        lengths = "x".join(map(str, array.shape))
        matches = re.fullmatch("x".join(r"\d+" if n < 0 else str(n) for n in shape), lengths)
        if not matches or array.dtype.kind not in "iuf"[: 2 if whole else 3]:
            sizes = " x ".join("any" if n < 0 else str(n) for n in shape)
            raise self.refused(name, f"{'whole ' * whole}numbers, {sizes} of them")
        most = 2**31 - 1 if whole else MAX_NUMBER
        if not (np.abs(array.astype(float)) <= most).all():
            raise self.refused(name, f"finite numbers of at most {most:g}")
        return array.astype(np.int32 if whole else float)

    def parts(self, name: str) -> "list[Fields]":
        """Get a field that is a list of objects; return the `Fields` of each object."""
        parts = []
        for i, part in enumerate(checked_list(self.where + name, self.get(name))):
            place = f"{self.where}{name}[{i}]"
            if not isinstance(part, dict):
                raise refused(place, "an object", part)
            parts.append(Fields(part, f"{place}."))
        return parts

    def refused(self, name: str, expected: str) -> ValueError:
        """Return an error that names a field and what was expected, but not its value."""
        return ValueError(f"{self.where}{name}: expected {expected}")
