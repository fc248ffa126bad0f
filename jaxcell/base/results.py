"""The folder of a result: all files of one run or none, and a manifest that describes them.

A run writes its files into a hidden folder of its folder, which it locks. The manifest lists
the files with their digests, and how they were made. It is written last, so a hidden folder with a
manifest is complete. Only then do the files replace those of an earlier run. If this is
interrupted, the next run completes it first.
"""

import contextlib
import contextvars
import dataclasses
import datetime
import fcntl
import hashlib
import importlib.metadata
import json
import os
import secrets
import shutil
import socket
import sys
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, TextIO

from .. import __version__
from .documents import Fields, NewerVersionError, decode_json, read_text, refused
from .paths import digest, replacing
from .process import signals_deferred
from .revision import git_revision


MANIFEST = "result.json"
"""Name of the manifest in the folder of a result."""
_HIDDEN, _LOCK = ".writing", "lock"
LARGEST_HEADER = 2**24
"""The largest number of bytes of the header of a filter, a policy or a belief."""
_FORMAT, _VERSION = "jaxcell-result", 1
_PACKAGES = ("jax", "jaxlib", "numpy", "scipy")


@dataclasses.dataclass(frozen=True)
class Manifest:
    """The origin of a result, and the SHA-256 of each of its files."""

    name: ClassVar[str] = MANIFEST

    run_id: str
    "The identifier of the run. The files of the result contain it, too."
    words: list[str]
    "The words of the command after `jaxcell`, without `--out`."
    options: Mapping[str, Any]
    "The effective options, keyed by name: the values with which the result was computed."
    inputs: Mapping[str, str]
    "The SHA-256 of each input file, keyed by its name in the options."
    created: str
    versions: Mapping[str, str]
    files: Mapping[str, str]
    "The SHA-256 of each file, keyed by its path in the folder."

    @classmethod
    def of(
        cls,
        folder: Path,
        words: list[str],
        options: Mapping[str, Any],
        inputs: Mapping[str, str],
    ) -> "Manifest":
        """Describe the files in a folder, which the current run wrote with these options."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        run, files = current_run() or secrets.token_hex(8), file_digests(folder)
        return cls(run, words, options, inputs, now, versions(), files)

    @classmethod
    def read(cls, folder: Path) -> "Manifest | None":
        """Read the manifest of a folder; `None` if the folder has none."""
        path = folder / MANIFEST
        if not path.is_file():
            return None
        try:
            document = decode_json(read_text(path), "a manifest")
            if not isinstance(document, dict) or document.get("format") != _FORMAT:
                raise refused("format", _FORMAT, document)
            fields = Fields(document)
            fields.check_version(_VERSION)
            if document.pop("sha256", None) != _digest(document):
                raise ValueError("its own SHA-256 is not that in it: it is damaged")
            texts = {name: fields.texts(name) for name in ("inputs", "versions", "files")}
            return cls(
                run_id=fields.text("run_id"),
                words=[*map(str, fields.needed("words"))],
                options=fields.needed("options"),
                created=fields.text("created"),
                **texts,
            )
        except NewerVersionError as error:
            raise NewerVersionError(f"{path}: {error}") from None
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def write(self, folder: Path) -> None:
        document = {"format": _FORMAT, "version": _VERSION, **dataclasses.asdict(self)}
        text = json.dumps({**document, "sha256": _digest(document)}, indent=2)
        with replacing(folder / MANIFEST) as path, path.open("w", encoding="utf-8") as file:
            file.write(text + "\n")
            file.flush()
            os.fsync(file.fileno())

    def damage(self, folder: Path) -> list[str]:
        """Name the files of the folder that are missing, altered, or of another run."""
        return [
            name
            for name, expected in self.files.items()
            if not (folder / name).is_file() or digest(folder / name) != expected
        ] + self.strangers(folder)

    def strangers(self, folder: Path) -> list[str]:
        """Name the files of the folder that have the identifier of another run."""
        return [name for name in self.unlisted(folder) if self.is_stranger(folder / name)]

    def unlisted(self, folder: Path) -> list[str]:
        """Name the visible files of the folder that the result does not list."""
        known = {MANIFEST, *self.files}
        return [
            path.name
            for path in sorted(folder.iterdir())
            if path.name not in known and path.is_file() and not path.name.startswith(".")
        ]

    def is_stranger(self, path: Path) -> bool:
        """Check whether a file that is not listed has the identifier of another run."""
        run = _run_of(path)
        return run is not None and run != self.run_id


def _run_of(path: Path) -> str | None:
    """Read the identifier of the run that wrote a file; `None` if the file has none."""
    document: Any = None
    with contextlib.suppress(ValueError, OSError, KeyError, zipfile.BadZipFile):
        if path.suffix == ".json":
            document = decode_json(read_text(path), "a file")
        elif path.suffix in (".jxf", ".jxb"):
            with zipfile.ZipFile(path) as parts, parts.open("header.npy") as header:
                # The text of the header follows the line that describes the array.
                document = json.loads(header.read(LARGEST_HEADER).partition(b"\n")[2])
    return document.get("run_id") if isinstance(document, dict) else None


def _digest(document: Any) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def versions() -> dict[str, str]:
    """Return the versions of the software that affects a result."""
    installed = {"jaxcell": __version__, "python": sys.version.split()[0]}
    for package in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            installed[package] = importlib.metadata.version(package)
    revision = git_revision()
    return installed if revision is None else {**installed, "git_revision": revision}


def file_digests(folder: Path) -> dict[str, str]:
    """Compute the SHA-256 of each file in a folder and its subfolders, keyed by relative path."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    own = {folder / MANIFEST, folder / _LOCK}
    return {path.relative_to(folder).as_posix(): digest(path) for path in files if path not in own}


_RUN: contextvars.ContextVar[str | None] = contextvars.ContextVar("run", default=None)


def current_run() -> str | None:
    """Return the identifier of the run whose [`result_folder`][] is open; `None` if none is."""
    return _RUN.get()


@contextlib.contextmanager
def repeating(run: str) -> Iterator[None]:
    """Give the next [`result_folder`][] in a `with` block the identifier of an earlier run.

    The same computation then writes the same bytes again.
    """
    token = _RUN.set(run)
    try:
        yield
    finally:
        _RUN.reset(token)


def shown_folder(path: Path) -> Path:
    """Return the folder in which a file will be after its run."""
    return path.parent.parent if path.parent.name == _HIDDEN else path.parent


@contextlib.contextmanager
def result_folder(out: Path) -> Iterator[Path]:
    """Yield a hidden folder, whose files become those of the folder `out` after a `with` block.

    The block must write a [`Manifest`][]; otherwise, or if it raises an error, the hidden folder is
    removed. Files of the last result in `out` are replaced; other files there are kept. Inside the
    block, [`current_run`][] is the identifier of the run: a new one, or that of [`repeating`][].

    **Raises:** `BlockingIOError` if another process writes a result to `out`.
    """
    created = not out.exists()
    hidden = out / _HIDDEN
    lock, earlier = None, True
    token = _RUN.set(current_run() or secrets.token_hex(8))
    try:
        # A signal that comes here is raised where the folder is removed again.
        with signals_deferred():
            lock = _lock(hidden)
        _complete(hidden, out)
        earlier = False
        for leftover in hidden.iterdir():
            if leftover.name != _LOCK:
                _remove(leftover)
        yield hidden
        _complete(hidden, out)
    finally:
        _RUN.reset(token)
        if lock is not None:
            with signals_deferred(), lock:
                # The files of an earlier run are kept until they are complete.
                if not (earlier and interrupted(out)):
                    shutil.rmtree(hidden, ignore_errors=True)
                if created:
                    # It stays if there are files in it.
                    with contextlib.suppress(OSError):
                        out.rmdir()


def interrupted(folder: Path) -> bool:
    """Return whether a run was interrupted while it replaced the files of a folder."""
    return (folder / _HIDDEN / MANIFEST).exists()


def check_result(path: Path) -> None:
    """Raise `ValueError` if a file, or a file in a folder, is not of the run of its manifest.

    Files without a manifest beside them are accepted.
    """
    folder = path if path.is_dir() else path.parent
    if interrupted(folder):
        raise ValueError(
            f"{folder}: a run was interrupted while it replaced the files there; "
            f"to complete it: jaxcell verify --mend {folder}"
        )
    if (manifest := Manifest.read(folder)) is None:
        return
    if path.is_dir():
        damage = manifest.damage(folder)
    elif path.name in manifest.files:
        damage = [path.name] * (manifest.files[path.name] != digest(path))
    else:
        damage = [path.name] * manifest.is_stranger(path)
    if damage:
        raise ValueError(
            f"{folder}: {', '.join(damage[:3])}{', ...' * (len(damage) > 3)}: not the files that "
            f"run {manifest.run_id} wrote ({MANIFEST}): damaged, or of another run; "
            f"to compute them again: jaxcell verify --mend {folder}"
        )


def _lock(hidden: Path) -> TextIO:
    """Create a hidden folder if it is missing, and lock it until the returned file is closed."""
    while True:
        hidden.mkdir(parents=True, exist_ok=True)
        # Another process may remove the folder before the lock is held.
        with contextlib.suppress(FileNotFoundError), contextlib.ExitStack() as stack:
            file = stack.enter_context(open(hidden / _LOCK, "a+", encoding="utf-8"))
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                by = (hidden / _LOCK).read_text(encoding="utf-8") or "another process"
                raise BlockingIOError(f"{hidden.parent}: {by} writes a result to it") from None
            if os.path.samestat(os.fstat(file.fileno()), (hidden / _LOCK).stat()):
                file.truncate(0)
                file.write(f"process {os.getpid()} on {socket.gethostname()}")
                file.flush()
                stack.pop_all()
                return file


def _complete(hidden: Path, out: Path) -> None:
    """Replace the files of the result in `out` by those of a hidden folder with a manifest."""
    if (new := Manifest.read(hidden)) is None:
        return
    with signals_deferred():
        try:
            old = Manifest.read(out)
        except ValueError:
            old = None
        tops = {name.partition("/")[0] for name in new.files}
        for name in {name.partition("/")[0] for name in (old.files if old else ())} - tops:
            _remove(out / name)
        for name in sorted(tops):
            # A missing file was moved before an interruption.
            if (hidden / name).exists():
                if (hidden / name).is_dir():
                    _remove(out / name)
                os.replace(hidden / name, out / name)
        os.replace(hidden / MANIFEST, out / MANIFEST)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
