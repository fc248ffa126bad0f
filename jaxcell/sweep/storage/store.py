"""Where the result of a sweep is kept: a Zarr store.

Its files are not written by `xarray.Dataset.to_zarr(region=...)`, which does not wait until values
are on the disk before it writes states, and takes several milliseconds for a chunk.
"""

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

from ... import __version__
from ...base.paths import write_durably
from ...base.revision import git_revision
from ..boxes import by_chunk, inside
from ..failures import Failure, read_report, reported, write_report
from ..files import keep_folder
from ..pending import Pending
from ..spec import Chunk, Spec
from ..workers.halving import Parts
from ..workers.work import Computed, Failed
from .codecs import decoded, encoded, fill_of, kind_of
from .digests import changed, digests
from .frame import (
    check_fits,
    frame_of,
    make_frame,
    read_attributes,
    write_attributes,
)
from .grow import grow, tidy
from .lock import locked
from .states import DAMAGED, DONE, FAILED, States, reading


class SweepStore(States):
    """The folder of a sweep, for the one process that writes there.

    - `sweep.zarr` is the result. A file of it holds a variable for a box of members: a chunk of the
        sweep, or several. About a second after chunks of it have ended it is replaced, that of
        `status` last; a chunk that is not done there is computed again. Nothing in it depends on
        the order of chunks or on the time.
    - `spec.toml` is the specification as it was given, and `origin.json` says where it lay.
    - `failures/` has a file for each chunk of which members failed.
    - `grown/` is there while a sweep grows: the larger store, which is to be put in place.
    - `lock` names the process that writes.
    """

    def __init__(self, folder: Path, spec: Spec, made: Mapping[str, Any]) -> None:
        super().__init__(folder, spec)
        self.made = made
        self._frame: Computed | None = None
        self._pending = Pending(self)

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
                        f"{folder}: a sweep is there; go on with it (--resume), or name another "
                        "folder (--out)"
                    )
                cls._go_on(folder, spec, made, anyway)
            else:
                if (folder / "sweep.zarr").exists():
                    raise FileExistsError(f"{folder / 'sweep.zarr'}: it is there, but no {kept}")
                write_durably(kept, spec.text)
            keep_folder(folder, spec)
            store = cls(folder, spec, made)
            store._frame = frame_of(store) if store.metadata else None
            try:
                yield store
            finally:
                store._pending.close()

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
        return differences(self.folder, self.attributes(), self.made) if self.metadata else []

    def went_on(self, others: Sequence[str] = ()) -> dict[str, Any]:
        """The attribute that says with what a run went on all the same, if one did."""
        if not self.metadata:
            return {}
        notes = [*json.loads(self.attributes().get("resumed_anyway", "[]")), *others]
        return {"resumed_anyway": json.dumps(notes)} if notes else {}

    def read(self, name: str, chunk: Chunk) -> np.ndarray:
        """What is in the files of an array of a chunk, or of a box."""
        if not (values := self.empty(name, chunk)).size:
            return values
        box = self.boxes.around(chunk)
        with reading(self.folder):
            content = self.file(name, box).read_bytes()
            values[...] = decoded(content, self.metadata[name])[inside(chunk, box)]
        return values

    def empty(self, name: str, chunk: Chunk) -> np.ndarray:
        """An array for a chunk, or a box, with nothing in it."""
        metadata = self.metadata[name]
        shape = (*chunk.shape, *metadata["shape"][len(chunk.shape) :])
        return np.full(shape, fill_of(metadata), kind_of(metadata))

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
        files = self.files(box)
        if not self.file("status", box).exists():
            # It was lost, or a run was killed, which leaves some that are whole half written.
            return ["status"] * any(map(os.path.exists, files.values()))
        if (members == DAMAGED).any():
            return ["status"]
        if not (members == DONE).any():
            return []
        found = self.gone(box)
        for name in files.keys() - {*found}:
            try:
                self.read(name, box)
            except (ValueError, OSError):
                found.append(name)
        return sorted(found)

    def forget(self, numbers: Iterable[int]) -> None:
        """Make chunks ones that are to do; files that cannot be read are removed."""
        boxes: dict[int, list[Chunk]] = {}
        for chunk in map(self.spec.chunk, numbers):
            boxes.setdefault(self.boxes.around(chunk).number, []).append(chunk)
        self._members = None
        # The states first: nothing that is done there is ever without its values.
        for name, chunks in itertools.product(("status", *self.variables), boxes.values()):
            box = self.boxes.around(chunks[0])
            path = self.file(name, box)
            try:
                if path.exists():
                    values = self.read(name, box)
                    for chunk in chunks:
                        values[inside(chunk, box)] = fill_of(self.metadata[name])
                    self.put(name, box, values)
            except ValueError:
                path.unlink()

    def check(self, computed: Computed) -> None:
        """Check the result of a job, and make the store for results as the first one.

        **Raises:** `ValueError` if it has not the variables of the first one.
        """
        if self._frame is None:
            self._create(computed)
            self.look()
            self._frame = frame_of(self)
            with reading(self.folder):
                for number in reported(self.folder):
                    for failure in read_report(self.folder, number):
                        self.members()[tuple(failure.index.values())] = FAILED
            for box in self.boxes:
                if (self.members()[box.region] == FAILED).any():
                    self.put("status", box, self.members()[box.region])
        check_fits(self._frame, computed)

    def put(self, name: str, box: Chunk, values: np.ndarray) -> None:
        """Write the file of a box, whole: what it held is lost when the new one is on the disk."""
        if not values.size:
            return
        path = self.file(name, box)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_durably(path, encoded(values, self.metadata[name]))

    def write(self, parts: Parts) -> list[Failure]:
        """Take what is known of the members of a chunk that are missing, to be written soon.

        **Returns:** those that failed.
        """
        chunk = parts.chunk
        failures = [self._failure(chunk, *one) for one in sorted(parts.failed.items())]
        if failures:
            write_report(self.folder, chunk.number, failures)
        if self.metadata:
            self._pending.add(parts)
        return failures

    def _failure(self, chunk: Chunk, place: int, failed: Failed) -> Failure:
        index = self.spec.index(chunk, place)
        return Failure(chunk.number, index, self.spec.member(index), failed.message, failed.trace)

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
    with reading(folder):
        return [
            f"{name}: {attributes.get(name)} there, {here} here"
            for name, here in made.items()
            if name not in ("digests", "git_revision") and attributes.get(name) != here
        ] + changed(json.loads(attributes["digests"]), json.loads(made["digests"]))
