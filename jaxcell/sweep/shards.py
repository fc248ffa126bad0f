"""Sweeps in shards: jobs of an array compute a part each, and `merge_sweep` puts them together."""

import dataclasses
import os
import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from .files import kept_spec
from .results import SweepStatus
from .run import run_sweep
from .storage.frame import frame_of
from .storage.lock import holder
from .storage.states import DONE, FAILED
from .storage.store import SweepStore, made_with
from .workers.engines import Outcomes, Take
from .workers.progress import Progress
from .workers.work import Computed, Failed, Job, jax_is_wide


_FOLDER = "shards"
_MAX_LISTED = 3


@dataclasses.dataclass(frozen=True)
class Shard:
    """One of several parts of a sweep: every so many chunks one.

    The second of three shards of a sweep in ten chunks:

        >>> from jaxcell import sweep
        >>> shard = sweep.Shard.read("2/3")
        >>> [*shard.chunks(10)], str(shard.folder("runs/rooms"))
        ([1, 4, 7], 'runs/rooms/shards/2-of-3')
    """

    number: int
    "From 1."
    count: int

    @classmethod
    def read(cls, text: str) -> "Shard":
        """A shard of the form `i/n`, from `1/n` to `n/n`.

        **Raises:** `ValueError` for another text.
        """
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
        if found is None or not 1 <= int(found[1]) <= int(found[2]):
            raise ValueError(f"shard: expected i/n with i from 1 to n, got {text!r}")
        return cls(int(found[1]), int(found[2]))

    def chunks(self, count: int) -> range:
        """The numbers of its chunks of so many."""
        return range(self.number - 1, count, self.count)

    def folder(self, out: str | os.PathLike[str]) -> Path:
        """Its store, within that of the whole sweep."""
        return Path(out) / _FOLDER / f"{self.number}-of-{self.count}"


def merge_sweep(
    out: str | os.PathLike[str], *, progress: Callable[[Progress], None] | None = None
) -> SweepStatus:
    """Put the shards of a sweep together, once all of them are done.

    The result has the bytes of a run without shards. The shards stay, and may be removed then. A
    merge that was interrupted goes on when it is called again.

    **Arguments:**

    - `out`: the folder of the sweep: its shards are in those of [`Shard`][].
    - `progress`: as for [`run_sweep`][].

    **Returns:** the progress of the sweep. Members that failed in a shard have failed in it too.

    **Raises:** `ValueError` if a shard is missing, damaged, not done, or of another specification,
    or if it was computed with other files, another task or other versions than are here;
    `BlockingIOError` if a run is at work on one; and as [`run_sweep`][] for the result.

    Two shards of two angles:

        >>> import pathlib, tempfile
        >>> from jaxcell import bundled, sweep
        >>> lab = bundled("maps/lab_a.json")
        >>> lines = (
        ...     'task = "groups"', "chunk = 1", "[grid]", "bounce = [45, 135]",
        ...     "[fixed]", f'map = "{lab}"',
        ... )
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path, out = pathlib.Path(folder, "spec.toml"), pathlib.Path(folder, "out")
        ...     _ = path.write_text("\\n".join(lines))
        ...     spec = sweep.Spec.load(path)
        ...     for text in ("1/2", "2/2"):
        ...         shard = sweep.Shard.read(text)
        ...         chunks = shard.chunks(spec.chunk_count)
        ...         _ = sweep.run_sweep(spec, shard.folder(out), chunks=chunks)
        ...     found = sweep.merge_sweep(out)
        >>> found.complete, found.done
        (True, 2)
    """
    folder = Path(out)
    shards = _shards(folder)
    specs = [kept_spec(shard.folder(folder)) for shard in shards]
    spec = specs[0]
    made = made_with(spec, jax_is_wide())
    readers, unfinished = [], []
    for shard, own in zip(shards, specs, strict=True):
        there = shard.folder(folder)
        if (process := holder(there / "lock")) is not None:
            raise BlockingIOError(f"{there}: {process} is at work on it")
        if changes := spec.differences(own):
            raise ValueError(f"{there}: not the specification of shard 1: {'; '.join(changes)}")
        store = SweepStore(there, own, made)
        if others := store.differences():
            raise ValueError(f"{there}: computed with others: {'; '.join(others)}")
        readers.append(_Reader(store))
        chunks = shard.chunks(spec.chunk_count)
        done = sum(map(readers[-1].has, chunks))
        if done < len(chunks):
            unfinished.append(f"{shard.number}/{shard.count} ({done} of {len(chunks)} chunks)")
    if unfinished:
        raise ValueError(f"{folder}: shards that are not done: {_listed(unfinished)}")

    def read(take: Take) -> Outcomes:
        for job in iter(take, None):
            yield job, readers[job.number % len(readers)].outcome(job)

    return run_sweep(spec, folder, engine=read, resume=True, progress=progress)


def _shards(folder: Path) -> list[Shard]:
    """The shards of a sweep that are there.

    **Raises:** `ValueError` if one is missing.
    """
    names = [path.name.replace("-of-", "/") for path in (folder / _FOLDER).glob("*-of-*")]
    found = [Shard.read(name) for name in names]
    counts = sorted({shard.count for shard in found})
    if not counts:
        raise ValueError(
            f"{folder}: there are no shards to merge; jaxcell sweep SPEC --shard I/N makes one"
        )
    if len(counts) > 1:
        are = " and ".join(map(str, counts))
        raise ValueError(f"{folder / _FOLDER}: expected the shards 1/n to n/n, got {are} for n")
    missing = [
        f"{number}/{counts[0]}"
        for number in range(1, counts[0] + 1)
        if Shard(number, counts[0]) not in found
    ]
    if missing:
        raise ValueError(f"{folder}: shards that are not there: {_listed(missing)}")
    return sorted(found, key=lambda shard: shard.number)


def _listed(some: Sequence[str]) -> str:
    more = f", ... ({len(some)} in all)" * (len(some) > _MAX_LISTED)
    return ", ".join(some[:_MAX_LISTED]) + more


class _Reader:
    """The outcomes that are in the store of a shard."""

    def __init__(self, store: SweepStore) -> None:
        self._store, self._states = store, store.states()
        self._frame = frame_of(store)
        failures = [*store.failures(self._states)]
        self._failures = {tuple(one.index.values()): one for one in failures}
        self._failed = Counter(one.chunk for one in failures)

    def has(self, number: int) -> bool:
        """Whether all members of a chunk are done or have failed."""
        if self._states[number] != FAILED:
            return bool(self._states[number] == DONE)
        missing = self._store.missing(self._store.spec.chunk(number))
        return int(missing.sum()) == self._failed[number]

    def outcome(self, job: Job) -> Computed | Failed:
        """The outcome of a job: a failure if one of its members failed."""
        store = self._store
        chunk = store.spec.chunk(job.number)
        lengths = tuple(store.spec.lengths.values())
        # At an edge the last member stands in for those beyond.
        inside = [
            np.minimum(places, size - 1)
            for places, size in zip(np.unravel_index(job.places, lengths), chunk.shape, strict=True)
        ]
        starts = [part.start for part in chunk.region]
        for row in zip(*inside, strict=True):
            place = tuple(start + int(one) for start, one in zip(starts, row, strict=True))
            if (failure := self._failures.get(place)) is not None:
                return Failed(failure.message, failure.trace)
        variables = {
            name: dataclasses.replace(one, values=store.read(name, chunk)[tuple(inside)])
            for name, one in self._frame.variables.items()
        }
        return dataclasses.replace(self._frame, variables=variables)
