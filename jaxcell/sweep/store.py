"""Where the result of a sweep is kept: a Zarr store, written chunk by chunk."""

import contextlib
import importlib.metadata
import itertools
import json
import os
import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from .. import __version__
from ..base.files import replacing
from ..base.revision import git_revision
from .boxes import Boxes, by_chunk
from .digests import changed, digests
from .failures import Failure, read_report, reported, write_report
from .files import keep_folder
from .frame import (
    DONE,
    FAILED,
    TO_DO,
    check_fits,
    frame_of,
    has_checksums,
    make_frame,
    open_arrays,
    read_attributes,
    variables_of,
    write_attributes,
)
from .grow import grow, tidy
from .lock import locked
from .pending import Pending
from .spec import Chunk, Spec
from .workers.halving import Parts
from .workers.work import Computed, Failed


# A state that is in no file: something of the chunk is gone, or cannot be read.
DAMAGED = 3


@contextlib.contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Turn all that readers of a damaged store raise into a `ValueError` that names it."""
    try:
        yield
    except Exception as error:  # Zarr and its codecs have errors of many types.
        message = " ".join(str(error).split())[:500]
        if isinstance(error, ValueError | OSError) and str(folder) in message:
            raise
        reason = f"{type(error).__name__}: {message}" if message else type(error).__name__
        raise ValueError(
            f"{folder}: the sweep there is damaged: {reason}; to mend it: "
            f"jaxcell sweep verify {folder}"
        ) from error


class SweepStore:
    """The folder of a sweep, for the one process that writes there.

    - `sweep.zarr` is the result. A file of it holds a variable for a box of members: a chunk of the
        sweep, or several. When chunks of it have ended it is replaced, that of `status` last; a
        chunk that is not done there is computed again. Nothing in it depends on the order of chunks
        or on the time.
    - `spec.toml` is the specification as it was given, and `origin.json` says where it lay.
    - `failures/` has a file for each chunk of which members failed.
    - `grown/` is there while a sweep grows: the larger store, which is to be put in place.
    - `lock` names the process that writes.
    """

    def __init__(self, folder: Path, spec: Spec, made: Mapping[str, Any]) -> None:
        self.folder = folder
        self.spec = spec
        self.made = made
        self.zarr = folder / "sweep.zarr"
        self.arrays: dict[str, zarr.Array] = {}
        "Of the result; none before a chunk is done."
        self.variables: Mapping[str, tuple[str, ...]] = {}
        "Those of the task, with their dimensions beside those of members."
        self.boxes = Boxes(spec, spec)
        self._states: np.ndarray | None = None
        self._frame: Computed | None = None
        self._pending = Pending(self)
        self._open()

    @classmethod
    @contextlib.contextmanager
    def opened(
        cls,
        folder: Path,
        spec: Spec,
        resume: bool,
        made: Mapping[str, Any],
        anyway: bool = False,
    ) -> Iterator["SweepStore"]:
        """Make the folder, or open it again, and keep others out of it.

        A sweep that is there grows if the specification has all its members, and others.

        **Raises:** `FileExistsError` if a sweep is there, and not to be resumed; `ValueError` if it
        is of another specification, or was made with other versions or other files, unless it is to
        go on `anyway`; `BlockingIOError` if another process is at work on it.
        """
        folder.mkdir(parents=True, exist_ok=True)
        with locked(folder / "lock"):
            tidy(folder)
            kept = folder / "spec.toml"
            if kept.exists():
                if not resume:
                    raise FileExistsError(
                        f"{folder}: a sweep is there; resume it, or name another folder"
                    )
                cls._go_on(folder, spec, made, anyway)
            else:
                if (folder / "sweep.zarr").exists():
                    raise FileExistsError(f"{folder / 'sweep.zarr'}: it is there, but no {kept}")
                with replacing(kept) as temporary:
                    temporary.write_bytes(spec.text)
            keep_folder(folder, spec)
            store = cls(folder, spec, made)
            try:
                yield store
            finally:
                store._pending.write()

    @classmethod
    def _go_on(cls, folder: Path, spec: Spec, made: Mapping[str, Any], anyway: bool) -> None:
        """Make a sweep that is there one of a specification, if it can be."""
        there = Spec.load(folder / "spec.toml")
        changes = there.differences(spec)
        places = spec.places_in(there) if changes else None
        if changes and places is None:
            raise ValueError(
                f"{spec.path}: not the specification of the sweep in {folder}: {'; '.join(changes)}"
            )
        store = cls(folder, there, made)
        others = store.differences()
        if others and not anyway:
            raise ValueError(
                f"{folder}: begun with others: {'; '.join(others)}; what is there can be computed "
                "anew in another folder, or the rest with these by --anyway"
            )
        if others:
            write_attributes(store.zarr, {**store.attributes(), **made, **store.went_on(others)})
        if places is not None:
            grow(store, spec, places, {**made, **store.went_on()})

    def attributes(self) -> dict[str, Any]:
        """Those of the result."""
        with reading(self.folder):
            return read_attributes(self.zarr)

    def differences(self) -> list[str]:
        """What has changed since the result was made: versions, files, the task."""
        return differences(self.folder, self.attributes(), self.made) if self.arrays else []

    def went_on(self, others: Sequence[str] = ()) -> dict[str, Any]:
        """The attribute that says with what a run went on all the same, if one did."""
        if not self.arrays:
            return {}
        notes = [*json.loads(self.attributes().get("resumed_anyway", "[]")), *others]
        return {"resumed_anyway": json.dumps(notes)} if notes else {}

    def states(self) -> np.ndarray:
        """The state of each chunk, by number: failed if a member failed, done if all are done."""
        if not self.arrays:
            states = np.full(self.spec.chunk_count, TO_DO, np.int8)
            with reading(self.folder):
                states[reported(self.folder)] = FAILED
            return states
        members = self.members()
        done = by_chunk(self.spec, np.logical_and, members == DONE)
        failed, damaged = (
            by_chunk(self.spec, np.logical_or, members == state) for state in (FAILED, DAMAGED)
        )
        damaged |= np.array([bool(self._gone(box)) for box in self.boxes])[self.boxes.numbers()]
        damaged &= by_chunk(self.spec, np.logical_or, (members == DONE) | (members == DAMAGED))
        return np.select([damaged, done, failed], [DAMAGED, DONE, FAILED], TO_DO).astype(np.int8)

    def members(self) -> np.ndarray:
        """The state of each member, which `pending` keeps as it is."""
        if self._states is None:
            status = self.arrays["status"]
            try:
                self._states = np.asarray(status[...])
            except Exception:  # Zarr and its codecs have errors of many types.
                self._states = np.full(status.shape, DAMAGED, np.int8)
                for box in self.boxes:
                    with contextlib.suppress(Exception):
                        self._states[box.region] = status[box.region]
        return self._states

    def missing(self, chunk: Chunk) -> np.ndarray:
        """Which members of a chunk are not done."""
        if not self.arrays:
            return np.ones(chunk.shape, bool)
        return self.members()[chunk.region] != DONE

    def read(self, name: str, region: tuple[slice, ...]) -> np.ndarray:
        """What the files of an array hold."""
        with reading(self.folder):
            return np.asarray(self.arrays[name][region])

    def damaged(self) -> dict[int, list[str]]:
        """The arrays of each chunk whose files are gone or cannot be read."""
        members = self.members()
        some = by_chunk(self.spec, np.logical_or, members == DONE)
        held = self.boxes.numbers()
        found = {}
        for box in self.boxes:
            if names := self._unreadable(box, members[box.region]):
                for number in np.flatnonzero(held == box.number).tolist():
                    if some[number] or names == ["status"]:
                        found[number] = names
        return dict(sorted(found.items()))

    def _unreadable(self, box: Chunk, members: np.ndarray) -> list[str]:
        files = self._files(box)
        if not self.file("status", box).exists():
            # It was lost, or a run was killed, which leaves one chunk half written.
            return ["status"] * any(map(os.path.exists, files.values()))
        if (members == DAMAGED).any():
            return ["status"]
        if not (members == DONE).any():
            return []
        found = self._gone(box)
        for name in files.keys() - {*found}:
            try:
                self.arrays[name][box.region]
            except Exception:  # Zarr and its codecs have errors of many types.
                found.append(name)
        return sorted(found)

    def forget(self, numbers: Iterable[int]) -> None:
        """Make chunks ones that are to do; files that cannot be read are removed."""
        chunks = [self.spec.chunk(number) for number in numbers]
        self._states = None
        # The states first: nothing that is done there is ever without its values.
        for name, chunk in itertools.product(("status", *self.variables), chunks):
            path = self.file(name, self.boxes.around(chunk))
            try:
                if path.exists():
                    self.arrays[name][chunk.region] = self.arrays[name].fill_value
            except OSError:
                raise
            except Exception:  # Zarr and its codecs have errors of many types.
                path.unlink()

    def _gone(self, box: Chunk) -> list[str]:
        """The variables whose file of a box is not there."""
        if not has_checksums(self.arrays["status"]):
            return []  # Then boxes of nothing but the fill value have no files.
        return [name for name, path in self._files(box).items() if not os.path.exists(path)]

    def _files(self, box: Chunk) -> dict[str, Path]:
        """The files of a box for the variables of the task."""
        inner = len(self.spec.dimensions)
        names = [name for name in self.variables if all(self.arrays[name].shape[inner:])]
        return {name: self.file(name, box) for name in names}

    def file(self, name: str, box: Chunk) -> Path:
        index = box.index + (0,) * len(self.variables.get(name, ()))
        return self.zarr.joinpath(name, "c", *map(str, index))

    def failures(self, states: np.ndarray) -> Iterator[Failure]:
        """The members that failed, by the states of their chunks."""
        for number in reported(self.folder):
            # A report may outlive its failure by a moment.
            with reading(self.folder), contextlib.suppress(FileNotFoundError):
                if states[number] == FAILED:
                    yield from read_report(self.folder, number)

    def check(self, computed: Computed) -> None:
        """Check the result of a job, and make the store for results as the first one.

        **Raises:** `ValueError` if it has not the variables of the first one.
        """
        if not self.arrays:
            self._create(computed)
            self._open()
            with reading(self.folder):
                for number in reported(self.folder):
                    for failure in read_report(self.folder, number):
                        self.arrays["status"][tuple(failure.index.values())] = FAILED
        if self._frame is None:
            self._frame = frame_of(self.spec, self.arrays)
        check_fits(self._frame, computed)

    def write(self, parts: Parts) -> list[Failure]:
        """Take what is known of the members of a chunk that are missing, to be written soon.

        **Returns:** those that failed.
        """
        chunk = parts.chunk
        failures = [self._failure(chunk, *one) for one in sorted(parts.failed.items())]
        if failures:
            write_report(self.folder, chunk.number, failures)
        if self.arrays:
            self._pending.add(parts)
        return failures

    def _failure(self, chunk: Chunk, place: int, failed: Failed) -> Failure:
        index = self.spec.index(chunk, place)
        return Failure(chunk.number, index, self.spec.member(index), failed.message, failed.trace)

    def _open(self) -> None:
        if not self.zarr.exists():
            return
        sizes = tuple(self.spec.dimensions.values())
        with reading(self.folder):
            self.arrays = open_arrays(self.zarr)
            if "status" not in self.arrays or self.arrays["status"].shape != sizes:
                raise ValueError(f"expected a status of shape {sizes}")
            self.variables = variables_of(self.spec, self.arrays)
            self.boxes = Boxes.of_lengths(self.spec, self.arrays["status"].chunks)

    def _create(self, first: Computed) -> None:
        """Make the result with nothing in it."""
        temporary = self.folder / f".sweep-{secrets.token_hex(4)}"
        make_frame(temporary, self.spec, first, self.made)
        os.replace(temporary, self.zarr)


def made_with(spec: Spec, wide: bool) -> dict[str, Any]:
    """What the numbers in a store may depend on beside its specification."""
    revision = git_revision()
    return {
        "jaxcell_version": __version__,
        "jax_version": importlib.metadata.version("jax"),
        "jax_enable_x64": int(wide),
        "digests": json.dumps(digests(spec)),
        **({} if revision is None else {"git_revision": revision}),
    }


def differences(folder: Path, attributes: Mapping[str, Any], made: Mapping[str, Any]) -> list[str]:
    """What has changed since a result was made, by its attributes."""
    if "digests" not in attributes:
        raise ValueError(
            f"{folder}: an old version of jaxcell wrote it, without checksums; it can be read, but "
            "not verified or resumed"
        )
    with reading(folder):
        return [
            f"{name}: {attributes.get(name)} there, {here} here"
            for name, here in made.items()
            if name not in ("digests", "git_revision") and attributes.get(name) != here
        ] + changed(json.loads(attributes["digests"]), json.loads(made["digests"]))
