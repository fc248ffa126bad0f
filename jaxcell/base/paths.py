"""Find files, replace files atomically, compute digests, and shorten file names for results."""

import contextlib
import difflib
import glob
import hashlib
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path, PureWindowsPath

from .bundled import bundled_names, with_path
from .process import raise_lost_signal


ADDRESS = re.compile("^(https?|dods):/+")
"""Pattern for the start of an OPeNDAP address; one slash is enough, as `Path` shortens `//`."""
_WILD = re.compile(r"[*?\[]")


def existing(path: str | os.PathLike[str]) -> list[str]:
    """List the file or folder at a path, or all files that match a pattern, sorted by name.

    The address of an OPeNDAP server is returned unchanged.
    """
    name = with_path(os.fspath(path))
    if ADDRESS.match(name) or os.path.exists(name):
        return [name]
    if not _WILD.search(name):
        raise absent(name)
    matching = sorted(glob.glob(name, recursive=True))
    if not matching:
        raise FileNotFoundError(f"{name}: no file matches this pattern")
    return matching


def absent(path: str | os.PathLike[str]) -> FileNotFoundError:
    """Return the error for a missing file, with the name of a similar file or of bundled data."""
    path, known, beside = Path(path), bundled_names(), [""]
    with contextlib.suppress(OSError):
        beside = os.listdir(path.parent)
    stems = {Path(name).stem: str(path.parent / name) for name in beside}
    stems |= {name: f"@{name}" for name in known if not path.suffix or name == path.stem}
    near = difflib.get_close_matches(path.stem, stems, 1, 0.75)
    meant = f"; did you mean {stems[near[0]]}?" if near else ""
    return FileNotFoundError(f"{os.fspath(path)}: there is no such file{meant}")


def files_read(path: Path) -> list[Path]:
    """List the files that are read for a path: matching files, files in folders, images of maps.

    The address of an OPeNDAP server gives an empty list.
    """
    files: list[Path] = []
    for name in map(Path, existing(path)):
        files += sorted(file for file in name.rglob("*") if file.is_file()) if name.is_dir() else []
        if name.is_file():
            files += [name, *_images(name)]
    return files


def visible(folder: Path, pattern: str) -> Iterator[Path]:
    """Find the files that match a pattern in a folder and its subfolders, except hidden ones."""
    for path in folder.rglob(pattern):
        if not any(part.startswith(".") for part in path.relative_to(folder).parts):
            yield path


def _images(path: Path) -> list[Path]:
    """Return the image that a map_server file names, or the one beside the file, if it exists."""
    if path.suffix.lower() not in (".yaml", ".yml"):
        return []
    found = re.search(
        r"^image:\s*[\"']?([^\"'#\n]+?)[\"']?\s*(#.*)?$", path.read_text("utf-8", "replace"), re.M
    )
    named = found[1] if found else ""
    both = path.parent / named, path.parent / PureWindowsPath(named).name
    return [image for image in both if named and image.is_file()][:1]


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield the name of a temporary file or folder, which replaces `path` after a `with` block.

    If the block raises an error, or has lost a signal, the temporary file is removed. So `path` is
    never incomplete.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.parent}")
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    try:
        yield temporary
        raise_lost_signal()
        if temporary.is_dir() and path.is_dir():
            # A folder cannot replace a folder that is not empty.
            os.replace(path, temporary.with_suffix(".old"))
        os.replace(temporary, path)
    except BaseException:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        temporary.unlink(missing_ok=True)
        raise
    shutil.rmtree(temporary.with_suffix(".old"), ignore_errors=True)


def digest(path: Path) -> str:
    """Compute the SHA-256 digest of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def name_in_results(path: str | os.PathLike[str]) -> str:
    """Return the name of a file for results, without folders outside the working directory.

    Bundled data have names such as `@lab_a`. Outer folders are left out because results may be
    shared, and a path may contain the name of a person.
    """
    absolute, here = Path(os.path.abspath(path)), Path.cwd()
    if absolute.is_relative_to(here) and here not in Path(os.path.expanduser("~")).parents:
        return str(absolute.relative_to(here))
    name = absolute.stem
    return f"@{name}" if bundled_names().get(name) == absolute else absolute.name
