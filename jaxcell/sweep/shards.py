"""Shards: parts of a sweep, which the jobs of a job array compute and `merge_sweep` merges."""

import contextlib
import dataclasses
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..base.shown import Shown
from .results import SweepStatus, sweep_status
from .run import no_room_reported
from .storage.digests import made_with
from .storage.export import update_result
from .storage.lock import holder, locked
from .storage.opening import opened
from .storage.store import DONE, SweepStore
from .workers.progress import Count, Progress
from .workers.work import jax_is_wide


_FOLDER = "shards"
_MAX_LISTED = 3


@dataclasses.dataclass(frozen=True)
class Shard(Shown):
    """A part of a sweep: every `count`-th chunk, beginning with chunk `number - 1`.

    The second of three shards of a sweep in ten chunks:

        >>> from jaxcell import sweep
        >>> shard = sweep.Shard.read("2/3")
        >>> [*shard.chunks(10)], str(shard.folder("runs/rooms"))
        ([1, 4, 7], 'runs/rooms/shards/2-of-3')
    """

    number: int
    "The number of the shard, from 1 to `count`."
    count: int
    "The number of shards of the sweep."

    @classmethod
    def read(cls, text: str) -> "Shard":
        """Parse `i/n`, the text for shard number `i` of `n` shards, counted from 1."""
        match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise ValueError(f"shard: expected i/n with i from 1 to n, got {text!r}")
        return cls(int(match[1]), int(match[2]))

    def chunks(self, count: int) -> range:
        """Return the numbers of the chunks of the shard in a sweep of `count` chunks."""
        return range(self.number - 1, count, self.count)

    def folder(self, out: str | os.PathLike[str]) -> Path:
        """Return the folder of the shard's store, inside the folder `out` of the whole sweep."""
        return Path(out) / _FOLDER / f"{self.number}-of-{self.count}"


def merge_sweep(
    out: str | os.PathLike[str], *, progress: Callable[[Progress], None] | None = None
) -> SweepStatus:
    """Merge the shards of a sweep into its store, after all of them are done.

    The result has the same bytes as the result of a run without shards. The shards are kept, but
    may be removed. An interrupted merge continues when the function is called again.

    **Arguments:**

    - `out`: the folder of the sweep, with the folders of its shards.
    - `progress`: as for [`run_sweep`][].

    **Returns:** the progress of the sweep. Members that failed in a shard count as failed.

    **Raises:** `ValueError` if a shard is missing, damaged, or not done, or if shards differ in
    their specification, task, versions, or input files; and the errors of [`run_sweep`][].

    A sweep of two angles, computed as two shards:

        >>> from jaxcell import examples, sweep
        >>> out, spec = examples.folder(), examples.angles(chunk=1)
        >>> for text in ("1/2", "2/2"):
        ...     shard = sweep.Shard.read(text)
        ...     chunks = shard.chunks(spec.chunk_count)
        ...     _ = sweep.run_sweep(spec, shard.folder(out), chunks=chunks)
        >>> status = sweep.merge_sweep(out)
        >>> status.complete, status.done
        (True, 2)
    """
    folder = Path(out)
    shards = _shards(folder)
    with contextlib.ExitStack() as stack:
        stores = [stack.enter_context(SweepStore(shard.folder(folder))) for shard in shards]
        spec = stores[0].spec
        made = made_with(spec, jax_is_wide())
        _check_shards(folder, shards, stores, made)
        stack.enter_context(no_room_reported(folder))
        stack.enter_context(locked(folder / "lock"))
        whole = stack.enter_context(opened(folder, spec, True, made))
        for store in stores:
            if store.frame is not None:
                whole.check(store.frame)
        missing = np.flatnonzero(whole.states != DONE).tolist()
        count = Count(spec.chunk_count, spec.chunk_count - len(missing))
        if progress is not None:
            progress(count.progress(()))
        for number in missing:
            failures = whole.copy(stores[number % len(stores)], number)
            count.add(math.prod(spec.chunk(number).shape))
            if progress is not None:
                progress(count.progress(tuple(failures)))
        update_result(whole)
    return sweep_status(folder)


def _check_shards(
    folder: Path, shards: Sequence[Shard], stores: Sequence[SweepStore], made: Mapping[str, Any]
) -> None:
    spec, unfinished = stores[0].spec, []
    for shard, store in zip(shards, stores, strict=True):
        if (process := holder(store.folder / "lock")) is not None:
            raise BlockingIOError(f"{store.folder}: {process} is at work on it")
        if changes := spec.differences(store.spec):
            raise ValueError(
                f"{store.folder}: not the specification of shard 1: {'; '.join(changes)}"
            )
        if others := store.differences(made):
            raise ValueError(
                f"{store.folder}: made with other versions or files: {'; '.join(others)}"
            )
        chunks = shard.chunks(spec.chunk_count)
        done = sum(map(store.has_outcomes, chunks))
        if done < len(chunks):
            unfinished.append(f"{shard.number}/{shard.count} ({done} of {len(chunks)} chunks)")
    if unfinished:
        raise ValueError(f"{folder}: shards that are not done: {_listed(unfinished)}")


def _shards(folder: Path) -> list[Shard]:
    names = [path.name.replace("-of-", "/") for path in (folder / _FOLDER).glob("*-of-*")]
    shards = [Shard.read(name) for name in names]
    counts = sorted({shard.count for shard in shards})
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
        if Shard(number, counts[0]) not in shards
    ]
    if missing:
        raise ValueError(f"{folder}: shards that are not there: {_listed(missing)}")
    return sorted(shards, key=lambda shard: shard.number)


def _listed(names: Sequence[str]) -> str:
    more = f", ... ({len(names)} in all)" * (len(names) > _MAX_LISTED)
    return ", ".join(names[:_MAX_LISTED]) + more
