"""Find damaged parts of the store of a sweep, and compute them again."""

import contextlib
import dataclasses
import json
import os
from pathlib import Path

import numpy as np

from ..base.results import file_digests
from ..base.shown import Shown
from .results import sweep_status
from .run import run_sweep
from .spec import Spec
from .storage.damage import reading
from .storage.digests import differences, made_with
from .storage.export import export, update_result
from .storage.journal import JOURNAL, Journal, Kind
from .storage.lock import holder, locked
from .storage.opening import copy_spec, tidy, write_journal
from .storage.records import Begun, Contents
from .storage.store import DONE, SweepStore
from .workers.engines import engine_named
from .workers.work import jax_is_wide


_BYTE, _SPEC = f"{JOURNAL}, byte", f"{JOURNAL}, spec"


@dataclasses.dataclass(frozen=True)
class Verified(Shown):
    """The damage that [`verify_sweep`][] found, and how much of it was repaired."""

    chunks: int
    "The number of chunks of the sweep."
    damaged: tuple[str, ...]
    "The names of damaged chunks, of other damaged records of the journal, and of damaged files."
    recomputed: int
    "The number of entries of `damaged` that were repaired; 0 if they were only counted."
    done: int
    "The number of chunks whose members are all done."

    @property
    def whole(self) -> bool:
        """True if all damage was repaired."""
        return self.recomputed == len(self.damaged)


def verify_sweep(
    out: str | os.PathLike[str],
    *,
    mend: bool = False,
    engine: str = "local",
    workers: int | None = None,
) -> Verified:
    """Check the whole store of a sweep; with `mend`, compute damaged parts again.

    Every record of the journal and every file of the result has a checksum. Without `mend`, nothing
    is written, and the task does not run. With it, chunks with damaged records are computed again.
    If the chunk of a damaged record is unknown, all chunks that are not done are computed. Damaged
    files are written again.

    **Arguments:**

    - `out`: the folder of the store.
    - `mend`: whether to repair the store.
    - `engine`, `workers`: as for [`run_sweep`][].

    **Returns:** [`Verified`][].

    **Raises:** `ValueError` if chunks are damaged, and the versions, the task or the input files
    have changed since they were computed; `BlockingIOError` if a run writes to the sweep.

    A byte of a result is changed:

        >>> from jaxcell import examples, sweep
        >>> out = examples.folder()
        >>> _ = sweep.run_sweep(examples.angles(), out)
        >>> file = out / "sweep.zarr" / "count" / "c" / "0"
        >>> _ = file.write_bytes(b"?" + file.read_bytes()[1:])
        >>> verified = sweep.verify_sweep(out)
        >>> verified.damaged, verified.recomputed, verified.whole
        (('sweep.zarr/count/c/0',), 0, False)
        >>> sweep.verify_sweep(out, mend=True).whole
        True
    """
    folder = Path(out)
    engine_named(engine, workers)  # Raises an error for an unknown engine.
    if not (folder / JOURNAL).is_file():
        SweepStore(folder)  # Raises an error that says what the folder has.
    if not mend:
        return _checked(folder)
    with locked(folder / "lock"):
        tidy(folder)
        damage, numbers, were_done = _mend_journal(folder)
        with SweepStore(folder) as store:
            spec = store.spec
            if copy_spec(store):
                damage.append("spec.toml")
            lost = _lost_files(folder, store.contents)
            damage += lost
    if numbers:
        run_sweep(spec, folder, engine=engine, workers=workers, resume=True, chunks=numbers)
    with locked(folder / "lock"), SweepStore(folder, append=True) as store:
        if lost:
            export(store)
        elif store.zarr.exists():
            update_result(store)
        store.write_failures()
        done = {*np.flatnonzero(store.states == DONE).tolist()}
    unmended = {f"chunk {number}" for number in were_done - done}
    if not done.issuperset(numbers):
        unmended |= {line for line in damage if _BYTE in line}
    mended = len(damage) - len(unmended)
    return Verified(spec.chunk_count, tuple(damage), mended, sweep_status(folder).done)


def _checked(folder: Path) -> Verified:
    """List the damage of a sweep, without writing to it."""
    if by := holder(folder / "lock"):
        raise BlockingIOError(f"{folder}: {by} writes to it")
    with contextlib.closing(Journal(folder / JOURNAL)) as journal, reading(folder):
        contents = Contents.read(journal, check=True)
    copy = folder / "spec.toml"
    damage = [*contents.damage]
    if contents.begun is None:
        damage += [] if _SPEC in damage else [_SPEC]
        spec = Spec.load(copy)
    else:
        spec = contents.begun.spec(folder)
        if not copy.exists() or copy.read_bytes() != spec.text:
            damage.append(copy.name)
    damage += _lost_files(folder, contents)
    done = sum(record.state == DONE for record in contents.chunks.values())
    return Verified(spec.chunk_count, tuple(damage), 0, done)


def _lost_files(folder: Path, contents: Contents) -> list[str]:
    """Name the files of the result that are missing or altered."""
    expected = contents.exported or {}
    zarr = folder / "sweep.zarr"
    files = file_digests(zarr) if expected and zarr.exists() else {}
    return [f"{zarr.name}/{name}" for name in expected if files.get(name) != expected[name]]


def _mend_journal(folder: Path) -> tuple[list[str], list[int], set[int]]:
    """Remove the damaged records from the journal of a sweep.

    **Returns:** descriptions of the damage, the numbers of the chunks to compute, and the numbers
    of the damaged chunks that had been done.
    """
    with contextlib.closing(Journal(folder / JOURNAL)) as journal:
        with reading(folder):
            contents = Contents.read(journal, check=True)
        damage = [*contents.damage]
        if contents.begun is None and _SPEC not in damage:
            damage.insert(0, _SPEC)
        if not damage:
            return [], [], set()
        begun = contents.begun
        if begun is None:
            spec = Spec.load(folder / "spec.toml")
            notes = ["the attributes were damaged, and are those of the run that mended them"]
            made = made_with(spec, jax_is_wide())
            begun = Begun.of(spec, folder, {**made, "resumed_anyway": json.dumps(notes)})
        spec = begun.spec(folder)
        damaged = [record for record in contents.damage.values() if record is not None]
        numbers = {record.number for record in damaged if record.kind == Kind.CHUNK}
        were_done = {record.number for record in damaged if record.state == DONE}
        if contents.frame is None and contents.chunks:
            # The variables are lost. Compute one chunk again to find them.
            states = {number: record.state for number, record in contents.chunks.items()}
            numbers.add(min(states, key=lambda number: (states[number] != DONE, number)))
        kept = {n: record for n, record in contents.chunks.items() if n not in numbers}
        if any(_BYTE in line for line in damage):
            done = {number for number, record in kept.items() if record.state == DONE}
            numbers |= {*range(spec.chunk_count)} - done
        if numbers and (changes := differences(begun.made, made_with(spec, jax_is_wide()))):
            raise ValueError(
                f"{folder}: damaged ({'; '.join(damage[:3])}{'; ...' * (len(damage) > 3)}), and "
                f"made with other versions or files: {'; '.join(changes)}; verify it with those"
            )
        # With new attributes the result must be made again, so its record is left out.
        others = (Kind.FRAME,) if contents.begun is None else (Kind.FRAME, Kind.EXPORT)
        records = [record for record in contents.readable if record.kind in others]
        records = sorted([*kept.values(), *records], key=lambda record: record.start)
        write_journal(folder, begun, journal, records)
    return damage, sorted(numbers), were_done
