"""What members read beside their specification, identified by its content."""

import hashlib
import importlib.util
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from ..files import find_file
from ..spec import Spec


_MAP_SERVER = (".yaml", ".yml")


def digests(spec: Spec) -> dict[str, str]:
    """The SHA-256 of each file that the members of a sweep read, by its name.

    These are the files that a parameter or a fixed value names, where there is one; the images of
    such files in the format of map_server; and the module of a task that is none of ours, under the
    name of the task. What that module imports is not checked.
    """
    found = {}
    for text in sorted(set(_texts(spec))):
        if (path := find_file(spec, text)) is None or not path.is_file():
            continue
        found[text] = _digest(path)
        if (image := _image(path)) is not None and os.path.isfile(path.parent / image):
            found[os.path.join(os.path.dirname(text), image)] = _digest(path.parent / image)
    if ":" in spec.task and (source := _source(spec, spec.task.partition(":")[0])) is not None:
        found[f"task {spec.task}"] = _digest(source)
    return found


def changed(there: Mapping[str, str], here: Mapping[str, str]) -> list[str]:
    """Which digests of a sweep that was begun are others now, or of a file that is gone."""
    return [
        f"{name}: {digest[:12]} there, {here[name][:12] if name in here else 'no such file'} here"
        for name, digest in there.items()
        if here.get(name) != digest
    ]


def _texts(spec: Spec) -> Iterator[str]:
    yield from _strings(spec.fixed)
    for parameter in spec.parameters:
        if parameter.values.dtype.kind == "U":
            yield from parameter.values.tolist()


def _strings(value: Any) -> Iterator[str]:
    """All texts in a value, its lists and its tables."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from _strings(one)


def _image(path: Path) -> str | None:
    """The image that a map in the format of map_server names."""
    if path.suffix.lower() not in _MAP_SERVER:
        return None
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError, RecursionError):
        return None
    name = document.get("image") if isinstance(document, dict) else None
    return name if isinstance(name, str) else None


def _source(spec: Spec, module: str) -> Path | None:
    """The file of a module, if there is one."""
    if module.endswith(".py"):
        return find_file(spec, module)
    try:
        found = importlib.util.find_spec(module)
    except (ImportError, ValueError):
        return None
    origin = "" if found is None else found.origin or ""
    return Path(origin) if os.path.isfile(origin) else None


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
