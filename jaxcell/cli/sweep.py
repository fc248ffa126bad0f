import contextlib
import dataclasses
import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ..files import replacing
from .terminal import note, own_command, status, table


if TYPE_CHECKING:
    from ..sweep import Failure, Progress, Spec, SweepStatus


_MOST_FAILURES = 10


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sweep:
    """Run a task for many parameters, in chunks that survive crashes; --resume goes on.

    Exit status: 0 all done, 1 some chunks failed, 2 bad input, or no room on the disk."""

    spec: tyro.conf.Positional[Path]
    """TOML file: the task, its parameters, the seed, the size of chunks."""
    engine: str = "local"
    """Where chunks are computed: local (in this process), processes, dask (a cluster of this
    machine), or dask://host:port."""
    workers: int | None = None
    """Number of processes of the engines processes and dask; by default that of processors."""
    resume: bool = False
    """Go on with the sweep in the folder, if there is one; with more values of its parameters,
    too."""
    anyway: bool = False
    """With --resume: go on although files, the task or versions are others now. The result tells
    which, in the attribute resumed_anyway."""
    out: Path | None = None
    """Folder for the result; by default runs/ and the name of the specification."""
    netcdf: bool = False
    """Write the result to sweep.nc too, once all is done."""
    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""

    def run(self) -> int:
        # As in all other commands; without importing JAX, which the task may not need.
        os.environ.setdefault("JAX_ENABLE_X64", "1")
        # A task may stand in a file beside the user.
        sys.path.append(os.getcwd())
        from ..sweep import Spec, run_sweep

        if self.anyway and not self.resume:
            raise ValueError("--anyway: expected with --resume")
        spec = Spec.load(self.spec)
        out = Path("runs") / self.spec.stem if self.out is None else self.out
        began = time.perf_counter()
        try:
            with _terminated_like_interrupted(), _shown(spec) as show:
                found = run_sweep(
                    spec,
                    out,
                    engine=self.engine,
                    workers=self.workers,
                    resume=self.resume,
                    anyway=self.anyway,
                    progress=show,
                )
        except KeyboardInterrupt:
            again = ["jaxcell", "sweep", str(self.spec), "--out", str(out), "--resume"]
            note(f"Stopped. What is done is kept in {out}; to go on: {' '.join(again)}")
            return 130
        seconds = time.perf_counter() - began
        if self.netcdf and found.complete:
            with status("writing sweep.nc"):
                _write_netcdf(out)
        if self.json:
            print(json.dumps({"out": str(out), **_described(found), "seconds": round(seconds, 3)}))
        else:
            _show(out, found)
        return 0 if found.complete else 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepState:
    """Show how far a sweep is, while it runs too, and which chunks failed with which parameters.

    Exit status: 0 all done, 1 not yet, or some chunks failed."""

    folder: tyro.conf.Positional[Path]
    """Folder of the sweep."""
    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""

    def run(self) -> int:
        from ..sweep import sweep_status

        found = sweep_status(self.folder)
        if self.json:
            print(json.dumps({"out": str(self.folder), **_described(found)}))
        else:
            _show(self.folder, found)
        return 0 if found.complete else 1


def _described(found: "SweepStatus") -> dict[str, Any]:
    return {
        "task": found.task,
        "dimensions": dict(found.dimensions),
        "members": found.members,
        "chunks": found.chunks,
        "done": found.done,
        "failed": len(found.failures),
        "failures": [
            {"chunk": one.chunk, "parameters": dict(one.parameters), "message": one.message}
            for one in found.failures
        ],
        "damaged": found.damaged,
        "running": found.running,
    }


def _show(folder: Path, found: "SweepStatus") -> None:
    rows = [
        ("members", " x ".join(f"{size:,} {name}" for name, size in found.dimensions.items())),
        ("chunks done", f"{found.done:,} of {found.chunks:,}"),
        ("chunks failed", f"{len(found.failures):,}"),
    ]
    if found.damaged:
        rows.append(("chunks damaged", f"{found.damaged:,}"))
    if found.running is not None:
        rows.append(("at work", found.running))
    table(f"{folder}: {found.task}", ("the sweep", ""), rows)
    for failure in found.failures[:_MOST_FAILURES]:
        note(_told(failure))
    if len(found.failures) > _MOST_FAILURES:
        note(f"... and others: all are in {folder / 'failures'}")
    if found.damaged:
        note(f"To mend what is damaged: {own_command('jaxcell')} sweep verify {folder}")
    if found.done:
        note(f'To look at it in Python: xarray.open_zarr("{folder / "sweep.zarr"}")')


def _told(failure: "Failure") -> str:
    """A failure in a line."""
    parts = []
    for name, values in failure.parameters.items():
        ends = f"{values[0]} to {values[-1]}" if len(values) > 1 else str(values[0])
        parts.append(f"{name} {ends}")
    return f"chunk {failure.chunk} failed ({', '.join(parts)}): {failure.message}"


@contextlib.contextmanager
def _shown(spec: "Spec") -> "Iterator[Callable[[Progress], None]]":
    """Progress on a terminal: chunks, failures, members a second, time left."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress as Bar, TextColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[told]}"),
    )
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        shown = bar.add_task(f"sweep of {spec.task}", total=spec.chunk_count, told="")

        def show(progress: "Progress") -> None:
            told = f"{progress.failed} failed, "
            if math.isfinite(progress.left):
                told += f"{progress.rate:,.3g} members/s, {_duration(progress.left)} left"
            bar.update(shown, completed=progress.done + progress.failed, told=told)

        yield show


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


@contextlib.contextmanager
def _terminated_like_interrupted() -> Iterator[None]:
    """Makes SIGTERM do what Ctrl-C does."""
    kept = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, kept)


def _write_netcdf(out: Path) -> None:
    from ..sweep import open_sweep
    from ..sweep.store import reading

    with replacing(out / "sweep.nc") as temporary, open_sweep(out) as dataset, reading(out):
        dataset.to_netcdf(temporary)
