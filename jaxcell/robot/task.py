import dataclasses
import hashlib
import math
import re
import reprlib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from .walker import cell_strides


LARGEST = 1e9
"""What no number of a file is above: a robot goes some metres."""
_LEAST_LENGTH = 1e-6
_MOST_DIRECTIONS = 1_000_000


@dataclasses.dataclass(frozen=True)
class Task:
    """What is to run, from a file, with what a robot has to know of its map."""

    path: Path
    cell: float
    "Side of a cell, in metres."
    directions: int
    "Number of directions."
    step: float
    "Length of a step, in metres."
    radius: float
    "Radius of the robot that it is for, in metres."

    @property
    def strides(self) -> Float[np.ndarray, "directions 2"]:
        """See [`jaxcell.robot.walker.cell_strides`][]."""
        return cell_strides(self.directions, self.cell, self.step)

    @property
    def header(self) -> dict[str, Any]:
        """What the log of a run says of it."""
        return {
            "file": str(self.path.absolute()),
            "sha256": digest(self.path),
            "cell_m": self.cell,
            "directions": self.directions,
            "step_m": self.step,
        }


def digest(path: Path) -> str:
    """The SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclasses.dataclass(frozen=True)
class Fields:
    """The fields of a file, which are refused by name."""

    path: Path
    values: Mapping[str, Any]
    within: str = ""
    "Where in the file they are, such as `robots[1].`."

    def get(self, name: str) -> Any:
        """A field, `None` where there is none."""
        return self.values.get(name)

    def number(self, name: str, least: float = -math.inf) -> float:
        """A finite number, of `least` at least and 10^9 at most."""
        value: Any = self.values.get(name)
        if not is_number(value) or not least <= value <= LARGEST:
            wanted = "" if least == -math.inf else f" from {least:g}"
            raise self.refused(name, f"a finite number{wanted}")
        return float(value)

    def whole(self, name: str, least: int, most: int) -> int:
        """A whole number."""
        value = self.values.get(name)
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
            raise self.refused(name, f"a whole number from {least} to {most}")
        return value

    def numbers(self, name: str, shape: tuple[int, ...], *, whole: bool) -> np.ndarray:
        """An array of finite numbers; -1 in `shape` stands for any length."""
        try:
            found = np.array(self.values.get(name))
        except ValueError:
            # A ragged one.
            found = np.empty((), object)
        lengths = "x".join(map(str, found.shape))
        matches = re.fullmatch("x".join(r"\d+" if n < 0 else str(n) for n in shape), lengths)
        if not matches or found.dtype.kind not in "iuf"[: 2 if whole else 3]:
            sizes = " x ".join("any" if n < 0 else str(n) for n in shape)
            raise self.refused(name, f"{'whole ' * whole}numbers, {sizes} of them", show=False)
        most = 2**31 - 1 if whole else LARGEST
        if not (np.abs(found.astype(float)) <= most).all():
            raise self.refused(name, f"finite numbers of at most {most:g}", show=False)
        return found.astype(np.int32 if whole else float)

    def refused(self, name: str, expected: str, *, show: bool = True) -> ValueError:
        """The error that says what a field should have been."""
        got = f", got {reprlib.repr(self.values.get(name))}" if show else ""
        return ValueError(f"{self.path}: {self.within}{name}: expected {expected}{got}")

    def part(self, name: str, index: int) -> "Fields":
        """The fields of an element of a list.

        **Raises:** `ValueError` if there is no such element, or it is no object.
        """
        parts = self.values.get(name)
        if not isinstance(parts, list) or not all(isinstance(part, dict) for part in parts):
            raise self.refused(name, "a list of objects", show=False)
        if not 0 <= index < len(parts):
            raise ValueError(
                f"{self.path}: there is no robot {index}; robots are 0 to {len(parts) - 1}"
            )
        return Fields(self.path, parts[index], f"{self.within}{name}[{index}].")

    @property
    def common(self) -> dict[str, Any]:
        """The fields of every [`Task`][]."""
        return {
            "path": self.path,
            "cell": self.number("cell_m", _LEAST_LENGTH),
            "directions": self.whole("directions", 1, _MOST_DIRECTIONS),
            "step": self.number("step_m", _LEAST_LENGTH),
            "radius": self.number("robot_radius_m", 0.0),
        }


def is_number(value: Any) -> bool:
    """Whether a value is a finite number."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and abs(value) <= sys.float_info.max
