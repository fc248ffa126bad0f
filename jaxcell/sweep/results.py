"""Read the progress and the result of a sweep."""

import dataclasses
import os
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.shown import Shown
from .storage.damage import reading
from .storage.lock import holder
from .storage.store import DONE, SweepStore
from .workers.progress import read_down
from .workers.work import Failure


if TYPE_CHECKING:
    import xarray as xr


@dataclasses.dataclass(frozen=True)
class SweepStatus(Shown):
    """The progress of a sweep."""

    task: str
    dimensions: Mapping[str, int]
    members: int
    chunks: int
    done: int
    "Number of chunks whose members are all done."
    failures: tuple[Failure, ...]
    "Members that failed."
    damaged: int
    "Number of damaged records and lost files. Only [`verify_sweep`][] finds damage inside files."
    running: str | None
    "Name of the process that runs the sweep now, or `None`."
    rate: float | None
    "Number of members that the run computes per second; `None` if unknown."
    left: float | None
    "Estimated seconds until the end of the run; `None` if unknown."
    waiting: str
    "The reason why the run waits, such as a cluster without workers; empty if it does not wait."

    @property
    def complete(self) -> bool:
        return self.done == self.chunks


def sweep_status(out: str | os.PathLike[str]) -> SweepStatus:
    """Read the progress of the sweep in a folder, even while it runs.

    **Arguments:** the folder of the store. **Returns:** [`SweepStatus`][].

    A sweep that is done:

        >>> from jaxcell import examples, sweep
        >>> out = examples.folder()
        >>> _ = sweep.run_sweep(examples.angles(), out)
        >>> status = sweep.sweep_status(out)
        >>> status.task, status.dimensions, status.complete, status.running
        ('groups', {'bounce': 2}, True, None)
    """
    folder = Path(out)
    with SweepStore(folder) as store:
        spec, at_work = store.spec, holder(folder / "lock")
        with reading(folder):
            pace = read_down(folder) if at_work is not None else (None, None, "")
        about = spec.task, spec.dimensions, spec.members, spec.chunk_count
        done = int((store.states == DONE).sum())
        damaged = len(store.contents.damage) + len(store.lost_files())
        return SweepStatus(*about, done, tuple(store.failures()), damaged, at_work, *pace)


def open_sweep(out: str | os.PathLike[str]) -> "xr.Dataset":
    """Open the result of a sweep, complete or not. Arrays are read when they are used.

    If the sweep is running or was killed, the result is first built in memory. Where `status` is
    not 1, floats are NaN, integers are -1 (unsigned integers their maximum), and booleans are
    `False`.

    **Arguments:** the folder of the store. **Returns:** a dataset with the dimensions of its
    [`Spec`][]; the variable `status` is 1 where a member is done.

    The number of periodic groups for two angles on one map:

        >>> from jaxcell import examples, sweep
        >>> out = examples.folder()
        >>> _ = sweep.run_sweep(examples.angles(), out)
        >>> with sweep.open_sweep(out) as dataset:
        ...     print(dataset["count"].values.tolist(), dataset.status.values.tolist())
        [1, 1] [1, 1]
    """
    import xarray as xr

    folder = Path(out)
    with SweepStore(folder) as store:
        if store.frame is None:
            raise ValueError(f"{folder}: no chunk is done yet, of {store.spec.chunk_count}")
        if damage := [*store.contents.damage, *store.lost_files()]:
            raise ValueError(
                f"{folder}: damaged: {damage[0]}{', ...' * (len(damage) > 1)}; to mend it: "
                f"jaxcell verify --mend {shlex.quote(str(folder))}"
            )
        with reading(folder):
            source: Any = store.zarr
            if store.contents.exported is None:
                # The sweep runs or was killed.
                from zarr.storage import MemoryStore

                from .storage.export import write_result

                write_result(store, source := MemoryStore())
            dataset = xr.open_zarr(source, consolidated=True)
            for name in dataset.coords:
                variable = dataset.variables[name]
                # Some versions of xarray cannot write strings of Zarr to NetCDF.
                if getattr(variable.encoding.get("dtype"), "kind", "") == "T":
                    del variable.load().encoding["dtype"]
            return dataset
