"""Say what a file is that a command does not take, and which commands take it."""

import contextlib
import dataclasses
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..study.parameters import listed, parameters
from .help import is_positional
from .info import describe


# The commands that take a file, by the beginning of its description.
_TAKEN = {
    "a graph": ["patrol graph"],
    "currents": ["drift"],
    "trajectories": ["drifters"],
    "a result": ["view", "info"],
    "the summary of": ["view", "info"],
    "a Rerun recording": ["view"],
    "a task of robots": ["robot run"],
    "a localization": ["robot run", "robot sketch"],
    "a map for the belief": ["robot run"],
    "the log of a robot": ["robot replay"],
    "the specification of a sweep": ["sweep"],
    "a sweep": ["sweep status", "sweep view"],
}


def described_instead(name: str, command: Any, error: str, commands: Mapping[str, Any]) -> str:
    """Return a better error if a command was given a file of another kind; otherwise `error`.

    `name` is the name of the `command`, and `commands` are the classes of all commands.
    """
    taken = {
        **_TAKEN,
        "a map": [each for each, kind in commands.items() if "map" in parameters(kind)],
    }
    for path in _files(command):
        if name not in commands or name == "info" or str(path) not in error:
            continue
        with contextlib.suppress(ValueError, OSError, MemoryError, ImportError):
            what = re.split("[;:] ", describe(path)["what"])[0]
            begin = max((key for key in taken if what.startswith(key)), key=len, default="")
            if begin and name not in taken[begin]:
                return f"{path}: it holds {what}; give it to {listed(tuple(taken[begin]))}"
    return error


def _files(command: Any) -> Iterable[Path]:
    """Yield the files that are written without the name of an option."""
    for field in dataclasses.fields(command):
        if is_positional(parameters(type(command))[field.name]):
            value = getattr(command, field.name)
            values = value if isinstance(value, tuple) else (value,)
            yield from (path for path in values if isinstance(path, Path))
