"""Which members of a sweep are done, for readers: without Zarr, which is slow to import."""

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..boxes import Boxes, by_chunk
from ..failures import Failure, read_report, reported
from ..spec import Chunk, Spec
from .codecs import check_codecs, decoded


TO_DO, DONE, FAILED = 0, 1, 2
# A state that is in no file: something of the chunk is gone, or cannot be read.
DAMAGED = 3


@contextlib.contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Turn all that readers of a damaged store raise into a `ValueError` that names it."""
    try:
        yield
    except Exception as error:  # Zarr and its codecs have errors of many types.
        message = " ".join(str(error).split())[:500]
        if isinstance(error, ValueError | OSError) and str(folder) in message:
            raise
        reason = f"{type(error).__name__}: {message}" if message else type(error).__name__
        raise ValueError(
            f"{folder}: the sweep there is damaged: {reason}; to mend it: "
            f"jaxcell sweep verify {folder}"
        ) from error


class States:
    """The states of the members and chunks of a sweep, by the files in its folder."""

    def __init__(self, folder: Path, spec: Spec) -> None:
        self.folder = folder
        self.spec = spec
        self.zarr = folder / "sweep.zarr"
        self.variables: Mapping[str, tuple[str, ...]] = {}
        "Those of the task, with their dimensions beside those of members."
        self.boxes = Boxes(spec, spec)
        self.metadata: Mapping[str, Any] = {}
        "Of the arrays of the result; none before a chunk is done."
        self._members: np.ndarray | None = None
        self.look()

    def look(self) -> None:
        """Look at what arrays the result has."""
        if not self.zarr.exists():
            return
        with reading(self.folder):
            file = self.zarr / "zarr.json"
            if not file.exists():
                raise ValueError("it has no zarr.json")
            metadata = json.loads(file.read_bytes())["consolidated_metadata"]["metadata"]
            status, sizes = metadata.get("status"), [*self.spec.dimensions.values()]
            if status is None or status["shape"] != sizes:
                raise ValueError(f"expected a status of shape {sizes}")
            lengths = status["chunk_grid"]["configuration"]["chunk_shape"]
            self.boxes = Boxes.of_lengths(self.spec, tuple(lengths))
            self.variables = variables_of(self.spec, metadata)
            for name in ("status", *self.variables):
                check_codecs(name, metadata[name])
            self.metadata = metadata

    def states(self) -> np.ndarray:
        """The state of each chunk, by number: failed if a member failed, done if all are done."""
        if not self.metadata:
            states = np.full(self.spec.chunk_count, TO_DO, np.int8)
            with reading(self.folder):
                states[reported(self.folder)] = FAILED
            return states
        members = self.members()
        done = by_chunk(self.spec, np.logical_and, members == DONE)
        failed, damaged = (
            by_chunk(self.spec, np.logical_or, members == state) for state in (FAILED, DAMAGED)
        )
        damaged |= np.array([bool(self.gone(box)) for box in self.boxes])[self.boxes.numbers()]
        damaged &= by_chunk(self.spec, np.logical_or, (members == DONE) | (members == DAMAGED))
        return np.select([damaged, done, failed], [DAMAGED, DONE, FAILED], TO_DO).astype(np.int8)

    def members(self) -> np.ndarray:
        """The state of each member, of one array from call to call."""
        if self._members is None:
            self._members = np.full([*self.spec.dimensions.values()], TO_DO, np.int8)
            for box in self.boxes:
                try:
                    content = self.file("status", box).read_bytes()
                    values = decoded(content, self.metadata["status"])
                    self._members[box.region] = values[tuple(map(slice, box.shape))]
                except FileNotFoundError:
                    pass
                except Exception:  # The codecs have errors of many types.
                    self._members[box.region] = DAMAGED
        return self._members

    def missing(self, chunk: Chunk) -> np.ndarray:
        """Which members of a chunk are not done."""
        if not self.metadata:
            return np.ones(chunk.shape, bool)
        return self.members()[chunk.region] != DONE

    def gone(self, box: Chunk) -> list[str]:
        """The variables whose file of a box is not there."""
        return [name for name, path in self.files(box).items() if not os.path.exists(path)]

    def files(self, box: Chunk) -> dict[str, Path]:
        """The files of a box for the variables of the task."""
        inner = len(self.spec.dimensions)
        names = [name for name in self.variables if all(self.metadata[name]["shape"][inner:])]
        return {name: self.file(name, box) for name in names}

    def file(self, name: str, box: Chunk) -> Path:
        """The file of a box for an array."""
        index = box.index + (0,) * len(self.variables.get(name, ()))
        return self.zarr.joinpath(name, "c", *map(str, index))

    def failures(self, states: np.ndarray) -> Iterator[Failure]:
        """The members that failed, by the states of their chunks."""
        for number in reported(self.folder):
            # A report may outlive its failure by a moment.
            with reading(self.folder), contextlib.suppress(FileNotFoundError):
                if states[number] == FAILED:
                    yield from read_report(self.folder, number)


def variables_of(spec: Spec, metadata: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """The arrays with a value for each member, and their dimensions beside those of members."""
    own = {*spec.dimensions, "status", *(one.name for one in spec.parameters)}
    count, dimensions = len(spec.dimensions), [*spec.dimensions]
    found = {}
    for name in sorted(set(metadata) - own):
        names = metadata[name]["dimension_names"]
        if names[:count] == dimensions:
            found[name] = tuple(names[count:])
    return found
