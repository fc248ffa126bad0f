"""The contents of a journal: the last readable record of each kind and chunk."""

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numcodecs.zstd import Zstd

from ...base.documents import check_version
from ..spec import Spec
from ..workers.work import Computed
from .journal import JOURNAL, Journal, Kind, Record


_ZSTD = Zstd(level=1)
_VERSION = 1


class Begun(msgspec.Struct):
    """The record of a sweep as a whole: its specification, and the attributes of its result."""

    text: bytes
    "The content of the specification file."
    folder: str
    "The folder of the specification, relative to the store."
    made: dict[str, Any]
    "The attributes of the result that name the versions, settings and files it depends on."
    version: int = 1
    "The version of the journal."

    @classmethod
    def of(cls, spec: Spec, folder: Path, made: Mapping[str, Any]) -> "Begun":
        """Create the record of a sweep whose store is in `folder`.

        Paths are relative, so that the store and the input files can be moved together.
        """
        files = os.path.relpath(spec.folder.resolve(), folder.resolve())
        return cls(spec.text, files, dict(made))

    def spec(self, folder: Path) -> Spec:
        """Parse the specification of the sweep whose store is in `folder`."""
        return Spec.parse(self.text, folder / "spec.toml", (folder / self.folder).resolve())


class Members(msgspec.Struct):
    """The record of a chunk: the state and the variables of each of its members."""

    states: bytes
    values: bytes
    "All variables, compressed; empty if no member is done."
    failed: dict[int, tuple[str, str]]
    "The message and the traceback of each failed member, by its index in the chunk."

    @classmethod
    def of(
        cls,
        states: np.ndarray,
        arrays: Mapping[str, np.ndarray],
        failed: Mapping[int, tuple[str, str]],
    ) -> "Members":
        values = b"".join(array.tobytes() for array in arrays.values())
        return cls(states.tobytes(), bytes(_ZSTD.encode(values)) if values else b"", dict(failed))

    def fill(self, states: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
        states[...] = np.frombuffer(self.states, np.int8).reshape(states.shape)
        values, start = _ZSTD.decode(self.values) if self.values else b"", 0
        for array in arrays.values() if values else ():
            own = np.frombuffer(values, array.dtype, array.size, start)
            array[...] = own.reshape(array.shape)
            start += array.nbytes


def encode(content: Any) -> bytes:
    """Encode the content of a record. An array is stored as its type, shape and bytes."""
    return msgspec.msgpack.encode(
        content, enc_hook=lambda array: (array.dtype.str, array.shape, array.tobytes())
    )


def decode(content: bytes, kind: Any) -> Any:
    return msgspec.msgpack.decode(content, type=kind, dec_hook=_array)


def _array(_: type, content: list[Any]) -> np.ndarray:
    dtype, shape, values = content
    return np.frombuffer(values, dtype).reshape(shape)


class Exported(msgspec.Struct):
    """The record which says that the result on the disk contains all records before this one."""

    files: dict[str, str]
    "The SHA-256 of each file of the result."


@dataclasses.dataclass
class Contents:
    """The records of a journal: the last readable one of each kind and chunk, and damaged ones."""

    begun: Begun | None = None
    frame: Computed | None = None
    chunks: dict[int, Record] = dataclasses.field(default_factory=dict)
    exported: Mapping[str, str] | None = None
    "The SHA-256 of each file of the result; `None` if the result is missing or out of date."
    others: dict[Kind, Record] = dataclasses.field(default_factory=dict)
    "The last readable record of each kind other than `CHUNK`."
    superseded: int = 0
    "The bytes of readable records that later records replace."
    readable: list[Record] = dataclasses.field(default_factory=list)
    damage: dict[str, Record | None] = dataclasses.field(default_factory=dict)
    "The damaged records, keyed by description; `None` stands for one with a damaged header."

    @classmethod
    def read(cls, journal: Journal, *, check: bool) -> "Contents":
        """Read a journal. The records of chunks are checked for damage only if `check` is true."""
        read = cls()
        for record in journal.records():
            if isinstance(record, int):
                read.damage[f"{JOURNAL}, byte {record}"] = None
                continue
            try:
                skipped = record.kind == Kind.CHUNK and not check
                content = b"" if skipped else journal.content(record)
            except ValueError:
                read.damage[record.description] = record
            else:
                read._add(record, content)
        return read

    def put(self, record: Record) -> None:
        """Replace the last record of the same chunk, or of the same other kind."""
        if record.kind == Kind.CHUNK:
            old, self.chunks[record.number] = self.chunks.get(record.number), record
        else:
            old, self.others[record.kind] = self.others.get(record.kind), record
        self.superseded += 0 if old is None else old.size

    def _add(self, record: Record, content: bytes) -> None:
        self.readable.append(record)
        self.put(record)
        # A record after the list of the files means that the result is out of date.
        self.exported = None
        if record.kind == Kind.SPEC:
            self.begun = decode(content, Begun)
            check_version(self.begun.version, _VERSION, f"{JOURNAL}: ")
        elif record.kind == Kind.FRAME:
            self.frame = decode(content, Computed)
        elif record.kind == Kind.EXPORT:
            self.exported = decode(content, Exported).files
        else:
            self.damage.pop(record.description, None)


def fill_value(dtype: np.dtype) -> Any:
    """Return the value of type `dtype` that stands for members that are not done."""
    return {"f": np.nan, "c": complex(np.nan, np.nan), "i": -1, "b": False}.get(
        dtype.kind, np.iinfo(dtype).max if dtype.kind == "u" else 0
    )


def check_fits(frame: Computed, computed: Computed) -> None:
    """Raise `ValueError` if a result does not have the variables of `frame`, the first result."""
    here, first = ({**one.variables, **one.coordinates} for one in (computed, frame))
    if here.keys() != first.keys():
        raise ValueError(
            f"the task gave {', '.join(sorted(here))}; the chunk that was done first has "
            f"{', '.join(sorted(first))}"
        )
    for name, variable in here.items():
        own, expected = (
            {
                "dimensions": [*one.dimensions],
                "shape": [*one.values.shape[name in computed.variables :]],
                "kind": "string" if one.values.dtype.kind == "U" else one.values.dtype,
                "attributes": dict(one.attributes),
            }
            for one in (variable, first[name])
        )
        for key, value in expected.items():
            if own[key] != value:
                raise ValueError(
                    f"the task gave {name!r} with the {key} {own[key]}; in the chunk that was "
                    f"done first it is {value}"
                )
        if name in computed.coordinates and not np.array_equal(variable.values, first[name].values):
            raise ValueError(
                f"the task gave a coordinate {name!r} with values other than those of the "
                "chunk that was done first"
            )
