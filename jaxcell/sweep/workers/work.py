"""Compute the members of a chunk in a worker. The results are NumPy arrays."""

import contextlib
import dataclasses
import functools
import itertools
import json
import math
import os
import resource
import socket
import sys
import time
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...base.documents import about
from ...base.formatting import did_you_mean
from ...base.memory import free
from ...base.process import is_ending
from ...study import Study, parameters
from ...study.loading import load_object
from ..design import LIST_DIMENSION
from ..spec import Chunk, Spec
from ..study_task import WrongResultsError, check_files, check_members, study_task


Task = Callable[[Mapping[str, np.ndarray], Mapping[str, Any], int], Any]

_WIDE = "JAX_ENABLE_X64"
# Type codes of the numbers and booleans that Zarr supports.
_CODES = np.typecodes["AllInteger"] + "efdFD?"
_MAX_LINES = 30
JOB_SECONDS = 1.0
"""Seconds that a job takes, unless the specification gives the size of chunks."""
# The share of the free memory by which a job may let its process grow, as there are other workers.
_SHARE = 0.25
# Small jobs use memory that was free in their process, which is not measured.
_MOST_ROOM = 100.0


@dataclasses.dataclass(frozen=True)
class Job:
    """Members to compute with one call of the task: of a chunk, or of several."""

    numbers: np.ndarray
    "The number of the chunk of each member; members of a chunk are adjacent."
    places: np.ndarray
    "The index of each member in its chunk."
    task: str
    batch: Mapping[str, np.ndarray]
    fixed: Mapping[str, Any]
    seed: int
    wide: bool
    "If true, JAX computes with 64 bits."
    length: int = 0
    """The minimum number of members in a call of the task: if the job has fewer, the last member is
    repeated. It is the same for jobs of as many chunks, so that JAX compiles a task only once."""
    results: tuple[str, ...] = ()
    "The names of the quantities to compute, by default all."

    @classmethod
    def of(cls, spec: Spec, chunks: Sequence[Chunk], count: int, wide: bool) -> "Job":
        """Create the job for all members of some chunks, of the length of `count` chunks."""
        sizes = [math.prod(chunk.shape) for chunk in chunks]
        numbers = np.repeat([chunk.number for chunk in chunks], sizes)
        places = np.concatenate([np.arange(size) for size in sizes])
        batches = [spec.batch(chunk) for chunk in chunks]
        batch = {name: np.concatenate([one[name] for one in batches]) for name in batches[0]}
        length = count * math.prod(spec.lengths.values())
        about = spec.task, batch, spec.fixed, spec.seed, wide
        return cls(numbers, places, *about, length, spec.results)

    def part(self, rows: np.ndarray) -> "Job":
        """Create a job for those members of this job whose indices in the job are `rows`."""
        batch = {name: values[rows] for name, values in self.batch.items()}
        numbers, places = self.numbers[rows], self.places[rows]
        return dataclasses.replace(self, numbers=numbers, places=places, batch=batch, length=0)

    def by_chunk(self) -> Iterator[tuple[int, slice]]:
        """Yield the number of each chunk, and the slice of the job with its members."""
        starts = [0, *(np.flatnonzero(np.diff(self.numbers)) + 1).tolist(), self.places.size]
        for start, stop in itertools.pairwise(starts):
            yield int(self.numbers[start]), slice(start, stop)


@dataclasses.dataclass(frozen=True)
class Variable:
    """A variable or coordinate of a result: its dimensions, values and attributes."""

    dimensions: tuple[str, ...]
    "The names of the dimensions, without the dimension of the members."
    values: np.ndarray
    attributes: Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Computed:
    """The result of a job."""

    variables: dict[str, Variable]
    "The variables, keyed by name; the first dimension of their arrays is `member`."
    coordinates: dict[str, Variable]
    "The coordinates of the other dimensions, equal in all chunks."
    room: float = 1.0
    """The factor by which a job may be larger to take a second and to fit in memory; 1 if it is
    unknown because the process had not computed such a job before."""


@dataclasses.dataclass(frozen=True)
class Failed:
    """The failure of a job."""

    message: str
    "One line with the reason."
    trace: str = ""
    "The end of the traceback; empty if there is none."
    wrong_results: str = ""
    "The reason why all members fail, if `results` has a name that the study lacks."


@dataclasses.dataclass(frozen=True)
class Waiting:
    """The reason why no job can be computed now, or that there is none."""

    what: str
    "The thing that jobs need; empty if they are computed."


@dataclasses.dataclass(frozen=True)
class Failure:
    """The failure of a member."""

    chunk: int
    "The number of the chunk of the member."
    index: Mapping[str, int]
    "The index of the member along each dimension."
    parameters: Mapping[str, Any]
    message: str
    trace: str
    "The end of the traceback; empty if there is none."

    @property
    def of_parameters(self) -> bool:
        """True for a `ValueError`, which a study raises for a wrong parameter."""
        return self.message.startswith("ValueError: ")


def find_task(name: str, results: tuple[str, ...] = ()) -> Task:
    """Find the function of a task by its name in a specification.

    `results` are the names of the wanted quantities of a study, by default all.
    """
    reference = name
    if ":" not in name:
        from ..tasks import TASKS

        if name not in TASKS:
            raise ValueError(
                f'task: expected one of {", ".join(TASKS)}, or "module:function", got {name!r}'
                f"{did_you_mean(name, TASKS)}"
            )
        reference = TASKS[name]
    with about("task"):
        target = load_object(reference)
    if isinstance(target, type) and issubclass(target, Study):
        return functools.partial(study_task, target, results=results)
    if results:
        raise ValueError(f"results: expected a study as the task, got the function {name!r}")
    if not callable(target):
        raise ValueError(f"task: {name!r}: expected a function, got {type(target).__name__}")
    return target


def study_of(task: str) -> type[Study] | None:
    """Return the study that a task runs, or `None` if the task is a function."""
    return _study(find_task(task))


def _study(task: Task) -> type[Study] | None:
    if isinstance(task, functools.partial) and task.func is study_task:
        return task.args[0]
    return None


def prepared(spec: Spec) -> Spec:
    """Check a specification with the parameters of its first chunk, and make its paths absolute."""
    with about(spec.path):
        spec = with_task_found(spec)
        if (study := study_of(spec.task)) is None:
            return with_files_found(spec)
        check_members(study, spec.batch(spec.chunk(0)), spec.fixed, spec.seed)
        spec = with_files_found(spec)
        check_files(study, _with_each_file(spec, study), spec.seed)
        return spec


def _with_each_file(spec: Spec, study: type[Study]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the parameters of the first member, and of the first with each other file."""
    first = dict.fromkeys(spec.dimensions, 0)
    yield "", {**spec.fixed, **spec.member(first)}
    for one in spec.parameters:
        if one.name in _list_paths(study):
            for place in np.sort(np.unique(one.values, return_index=True)[1])[1:].tolist():
                given = {**spec.fixed, **spec.member({**first, one.dimension: place})}
                yield str(Path(given[one.name])), given


def _list_paths(study: type[Study]) -> list[str]:
    """List the parameters of a study that are files."""
    return [name for name, kind in parameters(study).items() if "Path" in str(kind)]


def with_task_found(spec: Spec) -> Spec:
    """Make the path of a task `FILE.py:NAME` absolute; leave other tasks as they are."""
    file, colon, name = spec.task.partition(":")
    path = spec.find_file(file) if colon and file.endswith(".py") else None
    return spec if path is None else dataclasses.replace(spec, task=f"{path}:{name}")


def with_files_found(spec: Spec) -> Spec:
    """Make the paths in the parameters of a study absolute, so that all workers find the files.

    A relative path is searched in the folder of the specification, then in the current folder.
    """
    study = study_of(spec.task)
    names = [] if study is None else _list_paths(study)
    fixed = {
        name: _found(spec, name, value) if name in names else value
        for name, value in spec.fixed.items()
    }
    changed = [
        dataclasses.replace(
            one, values=np.array([_found(spec, one.name, value) for value in one.values.tolist()])
        )
        if one.name in names
        else one
        for one in spec.parameters
    ]
    return dataclasses.replace(spec, fixed=fixed, parameters=tuple(changed))


def _found(spec: Spec, name: str, value: Any) -> Any:
    if isinstance(value, list):
        return [_found(spec, name, one) for one in value]
    if not isinstance(value, str) or Path(value).is_absolute():
        return value
    if (path := spec.find_file(value)) is not None:
        return str(path)
    looked = " nor in ".join(map(str, spec.folders))
    raise ValueError(f"{name}: there is no file {value!r} in {looked}")


def jax_is_wide() -> bool:
    """Return whether JAX computes with 64 bits in this process, or will once it is imported."""
    if (jax := sys.modules.get("jax")) is not None:
        return bool(jax.config.jax_enable_x64)
    return os.environ.get(_WIDE, "").lower() in ("1", "true", "t", "yes", "y", "on")


def prepare(job: Job) -> None:
    """Import what a job needs, before its time begins. Errors are left to `compute`."""
    os.environ[_WIDE] = str(int(job.wide))
    with contextlib.suppress(Exception, SystemExit):
        if study_of(job.task) is None:
            import xarray as xr

            # The first Dataset imports Dask.
            xr.Dataset({"x": ("x", [0])})


def compute(job: Job) -> Computed | Failed:
    """Compute a job. Exceptions are returned as `Failed`."""
    try:
        # Set the variable too, because the task may import JAX later.
        os.environ[_WIDE] = str(int(job.wide))
        task = find_task(job.task, job.results)
        if (jax := sys.modules.get("jax")) is not None and jax_is_wide() != job.wide:
            jax.config.update("jax_enable_x64", job.wide)
        members = job.places.size
        rows = np.arange(max(members, job.length)).clip(max=members - 1)
        batch = {name: values[rows] for name, values in job.batch.items()}
        with _measured(job.task, rows.size) as measured:
            found = task(batch, job.fixed, job.seed)
        columns, coordinates = (found, set()) if _study(task) else _columns(found, batch)
        return dataclasses.replace(_arrays(columns, coordinates, batch, members), room=measured())
    except FileNotFoundError as error:
        failed = failure(error)
        return dataclasses.replace(failed, message=f"{failed.message} (on {socket.gethostname()})")
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and is_ending():
            raise
        return failure(error)


# The bytes by which this process grew when it first computed a number of members of a task.
_grown: dict[str, dict[int, int]] = {}


@contextlib.contextmanager
def _measured(task: str, members: int) -> Iterator[Callable[[], float]]:
    """Measure a call of a task. Yield a function that returns `Computed.room` afterwards."""
    room, before, began = 1.0, _peak(), time.perf_counter()
    yield lambda: room
    seconds, known = time.perf_counter() - began, _grown.setdefault(task, {})
    if members in known:
        left = free() if known[members] else None
        fits = math.inf if left is None else _SHARE * left / known[members]
        room = min(JOB_SECONDS / seconds, fits, _MOST_ROOM)
    else:
        # The first call of all imports modules, which takes memory once.
        known[members] = _peak() - before if known else 0


def _peak() -> int:
    """Return the largest number of bytes that this process has had in memory."""
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def failure(error: BaseException) -> Failed:
    lines = "".join(traceback.format_exception(error)).splitlines()
    message = " ".join(str(error).split())
    name = type(error).__name__
    wrong = str(error) if isinstance(error, WrongResultsError) else ""
    return Failed(f"{name}: {message}" if message else name, "\n".join(lines[-_MAX_LINES:]), wrong)


def _arrays(
    columns: Mapping[str, Any],
    coordinates: Collection[str],
    batch: Mapping[str, np.ndarray],
    members: int,
) -> Computed:
    """Check the variables of a result; convert the values of its first members to arrays."""
    taken = {*batch, "status", "sample"}
    computed = Computed({}, {})
    for name, (dimensions, values, attributes) in columns.items():
        dims = (dimensions,) if isinstance(dimensions, str) else dimensions
        for used in (name, *dims):
            if not str(used).isidentifier() or used in taken:
                raise ValueError(
                    f"the task gave {name!r} of dimensions {dims}; expected names of "
                    "letters, digits and underscores, other than status, sample and parameters"
                )
        if values.dtype.char not in _CODES + "U" * (name in coordinates):
            raise ValueError(
                f"the task gave {name!r} of kind {values.dtype}; expected numbers or booleans"
            )
        array = np.ascontiguousarray(values, values.dtype.newbyteorder("="))
        about = json.loads(json.dumps(attributes, default=_plain))
        if name in coordinates:
            computed.coordinates[name] = Variable((name,), array, about)
        elif dims[:1] == (LIST_DIMENSION,):
            inner = tuple(map(str, dims[1:]))
            computed.variables[name] = Variable(inner, array[:members], about)
        else:
            raise ValueError(
                f"the task gave {name!r} of dimensions {dims}; expected {LIST_DIMENSION} "
                "as the first"
            )
    return computed


def _columns(dataset: Any, batch: Mapping[str, np.ndarray]) -> tuple[dict[str, Any], set[str]]:
    """Return the variables of a Dataset by name, and the names of its coordinates."""
    import xarray as xr

    if not isinstance(dataset, xr.Dataset):
        raise TypeError(f"the task gave {type(dataset).__name__}; expected an xarray.Dataset")
    dataset = dataset.drop_vars(LIST_DIMENSION, errors="ignore").reset_coords()
    expected, length = len(next(iter(batch.values()))), dataset.sizes.get(LIST_DIMENSION)
    if length != expected:
        raise ValueError(f"the task gave {length} members; expected {expected}")
    variables = dataset.variables.items()
    columns = {str(name): (one.dims, one.values, one.attrs) for name, one in variables}
    return columns, {*map(str, dataset.coords)}


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"expected attributes of text and numbers, got {type(value).__name__}")
