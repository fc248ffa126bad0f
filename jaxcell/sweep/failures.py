"""Members that failed: in the folder of a sweep, a report for each chunk that has some."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..base.paths import write_durably


@dataclasses.dataclass(frozen=True)
class Failure:
    """A member that failed."""

    chunk: int
    "The number of its chunk."
    index: Mapping[str, int]
    "Its place along each dimension."
    parameters: Mapping[str, Any]
    message: str
    trace: str
    "The end of the traceback, if there is one."


def reported(folder: Path) -> list[int]:
    """The numbers of the chunks that have a report, in order."""
    return sorted(int(path.stem) for path in (folder / "failures").glob("[0-9]*.json"))


def read_report(folder: Path, number: int) -> list[Failure]:
    """The members of a chunk that failed."""
    text = _file(folder, number).read_text(encoding="utf-8")
    return [Failure(**one) for one in json.loads(text)]


def write_report(folder: Path, number: int, failures: Sequence[Failure]) -> None:
    """Write down which members of a chunk failed."""
    path = _file(folder, number)
    path.parent.mkdir(exist_ok=True)
    text = json.dumps([dataclasses.asdict(one) for one in failures], indent=2)
    write_durably(path, (text + "\n").encode())


def remove_report(folder: Path, number: int) -> None:
    """Remove the report of a chunk, if it has one."""
    _file(folder, number).unlink(missing_ok=True)


def _file(folder: Path, number: int) -> Path:
    return folder / "failures" / f"{number:07d}.json"
