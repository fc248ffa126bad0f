"""Failures of members of a sweep."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..base.paths import replacing


@dataclasses.dataclass(frozen=True)
class Failure:
    """The failure of a member."""

    chunk: int
    "The number of the chunk of the member."
    index: Mapping[str, int]
    "The place of the member along each dimension."
    parameters: Mapping[str, Any]
    message: str
    trace: str
    "The end of the traceback; empty if there is none."


def write_failures(path: Path, failures: Sequence[Failure]) -> None:
    """Write failures with their tracebacks to a file; without failures, remove the file."""
    if not failures:
        path.unlink(missing_ok=True)
        return
    text = json.dumps([dataclasses.asdict(failure) for failure in failures], indent=2)
    with replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
