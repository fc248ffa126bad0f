"""What members read beside their specification, identified by its content."""

import hashlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from ..files import find_file
from ..spec import Spec
from .modules import imported_files, is_users, module_file


_MAP_SERVER = (".yaml", ".yml")


def digests(spec: Spec) -> dict[str, str]:
    """The SHA-256 of each file that the members of a sweep read, by its name.

    These are the files that a parameter or a fixed value names; the images of such files in the
    format of map_server; the module of a task, or of a value such as a system, that is the user's
    own (`FILE.py:NAME` or `MODULE:NAME`); and the user's modules that this module imports.
    """
    found = {}
    texts = sorted(set(_texts(spec)))
    for text in texts:
        if (path := find_file(spec, text)) is None or not path.is_file():
            continue
        found[text] = _digest(path)
        if (image := _image(path)) is not None and os.path.isfile(path.parent / image):
            found[os.path.join(os.path.dirname(text), image)] = _digest(path.parent / image)
    for text in (spec.task, *texts):
        module, colon, _ = text.rpartition(":")
        if colon and (source := _source(spec, module)) is not None:
            name = "" if module.endswith(".py") else module
            if text == spec.task or is_users(name, source):
                found[f"task {text}" if text == spec.task else text] = _digest(source)
                for imported, file in imported_files(source, name).items():
                    found[f"module {imported} ({file.name})"] = _digest(file)
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
    dotted = all(part.isidentifier() for part in module.split("."))
    return module_file(module) if dotted else None


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
