"""Open the store of a sweep for a run, which begins, resumes or enlarges the sweep."""

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...base.paths import replacing
from ..spec import Spec
from .journal import JOURNAL, Journal, Kind, Record
from .records import Begun, Contents, encode
from .store import DONE, TO_DO, SweepStore


@contextlib.contextmanager
def opened(
    folder: Path, spec: Spec, resume: bool, made: Mapping[str, Any], anyway: bool = False
) -> Iterator[SweepStore]:
    """Open the store of a sweep, which the caller has locked, for a run.

    `made` is from `made_with`; the other arguments and the errors are those of `run_sweep`. If the
    specification adds members to an existing sweep, the sweep is enlarged.
    """
    tidy(folder)
    if not (folder / JOURNAL).exists():
        if (folder / "sweep.zarr").exists():
            raise FileExistsError(
                f"{folder / 'sweep.zarr'} exists, but {folder / JOURNAL} does not"
            )
        write_journal(folder, Begun.of(spec, folder, made))
    elif not resume:
        raise FileExistsError(
            f"{folder}: a sweep is there; continue it (--resume), or name another folder (--out)"
        )
    with contextlib.ExitStack() as stack:
        store = stack.enter_context(SweepStore(folder, append=True))
        if _prepare(store, spec, made, anyway):
            store = stack.enter_context(SweepStore(folder, append=True))
        copy_spec(store)
        try:
            yield store
        finally:
            # The disk may be full.
            with contextlib.suppress(OSError):
                store.write_failures()
        store.sync()
        bulky = store.bulky
    if bulky:
        _compact(folder)


def _compact(folder: Path) -> None:
    """Write the journal again without the records that later records replace."""
    with contextlib.closing(Journal(folder / JOURNAL)) as journal:
        contents = Contents.read(journal, check=True)
        if contents.begun is None or contents.damage:
            return
        kinds = (Kind.FRAME, Kind.EXPORT) if contents.exported is not None else (Kind.FRAME,)
        kept = [*contents.chunks.values()]
        kept += [contents.others[kind] for kind in kinds if kind in contents.others]
        kept.sort(key=lambda record: record.start)
        write_journal(folder, contents.begun, journal, kept)


def _prepare(store: SweepStore, spec: Spec, made: Mapping[str, Any], anyway: bool) -> bool:
    """Check and update a store for a run, and return whether it grew and must be reopened."""
    changes = store.spec.differences(spec)
    places = spec.places_in(store.spec) if changes else None
    if changes and places is None:
        raise ValueError(
            f"{spec.path}: not the specification of the sweep in {store.folder}: "
            f"{'; '.join(changes)}"
        )
    others = store.differences(made)
    if others and not anyway:
        raise ValueError(
            f"{store.folder}: made with other versions or files ({'; '.join(others)}); start again "
            "in another folder (--out), or continue with --anyway"
        )
    notes = [*json.loads(store.made.get("resumed_anyway", "[]")), *others]
    if store.frame is not None and not others and places is None:
        made = store.made
    if notes:
        made = {**made, "resumed_anyway": json.dumps(notes)}
    if places is None:
        store.begin(made, spec)
        return False
    _grow(store, spec, places, made)
    return True


def copy_spec(store: SweepStore) -> bool:
    """Repair `spec.toml`, the copy of the specification; return whether it was missing or wrong."""
    path = store.folder / "spec.toml"
    if path.exists() and path.read_bytes() == store.spec.text:
        return False
    with replacing(path) as temporary:
        temporary.write_bytes(store.spec.text)
    return True


def tidy(folder: Path) -> None:
    """Remove temporary files of killed runs."""
    for stem in ("sweep", "spec", "failures", "progress"):
        for path in folder.glob(f".{stem}-????????*"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def write_journal(
    folder: Path, begun: Begun, old: Journal | None = None, records: Iterable[Record] = ()
) -> None:
    """Write a journal atomically, with the record `begun` and `records` from an `old` journal."""
    with replacing(folder / JOURNAL) as temporary:
        journal = Journal(temporary, append=True)
        journal.append(Kind.SPEC, encode(begun))
        for record in records:
            assert old is not None
            journal.append(record.kind, old.content(record), record.number, record.state)
        journal.sync()
        journal.close()


def _grow(
    store: SweepStore, spec: Spec, places: Mapping[str, np.ndarray], made: Mapping[str, Any]
) -> None:
    """Replace a store by the store of a larger specification, and keep the members that are done.

    `places` is from `Spec.places_in`. The old journal is replaced once the new one is on the disk.
    """
    with tempfile.TemporaryDirectory(prefix=".sweep-", dir=store.folder) as name:
        temporary = Path(name)
        write_journal(temporary, Begun.of(spec, store.folder, made))
        with SweepStore(temporary, append=True) as large:
            if store.frame is not None:
                large.check(store.frame)
            for number in range(spec.chunk_count):
                _copy_members(store, large, number, places)
            large.sync()
        os.replace(temporary / JOURNAL, store.folder / JOURNAL)


def _copy_members(
    store: SweepStore, large: SweepStore, number: int, places: Mapping[str, np.ndarray]
) -> None:
    """Fill chunk `number` of `large` with the members that are done in the smaller `store`."""
    chunk = large.spec.chunk(number)
    sources = [places[name][part] for name, part in zip(places, chunk.region, strict=True)]
    inside = [np.flatnonzero(source >= 0) for source in sources]
    old_states, old_arrays = store.select(
        [source[own] for source, own in zip(sources, inside, strict=True)]
    )
    if not (old_states == DONE).any():
        return
    states, arrays = large.empty(chunk.shape)
    target = np.ix_(*inside)
    states[target] = np.where(old_states == DONE, DONE, TO_DO)
    for variable, array in arrays.items():
        array[target] = old_arrays[variable]
    large.put(chunk, states, arrays, {})
