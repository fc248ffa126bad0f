import contextlib
import dataclasses
import json
import math
import shlex
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from ... import sweep
from ...base.formatting import counted
from ...base.memory import check_addresses
from ...base.paths import replacing
from ...base.process import exit_status, library_writes
from ...study.parameters import Only, Seconds, check
from ...sweep.storage.damage import reading
from ..output import Printing, option_words
from ..startup import prepare_tasks
from ..terminal import duration, note, own_command, progress, say, status, stdout_on_stderr, table


_MAX_FAILURES = 10
_OF_RUN = "engine", "scheduler_file", "workers", "timeout", "shard", "max_failures"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sweep(Printing):
    """Run a task for many parameter values, in chunks that survive crashes; --resume continues it.

    Exit status: 0 all done, 1 some members failed, 2 bad input, or a full disk."""

    example: ClassVar[str] = "@rooms --engine processes --out runs/rooms"

    spec: tyro.conf.Positional[Path]
    """TOML file with the task, its parameters, the seed and the size of chunks."""
    engine: str = "local"
    """Engine that computes chunks: local (this process), processes, dask (a cluster on this
    machine), or dask://host:port."""
    scheduler_file: Annotated[Path | None, Only(engine="local")] = None
    """File with the address of a Dask scheduler, instead of --engine."""
    workers: int | None = None
    """Number of worker processes if --engine is processes or dask; by default one per processor."""
    resume: bool = False
    """Continue the sweep in the folder, if any, even if values were added to its parameters."""
    anyway: Annotated[bool, Only(resume=True)] = False
    """Continue although files, the task or versions have changed. The attribute resumed_anyway of
    the result lists the changes."""
    timeout: Seconds | None = None
    """Seconds after which a chunk is stopped, and each half of it computed. A single member that
    takes longer counts as failed. The engine local cannot stop a chunk, and has no timeout."""
    shard: str | None = None
    """Compute only part I of N parts of the sweep, given as I/N such as 3/100, in a subfolder of
    the folder of the result; `jaxcell sweep merge` merges the parts."""
    max_failures: int | None = None
    """Number of failed members above which the sweep stops; by default it never stops."""
    out: Path | None = None
    """Folder for the result; by default runs/NAME for a specification NAME.toml."""
    netcdf: Annotated[bool, Only(shard=False)] = False
    """Also write the result to sweep.nc, after the last chunk."""

    def run(self) -> int:
        prepare_tasks()
        check(self)
        engine = self.engine
        if self.scheduler_file is not None:
            engine = sweep.scheduler_address(self.scheduler_file)
        spec = sweep.Spec.load(self.spec)
        if ":" not in spec.task:
            # The studies of the library use JAX; other tasks may not.
            check_addresses("JAX")
        whole = Path("runs") / self.spec.stem if self.out is None else self.out
        shard = None if self.shard is None else sweep.Shard.read(self.shard)
        out = whole if shard is None else shard.folder(whole)
        chunks = None if shard is None else shard.chunks(spec.chunk_count)
        doing = f"sweep of {spec.task}"
        began = time.perf_counter()
        try:
            with stdout_on_stderr(), shown(doing) as show:
                state = sweep.run_sweep(
                    spec,
                    out,
                    engine=engine,
                    workers=self.workers,
                    resume=self.resume,
                    anyway=self.anyway,
                    chunks=chunks,
                    timeout=self.timeout,
                    max_failures=self.max_failures,
                    progress=show,
                )
        except (KeyboardInterrupt, SystemExit) as error:
            if not out.exists():
                note("Stopped before the first chunk")
                return exit_status(error)
            again = ["jaxcell", "sweep", str(self.spec), "--out", str(whole), "--resume"]
            again += option_words(self, _OF_RUN)
            note(f"Stopped. Finished chunks are kept in {out}; to continue: {shlex.join(again)}")
            return exit_status(error)
        seconds = time.perf_counter() - began
        if self.netcdf and state.complete:
            with (
                status("writing sweep.nc"),
                replacing(out / "sweep.nc") as temporary,
                sweep.open_sweep(out) as dataset,
                reading(out),
                library_writes("sweep.nc"),
            ):
                dataset.to_netcdf(temporary)
        show_status(out, state, self.json, seconds=round(seconds, 3))
        stopped = self.max_failures is not None and len(state.failures) > self.max_failures
        if stopped:
            note(f"Stopped: more than {self.max_failures:,} members failed")
        if chunks is not None:
            note(f"This shard is {len(chunks):,} of the {state.chunks:,} chunks")
            note(f"After all shards: {own_command('sweep', 'merge', whole)}")
            return 1 if state.failures else 0
        if not state.complete:
            wrong = state.failures and all(failure.of_parameters for failure in state.failures)
            note(
                "Trying these members again cannot help, as their parameters are wrong; change "
                "the specification, and name another folder (--out)"
                if wrong and not stopped and ":" not in spec.task
                else "To compute the rest: the same command with --resume"
            )
        return 0 if state.complete else 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepState(Printing):
    """Show the progress of a sweep, finished or still running, and the members that failed.

    Exit status: 0 all done, 1 not all done, or some members failed."""

    example: ClassVar[str] = "runs/rooms"

    folder: tyro.conf.Positional[Path]
    """Folder of the sweep."""

    def run(self) -> int:
        state = sweep.sweep_status(self.folder)
        show_status(self.folder, state, self.json)
        return 0 if state.complete else 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepMerge(Printing):
    """Merge the shards of a sweep, after all of them are done.

    Exit status: 0 all done, 1 some members failed, 2 bad input: a shard that is missing, not done,
    or of another specification."""

    example: ClassVar[str] = "runs/rooms"

    folder: tyro.conf.Positional[Path]
    """Folder of the sweep, with its shards in shards/."""

    def run(self) -> int:
        prepare_tasks()
        with stdout_on_stderr(), shown(f"merging the shards of {self.folder}") as show:
            state = sweep.merge_sweep(self.folder, progress=show)
        show_status(self.folder, state, self.json)
        return 0 if state.complete else 1


def show_status(folder: Path, state: "sweep.SweepStatus", as_json: bool, **more: Any) -> None:
    failures = [
        {"chunk": each.chunk, "parameters": dict(each.parameters), "message": each.message}
        for each in state.failures
    ]
    if as_json:
        names = ("task", "members", "chunks", "done", "damaged", "running")
        summary = {
            "out": str(folder),
            **{name: getattr(state, name) for name in names},
            "dimensions": dict(state.dimensions),
            "failed": len(failures),
            "failures": failures,
            "members_per_second": state.rate,
            "seconds_left": state.left,
            "waiting": state.waiting,
        }
        print(json.dumps({**summary, **more}))
        return
    rows = [
        ("members", " x ".join(f"{size:,} {name}" for name, size in state.dimensions.items())),
        ("chunks done", f"{state.done:,} of {state.chunks:,}"),
        ("members failed", f"{len(state.failures):,}"),
    ]
    if state.damaged:
        rows.append(("chunks damaged", f"{state.damaged:,}"))
    if state.running is not None:
        rows.append(("at work", state.running))
    if state.waiting:
        rows.append(("waits for", state.waiting))
    if state.rate is not None and state.left is not None:
        rows.append(("members per second", f"{state.rate:,.3g}"))
        rows.append(("time left", duration(state.left)))
    every = state.done == state.chunks
    share = "all" if every else f"{state.done:,} of {counted(state.chunks, 'chunk')} of"
    failed = f"{len(state.failures):,} failed" if state.failures else "none failed"
    say(f"Computed: {share} {counted(state.members, 'member')}; {failed}.")
    table(f"{folder}: {state.task}", ("the sweep", ""), rows)
    for failure in state.failures[:_MAX_FAILURES]:
        note(in_a_line(failure))
    if state.failures:
        others = "... and others: " * (len(state.failures) > _MAX_FAILURES)
        note(f"{others}{folder / 'failures.json'} has their tracebacks")
    if state.damaged:
        note(f"To repair the damage: {own_command('verify', '--mend', folder)}")
    if (folder / "sweep.zarr").is_dir():
        note(f'To look at it in Python: xarray.open_zarr("{folder / "sweep.zarr"}")')


def in_a_line(failure: "sweep.Failure") -> str:
    parameters = ", ".join(f"{name} {value}" for name, value in failure.parameters.items())
    return f"a member of chunk {failure.chunk} failed ({parameters}): {failure.message}"


@contextlib.contextmanager
def shown(doing: str) -> "Iterator[Callable[[sweep.Progress], None]]":
    """Yield a function that shows the progress of a sweep in a line that begins with `doing`."""
    with progress(doing) as report:

        def show(now: "sweep.Progress") -> None:
            if now.waiting:
                note(f"The sweep waits for {now.waiting}")
            # The first job imports and compiles, so the time left is estimated from its end on.
            if not math.isfinite(now.left):
                report(f"{doing}: its first members")
            else:
                more = f"{now.failed:,} members failed, {now.rate:,.3g} members/s"
                report(doing, now.done, now.chunks, more)

        yield show
