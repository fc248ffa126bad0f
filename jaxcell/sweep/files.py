"""Where the files lie that a specification names, also when it is read from a store again."""

import json
import os
from pathlib import Path

from ..base.bundled import bundled_names
from ..base.paths import replacing
from .spec import Spec


_ORIGIN = "origin.json"


def folders(spec: Spec) -> list[Path]:
    """Where names of files in a specification may start: its own folder, then the current one."""
    return [*dict.fromkeys((spec.folder.resolve(), Path.cwd()))]


def find_file(spec: Spec, name: str) -> Path | None:
    """The file or folder that a specification names, if there is one."""
    if name.startswith("@"):
        return bundled_names().get(name[1:])
    paths = (folder / name for folder in folders(spec))
    return next((path for path in paths if os.path.exists(path)), None)


def keep_folder(out: Path, spec: Spec) -> None:
    """Keep in a store where the files start that its specification names.

    The path is relative to the store, so that both can be moved together; where they have no
    folder in common, to the current folder.
    """
    there, here = spec.folder.resolve(), out.resolve()
    near = len(os.path.commonpath((there, here))) > 1
    start = here if near else Path.cwd()
    origin = {"from": "store" if near else "current", "folder": os.path.relpath(there, start)}
    with replacing(out / _ORIGIN) as temporary:
        temporary.write_text(json.dumps(origin) + "\n", encoding="utf-8")


def kept_spec(out: Path) -> Spec:
    """Read the specification of a sweep from its store.

    **Raises:** `ValueError` if there is none, or it is damaged.
    """
    path = out / "spec.toml"
    if not path.is_file():
        shards = [*map(str, (out / "shards").glob("*-of-*"))]
        kept = f", but shards, as {min(shards)}: jaxcell sweep merge {out}" if shards else ""
        raise ValueError(f"{out}: expected the folder of a sweep; it has no spec.toml{kept}")
    try:
        origin = json.loads((out / _ORIGIN).read_bytes())
        start = out.resolve() if origin["from"] == "store" else Path.cwd()
        folder = (start / origin["folder"]).resolve()
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        # Names that are whole, or start from the current folder, are found all the same.
        return Spec.load(path)
    return Spec.load(path, folder)
