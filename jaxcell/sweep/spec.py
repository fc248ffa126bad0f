"""Specifications of sweeps, read from TOML files."""

import dataclasses
import functools
import itertools
import math
import os
import re
import reprlib
import tomllib
from collections import deque
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..base.bundled import bundled_names
from ..base.documents import check_file
from ..base.shown import Shown
from .design import SALTELLI, Parameter, check_name, read_parameters


_PARAMETERS = ("grid", "list", "random")
_TABLES = ("fixed", *_PARAMETERS)
_FIELDS = ("task", "seed", "chunk", "results", *_TABLES)
# The driver keeps a record per chunk.
_MAX_CHUNKS = 1_000_000
_USUAL_CHUNKS = 2048
_MAX_LETTERS = 500
# A number without the 0 that TOML wants.
_NO_ZERO = re.compile(rb"[=\[,]\s*(\.\d+)")


@dataclasses.dataclass(frozen=True)
class Chunk:
    """Members with one record in the store. Their indices along the dimensions form a box."""

    number: int
    "The number of the chunk, from 0, in C order: the last dimension varies fastest."
    region: tuple[slice, ...]
    "The indices of the members along each dimension."

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(part.stop - part.start for part in self.region)


@dataclasses.dataclass(frozen=True)
class Spec(Shown):
    """The specification of a sweep.

    Each parameter of a grid is a *dimension* of the sweep. A list is one dimension, `member`, and
    random samples are one dimension, `sample`. The *members* are all combinations of indices along
    the dimensions. A *chunk* is a box of members with one record in the store. The field `chunk` of
    the file is its number of members, and one call of the task computes one chunk. Without it,
    chunks are small, and one call computes as many of them as it can in about a second.

    A bundled specification, with 72 angles on each of two maps:

        >>> from jaxcell import bundled, sweep
        >>> spec = sweep.Spec.load(bundled("lab_groups"))
        >>> spec.dimensions, spec.members, spec.chunk_count, list(spec.fixed)
        ({'map': 2, 'bounce': 72}, 144, 6, ['cell', 'directions', 'collision'])
    """

    path: Path
    "The file of the specification."
    folder: Path
    "The folder of the user's file, where relative paths begin, even if `path` is a copy elsewhere."
    text: bytes
    "The content of the file."
    document: Mapping[str, Any]
    "The parsed content."
    task: str
    "The name of a task, or `module:function`."
    seed: int
    results: tuple[str, ...]
    "The names of the quantities to compute; if empty, all numbers of the study."
    fixed: Mapping[str, Any]
    "Values of parameters that all members share."
    parameters: tuple[Parameter, ...]
    lengths: Mapping[str, int]
    "The number of members of a chunk along each dimension; the last chunks may have fewer."

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Spec":
        """Read a specification from a file."""
        path = Path(path)
        check_file(path, "a TOML")
        return cls.parse(path.read_bytes(), path, path.parent)

    @classmethod
    def parse(cls, text: bytes, path: Path, folder: Path) -> "Spec":
        """Parse a specification. Errors name `path`; paths in the text are relative to `folder`."""
        try:
            document = tomllib.loads(text.decode("utf-8"))
            return cls._read(path, folder, text, document)
        except RecursionError:
            raise ValueError(f"{path}: its brackets are nested too deeply") from None
        except ValueError as error:
            # Names and values may be of any length.
            message = str(error)
            if isinstance(error, tomllib.TOMLDecodeError) and (found := _NO_ZERO.search(text)):
                number = found[1].decode()
                message += f"; write 0{number} for {number}"
            cut = message[:_MAX_LETTERS] + "..." * (len(message) > _MAX_LETTERS)
            raise ValueError(f"{path}: {cut}") from None

    @classmethod
    def _read(cls, path: Path, folder: Path, text: bytes, document: dict[str, Any]) -> "Spec":
        unknown = next((field for field in document if field not in _FIELDS), None)
        if unknown is not None:
            raise ValueError(f"unknown field {unknown!r}; expected {', '.join(_FIELDS)}")
        task = document.get("task")
        if not isinstance(task, str) or not task:
            raise ValueError(
                f'task: expected the name of a task, or "module:function", got {task!r}'
            )
        seed = document.get("seed", 0)
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**63:
            raise ValueError(f"seed: expected an integer from 0 to 2^63 - 1, got {seed!r}")
        results = document.get("results", [])
        if not isinstance(results, list) or not all(isinstance(name, str) for name in results):
            raise ValueError(f"results: expected a list of names, got {reprlib.repr(results)}")
        tables = {name: document.get(name, {}) for name in _TABLES}
        for name, table in tables.items():
            if not isinstance(table, dict):
                raise ValueError(f"{name}: expected a table, got {reprlib.repr(table)}")
        fixed = tables["fixed"]
        parameters = read_parameters(tables["grid"], tables["list"], tables["random"], seed)
        for name in fixed:
            check_name(name)
            if any(name == parameter.name for parameter in parameters):
                raise ValueError(f"fixed.{name} is also a parameter; give only one of the two")
        sizes = {parameter.dimension: parameter.values.size for parameter in parameters}
        usual = max(1, -(-math.prod(sizes.values()) // _USUAL_CHUNKS))
        lengths = _chunk_lengths(document.get("chunk", usual), sizes)
        about = task, seed, tuple(results), fixed
        spec = cls(path, folder, text, document, *about, parameters, lengths)
        if spec.chunk_count > _MAX_CHUNKS:
            raise ValueError(
                f"chunk: {spec.chunk_count} chunks for {spec.members} members; expected at most "
                f"{_MAX_CHUNKS}, so choose larger chunks"
            )
        return spec

    @property
    def folders(self) -> list[Path]:
        """The folders for relative paths: that of the specification, then the current folder."""
        return [*dict.fromkeys((self.folder.resolve(), Path.cwd()))]

    def find_file(self, name: str) -> Path | None:
        """Find a file or folder by its path, or by its bundled name `@NAME`; `None` if missing."""
        if name.startswith("@"):
            return bundled_names().get(name[1:])
        paths = (folder / name for folder in self.folders)
        return next((path for path in paths if os.path.exists(path)), None)

    @functools.cached_property
    def dimensions(self) -> dict[str, int]:
        """The dimensions of the sweep and their sizes, in the order of the file."""
        return {parameter.dimension: parameter.values.size for parameter in self.parameters}

    @property
    def has_indices(self) -> bool:
        """True if the design is `saltelli`, for which `sobol_indices` works."""
        return self.document.get("random", {}).get("design") == SALTELLI

    @functools.cached_property
    def members(self) -> int:
        return math.prod(self.dimensions.values())

    @functools.cached_property
    def chunk_grid(self) -> tuple[int, ...]:
        """The number of chunks along each dimension."""
        return tuple(-(-size // self.lengths[name]) for name, size in self.dimensions.items())

    @functools.cached_property
    def chunk_count(self) -> int:
        return math.prod(self.chunk_grid)

    def chunk(self, number: int) -> Chunk:
        """Return a chunk by its number."""
        index = map(int, np.unravel_index(number, self.chunk_grid))
        region = tuple(
            slice(place * self.lengths[name], min((place + 1) * self.lengths[name], size))
            for place, (name, size) in zip(index, self.dimensions.items(), strict=True)
        )
        return Chunk(number, region)

    def batch(self, chunk: Chunk) -> dict[str, np.ndarray]:
        """Return the values of each parameter for the members of a chunk, in C order."""
        ranges = (np.arange(part.start, part.stop) for part in chunk.region)
        places = np.meshgrid(*ranges, indexing="ij")
        along = dict(zip(self.dimensions, places, strict=True))
        return {
            parameter.name: parameter.values[along[parameter.dimension].ravel()]
            for parameter in self.parameters
        }

    def index(self, chunk: Chunk, place: int) -> dict[str, int]:
        """Convert the index `place` of a member in a chunk to its index along each dimension."""
        inside = np.unravel_index(place, chunk.shape)
        return {
            name: part.start + int(offset)
            for name, part, offset in zip(self.dimensions, chunk.region, inside, strict=True)
        }

    def member(self, index: Mapping[str, int]) -> dict[str, Any]:
        """Return the parameters of a member, from its index along each dimension."""
        return {
            parameter.name: parameter.values[index[parameter.dimension]].item()
            for parameter in self.parameters
        }

    def differences(self, other: "Spec") -> list[str]:
        """Describe the differences from another specification, such as "seed: 1 there, 2 here".

        This specification is "there", the other "here". Long values show only where they differ.
        """
        if self.text == other.text:
            return []
        differences = []
        ours, theirs = dict(_flat(self._compared())), dict(_flat(other._compared()))
        for field in dict.fromkeys(itertools.chain(ours, theirs)):
            there, here = ours.get(field, "nothing"), theirs.get(field, "nothing")
            if there != here:
                pairs = enumerate(zip(there, here, strict=False))
                place = next((i for i, (a, b) in pairs if a != b), min(len(there), len(here)))
                differences.append(f"{field}: {_cut(there, place)} there, {_cut(here, place)} here")
        if not differences and list(self.dimensions) != list(other.dimensions):
            differences.append(f"grid: in the order {', '.join(self.dimensions)} there")
        return differences

    def places_in(self, old: "Spec") -> dict[str, np.ndarray] | None:
        """Find the members of this specification in a smaller one, `old`.

        **Returns:** for each dimension, an array that maps each index of this specification to the
        index of the same values in `old`, or to -1 for new values; `None` if this specification
        lacks a member of `old`, or if the specifications differ in another field.
        """
        names = {one.name: (one.dimension, one.values.dtype.kind) for one in self.parameters}
        if (
            list(_flat(self._rest())) != list(_flat(old._rest()))
            or list(self.dimensions) != list(old.dimensions)
            or names != {one.name: (one.dimension, one.values.dtype.kind) for one in old.parameters}
        ):
            return None
        places = {}
        for dimension in self.dimensions:
            there: dict[tuple[Any, ...], deque[int]] = {}
            for place, row in enumerate(old._rows(dimension)):
                there.setdefault(row, deque()).append(place)
            along = [
                there[row].popleft() if there.get(row) else -1 for row in self._rows(dimension)
            ]
            if any(there.values()):
                return None
            places[dimension] = np.array(along)
        return places

    def _rest(self) -> dict[str, Any]:
        """Return the document without the tables of parameters, with its fields sorted."""
        rest = {name: self.document[name] for name in sorted(self.document)}
        return {name: value for name, value in rest.items() if name not in _PARAMETERS}

    def _compared(self) -> dict[str, Any]:
        """Return the document, with ranges and distributions replaced by lists of their values."""
        tables: dict[str, dict[str, Any]] = {}
        for parameter in self.parameters:
            tables.setdefault(parameter.table, {})[parameter.name] = parameter.values.tolist()
        return {**self._rest(), **tables}

    def _rows(self, dimension: str) -> Iterator[tuple[Any, ...]]:
        """Yield, for each index along a dimension, the values of its parameters, sorted by name."""
        own = sorted((one.name, one) for one in self.parameters if one.dimension == dimension)
        return zip(*(one.values.tolist() for _, one in own), strict=True)


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the name of each nested field, and its value as text, so that 1 and 1.0 differ."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, repr(value)


def _cut(text: str, place: int) -> str:
    start = max(place - 20, 0)
    end = start + 60
    return "..." * (start > 0) + text[start:end] + "..." * (end < len(text))


def _chunk_lengths(given: Any, sizes: Mapping[str, int]) -> dict[str, int]:
    if isinstance(given, dict):
        for name, length in given.items():
            if name not in sizes:
                raise ValueError(f"chunk.{name}: expected a dimension, {', '.join(sizes)}")
            _check_length(f"chunk.{name}", length)
        return {name: min(given.get(name, size), size) for name, size in sizes.items()}
    _check_length("chunk", given)
    return packed(sizes, given)


def packed(sizes: Mapping[str, int], most: int) -> dict[str, int]:
    """Choose the shape of boxes with at most `most` members that tile a grid of shape `sizes`."""
    lengths = {}
    # Boxes span the last dimensions while these fit. Equal parts need the least padding.
    for name, size in reversed([*sizes.items()]):
        parts = -(-size // min(most, size))
        lengths[name] = -(-size // parts)
        most = max(most // lengths[name], 1)
    return {name: lengths[name] for name in sizes}


def _check_length(field: str, given: Any) -> None:
    if not isinstance(given, int) or isinstance(given, bool) or given < 1:
        raise ValueError(f"{field}: expected a number of members from 1, got {given!r}")
