"""Paths of files: find them, replace them at once, and name them in results."""

import contextlib
import glob
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from .bundled import bundled_names


ADDRESS = re.compile("^(https?|dods):/+")
"""The beginning of the address of an OPeNDAP server; a path has one slash of the two."""
_WILD = re.compile(r"[*?\[]")


def existing(path: str | os.PathLike[str]) -> list[str]:
    """Find the file or folder of a path, or all that match a pattern, in the order of names.

    The address of a server is returned as it is.
    """
    name = os.fspath(path)
    if ADDRESS.match(name) or os.path.exists(name):
        return [name]
    if not _WILD.search(name):
        raise FileNotFoundError(f"{name}: there is no such file")
    matching = sorted(glob.glob(name, recursive=True))
    if not matching:
        raise FileNotFoundError(f"{name}: no file has a name of this pattern")
    return matching


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give the name of a new file beside `path`, which replaces it when the block ends.

    If the block raises, the new file is removed. So `path` never holds half a file. It may be a
    folder too.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.parent}")
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    try:
        yield temporary
        if temporary.is_dir() and path.is_dir():
            # A folder does not take the place of one that has something in it.
            os.replace(path, temporary.with_suffix(".old"))
        os.replace(temporary, path)
    except BaseException:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        temporary.unlink(missing_ok=True)
        raise
    shutil.rmtree(temporary.with_suffix(".old"), ignore_errors=True)


def name_in_results(path: str | os.PathLike[str]) -> str:
    """Name a file for results: by its path below the working directory, or by its own name.

    Bundled data have names such as `@lab_a`. Other absolute paths are left out because results are
    passed on, and a path may contain the name of a person.
    """
    absolute, here = Path(os.path.abspath(path)), Path.cwd()
    if absolute.is_relative_to(here) and here not in Path(os.path.expanduser("~")).parents:
        return str(absolute.relative_to(here))
    name = absolute.stem
    return f"@{name}" if bundled_names().get(name) == absolute else absolute.name
