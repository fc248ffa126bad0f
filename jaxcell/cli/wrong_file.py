"""Say what a file is that a command does not take, and which commands take it."""

import contextlib
import dataclasses
import os
import re
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..study.parameters import listed, parameters
from .described import describe
from .help import is_positional, option


# The commands that take a file, by the beginning of its description.
_TAKEN = {
    "a graph": ["patrol graph", "patrol guard"],
    "currents": ["drift", "release", "deploy"],
    "trajectories": ["drifters"],
    "a result": ["view", "doctor"],
    "the summary of": ["view", "doctor"],
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
    for parameter, path in _files(command):
        if name not in commands or str(path) not in error:
            continue
        if path.is_file() and not path.stat().st_size:
            return f"{path}: the file is empty; save or copy it again"
        if error.endswith("got a directory"):
            return f"{error}; name a file in it"
        if name == "doctor":
            continue
        with (
            contextlib.suppress(ValueError, OSError, MemoryError, ImportError),
            warnings.catch_warnings(action="ignore"),
        ):
            what = re.split("[;:] ", describe(path)["what"])[0]
            begin = max((key for key in taken if what.startswith(key)), key=len, default="")
            flag = option(type(command), parameter)
            is_option, wanted = flag.startswith("--"), error.removeprefix(f"{path}: ")
            if begin and is_option and wanted != error and path.suffix == ".json":
                return f"{flag} {path}: it holds {what}; {wanted}"
            if begin and not is_option and name not in taken[begin]:
                return f"{path}: it holds {what}; give it to {listed(tuple(taken[begin]))}"
    return error


def _files(command: Any) -> Iterable[tuple[str, Path]]:
    """Yield the files that a command is given, with the names of their parameters."""
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        if is_positional(parameters(type(command))[field.name]) and isinstance(value, str):
            value = Path(value)
        for path in value if isinstance(value, tuple) else (value,):
            if isinstance(path, Path) and os.path.exists(path):
                yield field.name, path
