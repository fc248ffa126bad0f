import contextlib
import dataclasses
import math
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ..base.paths import replacing
from .terminal import status


if TYPE_CHECKING:
    from ..robot.tasks.task import Task


@dataclasses.dataclass(frozen=True, kw_only=True)
class Printing:
    """The option of commands that print a result."""

    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""


@contextlib.contextmanager
def starting() -> Iterator[None]:
    """Configure JAX for a command, and show a status during imports that take seconds."""
    with status("loading JAX"):
        from ..base.runtime import configure_jax

        configure_jax()
        yield


def prepare_tasks() -> None:
    """Find tasks in the working folder, and let them compute with 64 bits as commands do.

    This does not import JAX, because tasks may not need it.
    """
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    sys.path.append(os.getcwd())


def direction_at(heading: float, directions: int) -> int:
    """Return the direction of the option `--heading`, which is in degrees.

    **Raises:** `ValueError` if the heading is between two directions.
    """
    turn = heading * directions / 360
    if not math.isfinite(turn) or abs(turn - round(turn)) > 1e-6:
        raise ValueError(
            f"--heading {heading:g}: expected a multiple of the {360 / directions:g} degrees "
            "between the directions"
        )
    return round(turn) % directions


def check_heading(task: "Task") -> None:
    """Refuse a task whose robot needs its heading, if no heading is known.

    **Raises:** `ValueError`.
    """
    if task.needs_heading:
        raise ValueError(
            f"--heading: expected the heading of the robot at the start in degrees, because the "
            f"steps of {task.path} differ between directions"
        )


def check_out(out: Path, folder: bool, option: str = "--out ") -> None:
    """Refuse a place where results cannot be written, before they are computed.

    **Arguments:**

    - `out`: the place.
    - `folder`: whether the place is for a folder, or for a file.
    - `option`: the name of the place in the message.

    **Raises:** `IsADirectoryError`, `NotADirectoryError` or `PermissionError`.
    """
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
    """Write a text file, which appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
