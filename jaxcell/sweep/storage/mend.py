"""Find what is damaged in the store of a sweep, and compute it again."""

import contextlib
import dataclasses
import json
import os
import secrets
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..failures import read_report, reported
from ..files import kept_spec
from ..results import SweepStatus, sweep_status
from ..run import run_sweep
from ..spec import Spec
from ..workers.engines import Engine, engine_named
from ..workers.halving import Halving
from ..workers.progress import Progress
from ..workers.work import Computed, Job, jax_is_wide, prepared
from .frame import described, make_frame, read_attributes, zarr_arrays
from .grow import tidy
from .lock import locked
from .states import DONE, FAILED, reading, variables_of
from .store import SweepStore, differences, made_with


@dataclasses.dataclass(frozen=True)
class Verified:
    """What was damaged in a sweep."""

    chunks: int
    "Chunks that were checked."
    damaged: tuple[str, ...]
    "A line for each chunk that is damaged, and for each file that belongs to no chunk."
    recomputed: int
    "How many of these are whole again."
    status: SweepStatus
    "The progress of the sweep after that."

    @property
    def whole(self) -> bool:
        """Whether nothing is damaged any more."""
        return self.recomputed == len(self.damaged)


def verify_sweep(
    out: str | os.PathLike[str],
    *,
    engine: str = "local",
    workers: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Verified:
    """Read all that is in the store of a sweep, and compute again what is damaged.

    Damaged is what cannot be read, or does not have its checksum, or is gone: of chunks that are
    done, of coordinates, and of metadata. Chunks that were never done are left alone.

    **Arguments:**

    - `out`: the folder of the store.
    - `engine`, `workers`, `progress`: as for [`run_sweep`][].

    **Returns:** [`Verified`][].

    **Raises:** `ValueError` if there is no sweep, its specification is damaged, or something is
    damaged and the versions, the task or the files that it was computed with are others now;
    `BlockingIOError` if a run is at work on it.

    A byte of a result is changed:

        >>> import pathlib, tempfile
        >>> from jaxcell import examples, sweep
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     out = pathlib.Path(folder, "out")
        ...     _ = sweep.run_sweep(examples.angles(), out)
        ...     chunk = out / "sweep.zarr" / "count" / "c" / "0"
        ...     _ = chunk.write_bytes(b"?" + chunk.read_bytes()[1:])
        ...     found = sweep.verify_sweep(out)
        >>> found.damaged, found.recomputed, found.whole
        (('chunk 0: count',), 1, True)
    """
    folder = Path(out)
    kept_spec(folder)
    start = engine_named(engine, workers)
    with locked(folder / "lock"):
        tidy(folder)
        spec = kept_spec(folder)
        made = made_with(spec, jax_is_wide())
        files = _frame_damage(folder, spec)
        if files:
            _rebuild(folder, spec, made, start, files)
        store = SweepStore(folder, spec, made)
        others = store.differences()
        found = store.damaged() if store.metadata else {}
        damage = [
            *files,
            *(f"chunk {number}: {', '.join(names)}" for number, names in found.items()),
        ]
        if found and others:
            raise _refused(folder, damage, others)
        failed = {number: _failed(folder, number) for number in found}
        store.forget(found)
    if found:
        run_sweep(
            spec,
            folder,
            engine=engine,
            workers=workers,
            resume=True,
            chunks=found,
            progress=progress,
        )
    states = SweepStore(folder, spec, made).states()
    mended = [
        number
        for number in found
        if states[number] == DONE
        # Members that failed before may do so again.
        or (states[number] == FAILED and _failed(folder, number) <= failed[number])
    ]
    return Verified(spec.chunk_count, tuple(damage), len(files) + len(mended), sweep_status(folder))


def _failed(folder: Path, number: int) -> set[tuple[int, ...]]:
    """The members of a chunk that failed, by their places along each dimension."""
    if number not in reported(folder):
        return set()
    with reading(folder):
        return {tuple(one.index.values()) for one in read_report(folder, number)}


def _refused(folder: Path, damage: list[str], others: list[str]) -> ValueError:
    return ValueError(
        f"{folder}: damaged ({'; '.join(damage[:3])}{'; ...' * (len(damage) > 3)}), and begun with "
        f"others: {'; '.join(others)}; verify it with what it was begun with"
    )


def _frame_damage(folder: Path, spec: Spec) -> list[str]:
    """The files of a result that belong to no chunk and are damaged: coordinates and metadata.

    The metadata of each array is there twice, in its folder and in that of the result.

    **Raises:** `ValueError` if the result is of another specification.
    """
    root = folder / "sweep.zarr"
    if not root.exists():
        return []
    try:
        attributes = read_attributes(root)
        held = dict(_json(root / "zarr.json")["consolidated_metadata"]["metadata"])
    except (OSError, KeyError, TypeError, ValueError):
        return ["zarr.json"]
    if any(attributes.get(name) != value for name, value in described(spec).items()):
        raise ValueError(
            f"{folder / 'spec.toml'}: not the specification that {root} was begun with; put that "
            "in its place"
        )
    names = {*spec.dimensions, *(one.name for one in spec.parameters), "status", *held}
    found = [
        f"{name}/zarr.json"
        for name in sorted(names)
        if name not in held or _json(root / name / "zarr.json") != held[name]
    ]
    if found:
        return found
    try:
        arrays = zarr_arrays(root)
    except Exception:  # Zarr has errors of many types.
        return ["zarr.json"]
    values = {one.name: one.values for one in spec.parameters}
    for name in sorted(set(arrays) - {*variables_of(spec, held), "status"}):
        lost = not (root / name / "c" / "0").is_file()
        if lost or not _is_whole(arrays[name], values.get(name)):
            found.append(f"{name}/c/0")
    return found


def _is_whole(array: Any, expected: np.ndarray | None) -> bool:
    try:
        values = np.asarray(array[...])
    except Exception:  # Zarr and its codecs have errors of many types.
        return False
    return expected is None or values.tolist() == expected.tolist()


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None


def _rebuild(
    folder: Path, spec: Spec, made: Mapping[str, Any], start: Engine, files: list[str]
) -> None:
    """Make coordinates and metadata anew, by what the task gives for a chunk.

    **Raises:** `ValueError` if the result was made with others, or no chunk can be computed.
    """
    found = prepared(spec)
    root = folder / "sweep.zarr"
    try:
        kept = read_attributes(root)
    except (OSError, KeyError, TypeError, ValueError):
        notes = ["the attributes were damaged, and are those of the run that mended them"]
        attributes = {**made, "resumed_anyway": json.dumps(notes)}
    else:
        if others := differences(folder, kept, made):
            raise _refused(folder, files, others)
        attributes = {name: value for name, value in kept.items() if name not in described(spec)}
    wide = bool(made["jax_enable_x64"])
    jobs = (Job.of(found, spec.chunk(number), wide) for number in range(spec.chunk_count))
    work, first = Halving(spec, jobs), None
    with contextlib.closing(start(work.take)) as outcomes:
        for job, outcome in outcomes:
            if isinstance(outcome, Computed):
                first = outcome
                break
            work.settle(job, outcome)
    if first is None:
        raise ValueError(f"{folder}: damaged ({'; '.join(files)}), and no chunk can be computed")
    temporary = folder / f".sweep-{secrets.token_hex(4)}"
    make_frame(temporary, spec, first, attributes)
    # The metadata of the whole last: where this is killed, it still is of other arrays.
    for path in sorted(temporary.rglob("*"), key=lambda path: -len(path.parts)):
        if path.is_file():
            target = root / path.relative_to(temporary)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(path, target)
    shutil.rmtree(temporary)
