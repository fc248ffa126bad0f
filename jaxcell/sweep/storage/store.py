"""The store of a sweep: a journal to which a run appends, and the result built from the journal."""

import dataclasses
import itertools
import json
import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...base.paths import replacing
from ..spec import Chunk, Spec
from ..workers.work import Computed, Failed, Failure, Job
from .damage import reading
from .digests import differences
from .journal import JOURNAL, Journal, Kind
from .records import Begun, Contents, Exported, Members, check_fits, decode, encode, fill_value


TO_DO, DONE, FAILED = 0, 1, 2


class SweepStore:
    """The folder of a sweep.

    - `sweep.journal` contains the specification, and records with the results of the chunks.
    - `sweep.zarr` is the result. It is built from the journal when a run ends.
    - `spec.toml` is a copy of the specification.
    - `failures.json` lists the failed members. It is written when a run ends.
    - `lock` contains the name of the process that writes to the store.
    """

    def __init__(self, folder: Path, *, append: bool = False) -> None:
        """Open a store for reading. If `append` is true, check all records, and allow writing.

        Chunks with damaged records become `TO_DO`. The first new record replaces an incomplete one
        at the end.
        """
        path = folder / JOURNAL
        if not path.is_file():
            shards = [*map(str, (folder / "shards").glob("*-of-*"))]
            merge = f"jaxcell sweep merge {shlex.quote(str(folder))}"
            hint = f", but shards, as {min(shards)}: {merge}" if shards else ""
            raise ValueError(f"{folder}: expected the folder of a sweep; it has no {JOURNAL}{hint}")
        self.folder = folder
        self.zarr = folder / "sweep.zarr"
        self._journal = Journal(path, append=append)
        try:
            with reading(folder):
                self.contents = Contents.read(self._journal, check=append)
                if self.contents.begun is None:
                    raise ValueError("its specification cannot be read")
            self.spec = self.contents.begun.spec(folder)
            with reading(folder):
                if self.frame is None and self.contents.damage and (self.states == DONE).any():
                    raise ValueError("its variables cannot be read")
        except BaseException:
            self.close()
            raise
        if append:
            self._journal.append_at(self.contents.readable[-1].end)

    def close(self) -> None:
        self._journal.close()

    def __enter__(self) -> "SweepStore":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def made(self) -> Mapping[str, Any]:
        """The attributes of the result that name the versions, settings and files it depends on."""
        assert self.contents.begun is not None
        return self.contents.begun.made

    @property
    def frame(self) -> Computed | None:
        """The first result, without values, as a template for others; `None` if there is none."""
        return self.contents.frame

    @property
    def states(self) -> np.ndarray:
        """State of each chunk: `FAILED` if a member failed, else `TO_DO` until all are `DONE`."""
        states = np.full(self.spec.chunk_count, TO_DO, np.int8)
        for number, record in self.contents.chunks.items():
            states[number] = record.state
        return states

    def differences(self, made: Mapping[str, Any]) -> list[str]:
        """Describe changes of versions, files and the task since the first result, if any."""
        if self.frame is None:
            return []
        with reading(self.folder):
            return differences(self.made, made)

    def read(self, chunk: Chunk) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Read the states and the variables of the members of a chunk."""
        states, arrays = self.empty(chunk.shape)
        if chunk.number in self.contents.chunks:
            with reading(self.folder):
                self._members(chunk.number).fill(states, arrays)
        return states, arrays

    def select(self, places: Sequence[np.ndarray]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Read the states and variables of members at the indices `places` along each dimension."""
        states, arrays = self.empty(tuple(along.size for along in places))
        lengths = [*self.spec.lengths.values()]
        chunks = [along // length for along, length in zip(places, lengths, strict=True)]
        for index in itertools.product(*map(np.unique, chunks)):
            number = int(np.ravel_multi_index(index, self.spec.chunk_grid))
            if number not in self.contents.chunks:
                continue
            own = [np.flatnonzero(along == i) for along, i in zip(chunks, index, strict=True)]
            target = np.ix_(*own)
            inside = zip(places, own, index, lengths, strict=True)
            source = np.ix_(*(along[chosen] - i * length for along, chosen, i, length in inside))
            chunk_states, chunk_arrays = self.read(self.spec.chunk(number))
            states[target] = chunk_states[source]
            for name, array in arrays.items():
                array[target] = chunk_arrays[name][source]
        return states, arrays

    def empty(self, shape: tuple[int, ...]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Create arrays of states and variables in which no member is done."""
        arrays = {}
        for name, one in ({} if self.frame is None else self.frame.variables).items():
            dtype, inner = one.values.dtype, one.values.shape[1:]
            arrays[name] = np.full((*shape, *inner), fill_value(dtype), dtype)
        return np.full(shape, TO_DO, np.int8), arrays

    def write_failures(self) -> None:
        """Write the failures to `failures.json`, or remove this file if no member failed."""
        path, failures = self.folder / "failures.json", [*self.failures()]
        if not failures:
            path.unlink(missing_ok=True)
            return
        text = json.dumps([dataclasses.asdict(failure) for failure in failures], indent=2)
        with replacing(path) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")

    def failures(self) -> Iterator[Failure]:
        """Yield the failed members, in the order of their chunks."""
        for number, record in sorted(self.contents.chunks.items()):
            if record.state == FAILED:
                with reading(self.folder):
                    failed = self._members(number).failed
                yield from self._failures(number, failed)

    def has_outcomes(self, number: int) -> bool:
        """Return whether each member of a chunk is done or has failed."""
        return number in self.contents.chunks and bool(
            (self.read(self.spec.chunk(number))[0] != TO_DO).all()
        )

    def lost_files(self) -> list[str]:
        names = self.contents.exported or {}
        return [name for name in names if not os.path.exists(self.zarr / name)]

    def begin(self, made: Mapping[str, Any], spec: Spec) -> None:
        """Record new attributes of the result, or a new folder of the specification."""
        begun = Begun.of(spec, self.folder, made)
        begun.text = self.spec.text
        if begun != self.contents.begun:
            self._append(Kind.SPEC, begun)
            self.contents.begun = begun

    def check(self, computed: Computed) -> None:
        """Check that a result has the variables of the first result, or record it as the first."""
        if self.frame is None:
            variables = {
                name: dataclasses.replace(one, values=one.values[:0])
                for name, one in computed.variables.items()
            }
            frame = Computed(variables, computed.coordinates)
            self._append(Kind.FRAME, frame)
            self.contents.frame = frame
        assert self.frame is not None
        check_fits(self.frame, computed)

    def write(self, job: Job, outcome: Computed | Failed) -> list[Failure]:
        """Record the outcome of a job (a failed job has one member), and return the failures."""
        failures: list[Failure] = []
        for number, rows in job.by_chunk():
            chunk, places, new = self.spec.chunk(number), job.places[rows], {}
            states, arrays = self.read(chunk)
            if isinstance(outcome, Failed):
                states.flat[places] = FAILED
                new = dict.fromkeys(places.tolist(), (outcome.message, outcome.trace))
            else:
                states.flat[places] = DONE
                for name, array in arrays.items():
                    members = array.reshape(states.size, *array.shape[states.ndim :])
                    members[places] = outcome.variables[name].values[rows]
            known = self._members(number).failed if number in self.contents.chunks else {}
            others = {place: why for place, why in known.items() if place not in places}
            self.put(chunk, states, arrays, dict(sorted({**others, **new}.items())))
            failures += self._failures(number, new)
        return failures

    def put(
        self,
        chunk: Chunk,
        states: np.ndarray,
        arrays: Mapping[str, np.ndarray],
        failed: Mapping[int, tuple[str, str]],
    ) -> None:
        state = FAILED if (states == FAILED).any() else TO_DO
        state = DONE if (states == DONE).all() else state
        values = arrays if (states == DONE).any() else {}
        self._append(Kind.CHUNK, Members.of(states, values, failed), chunk.number, state)

    def copy(self, other: "SweepStore", number: int) -> list[Failure]:
        """Copy a chunk from another store of the same sweep; return its failed members."""
        with reading(other.folder):
            members = other._members(number)
        self._append(Kind.CHUNK, members, number, other.contents.chunks[number].state)
        return [*self._failures(number, members.failed)]

    def mark_exported(self, files: Mapping[str, str]) -> None:
        """Record that the result is up to date, with the SHA-256 of each of its files."""
        self._append(Kind.EXPORT, Exported(dict(files)))
        self._journal.sync()
        self.contents.exported = files

    def sync(self) -> None:
        self._journal.sync()

    @property
    def bulky(self) -> bool:
        """True if more than a sixth of the journal are records that later ones replace."""
        return 6 * self.contents.superseded > self._journal.size

    def _append(self, kind: Kind, content: Any, number: int = 0, state: int = 0) -> None:
        self.contents.exported = None
        self.contents.put(self._journal.append(kind, encode(content), number, state))

    def _members(self, number: int) -> Members:
        return decode(self._journal.content(self.contents.chunks[number]), Members)

    def _failures(self, number: int, failed: Mapping[int, tuple[str, str]]) -> Iterator[Failure]:
        chunk = self.spec.chunk(number)
        for place, (message, trace) in failed.items():
            index = self.spec.index(chunk, place)
            yield Failure(number, index, self.spec.member(index), message, trace)
