"""Describe the versions, files and modules that the result of a sweep depends on."""

import importlib.metadata
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from ... import __version__
from ...base.paths import digest
from ...base.revision import git_revision
from ..spec import Spec
from .modules import imported_files, is_users, module_file


_MAP_SERVER = (".yaml", ".yml")


def made_with(spec: Spec, wide: bool) -> dict[str, Any]:
    """Return the versions, settings and files that affect a result, as attributes of the result.

    `wide` is true if JAX computes with 64 bits.
    """
    revision = git_revision()
    return {
        "jaxcell_version": __version__,
        "jax_version": importlib.metadata.version("jax"),
        "jax_enable_x64": int(wide),
        "digests": json.dumps(digests(spec)),
        **({} if revision is None else {"git_revision": revision}),
    }


def digests(spec: Spec) -> dict[str, str]:
    """Compute the SHA-256 of each file that the members of a sweep read, keyed by file name.

    The files are: files whose paths are parameters or fixed values; the images of map_server files;
    the user's modules in the task or in values (`FILE.py:NAME` or `MODULE:NAME`); and the user's
    modules that these import.
    """
    known = {}
    columns = [parameter.values for parameter in spec.parameters]
    listed = [values.tolist() for values in columns if values.dtype.kind == "U"]
    texts = sorted({*_strings([spec.fixed, *listed])})
    for text in texts:
        if (path := spec.find_file(text)) is None or not path.is_file():
            continue
        known[text] = digest(path)
        if (image := _image(path)) is not None and os.path.isfile(path.parent / image):
            known[os.path.join(os.path.dirname(text), image)] = digest(path.parent / image)
    for text in (spec.task, *texts):
        module, colon, _ = text.rpartition(":")
        if colon and (source := _source(spec, module)) is not None:
            name = "" if module.endswith(".py") else module
            if text == spec.task or is_users(name, source):
                known[f"task {text}" if text == spec.task else text] = digest(source)
                for imported, file in imported_files(source, name).items():
                    known[f"module {imported} ({file.name})"] = digest(file)
    return known


def differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Describe changes of versions, files and the task between two results of `made_with`."""
    old, new = (json.loads(made["digests"]) for made in (there, here))
    return [
        f"{name}: {there.get(name)} there, {value} here"
        for name, value in here.items()
        if name not in ("digests", "git_revision") and there.get(name) != value
    ] + [
        f"{name}: {before[:12]} there, {new[name][:12] if name in new else 'no such file'} here"
        for name, before in old.items()
        if new.get(name) != before
    ]


def _strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from _strings(one)


def _image(path: Path) -> str | None:
    if path.suffix.lower() not in _MAP_SERVER:
        return None
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError, RecursionError):
        return None
    name = document.get("image") if isinstance(document, dict) else None
    return name if isinstance(name, str) else None


def _source(spec: Spec, module: str) -> Path | None:
    if module.endswith(".py"):
        return spec.find_file(module)
    dotted = all(part.isidentifier() for part in module.split("."))
    return module_file(module) if dotted else None
