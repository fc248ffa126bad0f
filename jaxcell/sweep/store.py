"""Where the result of a sweep is kept: a Zarr store, written chunk by chunk."""

import contextlib
import dataclasses
import importlib.metadata
import json
import math
import os
import secrets
import shutil
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from .. import __version__
from ..files import replacing
from ..revision import git_revision
from .design import LIST_DIMENSION, RANDOM_DIMENSION
from .halving import Parts
from .lock import holder, locked
from .spec import Chunk, Spec
from .work import Computed, Failed


TO_DO, DONE, FAILED = 0, 1, 2

_STATUS: dict[str, Any] = {
    "long_name": "state of a member",
    "flag_values": [TO_DO, DONE, FAILED],
    "flag_meanings": "to_do done failed",
}


@dataclasses.dataclass(frozen=True)
class Failure:
    """A member that failed."""

    chunk: int
    "The number of its chunk."
    index: Mapping[str, int]
    "Its place along each dimension."
    parameters: Mapping[str, Any]
    message: str
    trace: str
    "The end of the traceback, if there is one."


@contextlib.contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Turns all that readers of a damaged store raise into a `ValueError` that names it."""
    try:
        yield
    except Exception as error:  # Zarr and its codecs have errors of many types.
        message = " ".join(str(error).split())[:500]
        if isinstance(error, ValueError | OSError) and str(folder) in message:
            raise
        told = f"{type(error).__name__}: {message}" if message else type(error).__name__
        raise ValueError(f"{folder}: the sweep there is damaged: {told}") from error


class SweepStore:
    """The folder of a sweep, for the one process that writes there.

    - `sweep.zarr` is the result. Every variable has one file for each chunk of the sweep. That of
        `status` is written last, when the others are on the disk; a chunk without one is computed
        again. Nothing in it depends on the order of chunks or on the time.
    - `spec.toml` is the specification as it was given.
    - `failures/` has a file for each chunk of which members failed.
    - `lock` tells which process writes.
    """

    def __init__(self, folder: Path, spec: Spec, versions: Mapping[str, Any]) -> None:
        self.folder = folder
        self.spec = spec
        self.versions = versions
        self.zarr = folder / "sweep.zarr"
        self._arrays: dict[str, zarr.Array] = {}
        self._open()

    @classmethod
    @contextlib.contextmanager
    def opened(
        cls, folder: Path, spec: Spec, resume: bool, versions: Mapping[str, Any]
    ) -> Iterator["SweepStore"]:
        """Makes the folder, or opens it again, and keeps others out of it.

        **Raises:** `FileExistsError` if a sweep is there, and not to be resumed; `ValueError` if it
        is of another specification or other versions; `BlockingIOError` if another process is at
        work on it.
        """
        folder.mkdir(parents=True, exist_ok=True)
        with locked(folder / "lock"):
            store = cls(folder, spec, versions)
            kept = folder / "spec.toml"
            if not kept.exists():
                if store.zarr.exists():
                    raise FileExistsError(f"{store.zarr}: it is there, but no {kept}")
                with replacing(kept) as temporary:
                    temporary.write_bytes(spec.text)
            elif not resume:
                raise FileExistsError(
                    f"{folder}: a sweep is there; resume it, or name another folder"
                )
            elif told := Spec.load(kept).differences(spec):
                raise ValueError(
                    f"{spec.path}: not the specification of the sweep in {folder}: "
                    + "; ".join(told)
                )
            store._check_versions()
            store._tidy()
            yield store

    def states(self) -> np.ndarray:
        """The state of each chunk, by number: failed if a member failed, done if all are done."""
        with reading(self.folder):
            if not self._arrays:
                states = np.full(self.spec.chunk_count, TO_DO, np.int8)
                for path in self.failure_files():
                    states[int(path.stem)] = FAILED
                return states
            states = np.asarray(self._arrays["status"][:], np.int8)
            least = most = states
            for axis, length in enumerate(self.spec.lengths.values()):
                begins = np.arange(0, states.shape[axis], length)
                least = np.minimum.reduceat(least, begins, axis)
                most = np.maximum.reduceat(most, begins, axis)
            return np.where(most == FAILED, FAILED, least).ravel()

    def failures(self, states: np.ndarray) -> Iterator[Failure]:
        """The members that failed, by the states of their chunks."""
        for path in self.failure_files():
            # A report may outlive its failure by a moment.
            with reading(self.folder), contextlib.suppress(FileNotFoundError):
                report = [Failure(**one) for one in json.loads(path.read_text(encoding="utf-8"))]
                if states[int(path.stem)] == FAILED:
                    yield from report

    def check(self, computed: Computed) -> None:
        """Looks at the result of a job, and makes the store for results as the first one.

        **Raises:** `ValueError` if it has not the variables of the first one.
        """
        if not self._arrays:
            self._create(computed)
            self._open()
            with reading(self.folder):
                for path in self.failure_files():
                    for failure in json.loads(path.read_text(encoding="utf-8")):
                        self._arrays["status"][tuple(failure["index"].values())] = FAILED
        self._check(computed)

    def write(self, parts: Parts) -> list[Failure]:
        """Writes a chunk, as far as it is known, and gives the failures in it."""
        chunk, lengths = parts.chunk, tuple(self.spec.lengths.values())
        inside = tuple(slice(length) for length in chunk.shape)
        states = np.full(math.prod(lengths), TO_DO, np.int8)
        states[list(parts.failed)] = FAILED
        failures = [
            self._failure(chunk, place, parts.failed[place]) for place in sorted(parts.failed)
        ]
        if failures:
            self._report(chunk, failures)
        if not self._arrays:
            return failures
        for places, _ in parts.computed:
            states[places] = DONE
        for name, array in self._results().items():
            inner = array.shape[len(lengths) :]
            values = np.full((states.size, *inner), _fill(array.dtype), array.dtype)
            for places, computed in parts.computed:
                values[places] = computed.variables[name].values
            array[chunk.region] = values.reshape(lengths + inner)[inside]
            self._sync(chunk, name, len(inner))
        self._arrays["status"][chunk.region] = states.reshape(lengths)[inside]
        if not failures:
            self._failure_file(chunk).unlink(missing_ok=True)
        return failures

    def _failure(self, chunk: Chunk, place: int, failed: Failed) -> Failure:
        index = self.spec.index(chunk, place)
        return Failure(chunk.number, index, self.spec.member(index), failed.message, failed.trace)

    def _report(self, chunk: Chunk, failures: list[Failure]) -> None:
        path = self._failure_file(chunk)
        path.parent.mkdir(exist_ok=True)
        with replacing(path) as temporary:
            text = json.dumps([dataclasses.asdict(one) for one in failures], indent=2)
            temporary.write_text(text + "\n", encoding="utf-8")

    def _results(self) -> dict[str, zarr.Array]:
        """The arrays of what the task gave for each member."""
        dimensions = (*self.spec.dimensions,)
        own = {*dimensions, "status", *(one.name for one in self.spec.parameters)}
        return {
            name: array
            for name, array in self._arrays.items()
            if name not in own and _names(array)[: len(dimensions)] == dimensions
        }

    def failure_files(self) -> list[Path]:
        """The reports of chunks that failed, by number."""
        return sorted((self.folder / "failures").glob("[0-9]*.json"))

    def _failure_file(self, chunk: Chunk) -> Path:
        return self.folder / "failures" / f"{chunk.number:07d}.json"

    def _open(self) -> None:
        if not self.zarr.exists():
            return
        sizes = tuple(self.spec.dimensions.values())
        with reading(self.folder):
            group = zarr.open_group(self.zarr, mode="r+", zarr_format=3)
            self._arrays = dict(group.arrays())
            if "status" not in self._arrays or self._arrays["status"].shape != sizes:
                raise ValueError(f"expected a status of shape {sizes}")

    def _check_versions(self) -> None:
        if self._arrays:
            with reading(self.folder):
                attributes = zarr.open_group(self.zarr, mode="r").attrs
            told = [
                f"{name}: {attributes.get(name)} there, {here} here"
                for name, here in self.versions.items()
                if attributes.get(name) != here
            ]
            if told:
                raise ValueError(f"{self.folder}: begun with other versions: {'; '.join(told)}")

    def _tidy(self) -> None:
        """Removes what a run that was killed left half written."""
        for path in self.folder.glob(".sweep-????????"):
            shutil.rmtree(path)
        reports = self.folder / "failures"
        for path in [
            *self.zarr.rglob("*.partial"),
            *self.folder.glob(".*-????????.*"),
            *reports.glob(".*-????????.*"),
        ]:
            path.unlink()

    def _create(self, first: Computed) -> None:
        """Makes the result with nothing in it."""
        temporary = self.folder / f".sweep-{secrets.token_hex(4)}"
        group = zarr.create_group(temporary, zarr_format=3, attributes=self._attributes())
        dimensions = self.spec.dimensions
        sizes, lengths = tuple(dimensions.values()), tuple(self.spec.lengths.values())
        for name in (LIST_DIMENSION, RANDOM_DIMENSION):
            if name in dimensions:
                number = np.arange(dimensions[name])
                _coordinate(group, name, name, number, {"long_name": f"number of the {name}"})
        for parameter in self.spec.parameters:
            _coordinate(group, parameter.name, parameter.dimension, parameter.values, {})
        for name, variable in first.coordinates.items():
            _coordinate(group, name, name, variable.values, variable.attributes)
        for name, variable in first.variables.items():
            inner = variable.values.shape[1:]
            group.create_array(
                name,
                shape=sizes + inner,
                # A Zarr chunk has at least one place, where an array may have none.
                chunks=lengths + tuple(max(size, 1) for size in inner),
                dtype=variable.values.dtype,
                fill_value=_fill(variable.values.dtype),
                attributes=dict(variable.attributes),
                dimension_names=[*dimensions, *variable.dimensions],
            )
        group.create_array(
            "status",
            shape=sizes,
            chunks=lengths,
            dtype=np.int8,
            fill_value=TO_DO,
            attributes=_STATUS,
            dimension_names=[*dimensions],
        )
        with warnings.catch_warnings():
            # xarray reads consolidated metadata and writes it too, whatever the standard says yet.
            warnings.filterwarnings("ignore", message="Consolidated metadata")
            zarr.consolidate_metadata(temporary)
        os.replace(temporary, self.zarr)

    def _attributes(self) -> dict[str, Any]:
        spec = self.spec
        attributes: dict[str, Any] = {
            "title": f"Sweep of {spec.task}",
            "source": "jaxcell",
            **self.versions,
            "task": spec.task,
            "spec": json.dumps(spec.document, default=str),
            "seed": spec.seed,
            "comment": "Where status is not 1 (done), floats are NaN, integers -1 (or, without a "
            "sign, their greatest), and booleans False.",
        }
        if (revision := git_revision()) is not None:
            attributes["git_revision"] = revision
        others = [one.name for one in spec.parameters if one.name != one.dimension]
        if others:
            # So xarray knows that they are coordinates.
            attributes["coordinates"] = " ".join(others)
        return attributes

    def _check(self, computed: Computed) -> None:
        own = {*self.spec.dimensions, "status", *(one.name for one in self.spec.parameters)}
        given = {**computed.variables, **computed.coordinates}
        if set(given) != set(self._arrays) - own:
            raise ValueError(
                f"the task gave {', '.join(sorted(given))}; the chunk that was done first has "
                f"{', '.join(sorted(set(self._arrays) - own))}"
            )
        for name, variable in given.items():
            array = self._arrays[name]
            skipped = len(self.spec.dimensions) if name in computed.variables else 0
            found = {
                "dimensions": [*_names(array)[skipped:]],
                "shape": [*array.shape[skipped:]],
                "kind": "string" if array.dtype.kind == "T" else str(array.dtype),
                "attributes": dict(array.attrs),
            }
            frame = {
                "dimensions": [*variable.dimensions],
                "shape": [*variable.values.shape[skipped > 0 :]],
                "kind": "string"
                if variable.values.dtype.kind == "U"
                else str(variable.values.dtype),
                "attributes": dict(variable.attributes),
            }
            what = next((key for key in found if frame[key] != found[key]), None)
            if what is not None:
                raise ValueError(
                    f"the task gave {name!r} with the {what} {frame[what]}; in the chunk that was "
                    f"done first it is {found[what]}"
                )
            if not skipped and not np.array_equal(variable.values, np.asarray(array[:])):
                raise ValueError(
                    f"the task gave a coordinate {name!r} with values other than those of the "
                    "chunk that was done first"
                )

    def _sync(self, chunk: Chunk, name: str, inner: int) -> None:
        """Waits until the file of a chunk of an array of so many more dimensions is on the disk."""
        path = self.zarr.joinpath(name, "c", *map(str, (*chunk.index, *[0] * inner)))
        # A chunk of nothing but the fill value has no file.
        with contextlib.suppress(FileNotFoundError), open(path, "rb") as file:
            os.fsync(file.fileno())


def made_with(wide: bool) -> dict[str, Any]:
    """What the numbers in a store may depend on beside its specification."""
    return {
        "jaxcell_version": __version__,
        "jax_version": importlib.metadata.version("jax"),
        "jax_enable_x64": int(wide),
    }


def running(folder: Path) -> str | None:
    """Which process is at work on a store, if any."""
    return holder(folder / "lock")


def _coordinate(
    group: zarr.Group,
    name: str,
    dimension: str,
    values: np.ndarray,
    attributes: Mapping[str, Any],
) -> None:
    if values.dtype.kind == "U":
        values = values.astype(np.dtypes.StringDType())
    group.create_array(
        name,
        data=values,
        dimension_names=[dimension],
        attributes=dict(attributes),
        chunks=values.shape,
    )


def _names(array: zarr.Array) -> tuple[str, ...]:
    """The dimensions of an array."""
    names: Any = array.metadata.dimension_names  # type: ignore[union-attr]
    return tuple(names)


def _fill(dtype: np.dtype) -> Any:
    """What stands where nothing is known yet."""
    return {"f": np.nan, "c": complex(np.nan, np.nan), "i": -1, "b": False}.get(
        dtype.kind, np.iinfo(dtype).max if dtype.kind == "u" else 0
    )
