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
    """What commands take that print what they found."""

    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""


@contextlib.contextmanager
def starting() -> Iterator[None]:
    """Set JAX up for a command, around the imports that take seconds."""
    with status("loading JAX"):
        from ..base.runtime import configure_jax

        configure_jax()
        yield


def prepare_tasks() -> None:
    """Find tasks beside the user, and let them compute as commands do.

    This does not import JAX, which they may not need.
    """
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    sys.path.append(os.getcwd())


def direction_at(heading: float, directions: int) -> int:
    """The direction of the option `--heading`, in degrees.

    **Raises:** `ValueError` if there is none in which a robot has this heading.
    """
    turn = heading * directions / 360
    if not math.isfinite(turn) or abs(turn - round(turn)) > 1e-6:
        raise ValueError(
            f"--heading {heading:g}: expected a multiple of the {360 / directions:g} degrees "
            "between the directions"
        )
    return round(turn) % directions


def check_heading(task: "Task") -> None:
    """Refuse a task whose robot needs its heading, where the heading is not known.

    **Raises:** `ValueError`.
    """
    if task.needs_heading:
        raise ValueError(
            f"--heading: the steps of {task.path} differ between directions, so the robot needs to "
            "know its own; expected its heading at the start, in degrees"
        )


def check_out(out: Path, folder: bool, option: str = "--out ") -> None:
    """Refuse a place for results where none can be written, before they are computed.

    **Arguments:**

    - `out`: the place.
    - `folder`: whether it is to be a folder, or a file.
    - `option`: what the message calls it.

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
        # Permissions are only half of it: a disk may be full, or mounted read-only.
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise PermissionError(f"{option}{out}: {place} cannot be written to") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
