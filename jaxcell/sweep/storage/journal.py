"""The journal of a sweep: a file of records, to which a run appends the results of the chunks.

A record has a header and content. Both have a checksum, so any changed bit is found. Records never
change; a later record of a chunk replaces an earlier one. If a process is killed, its records are
kept, and an incomplete record at the end of the file is ignored.
"""

import dataclasses
import enum
import mmap
import os
import struct
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

from ...base.documents import NewerVersionError


JOURNAL = "sweep.journal"
_MARK = b"\xf5Rec"
# Mark, kind, state, number, and the length and CRC-32 of the content. Their CRC-32 follows.
_FIELDS = struct.Struct("<4sBBQQI")
_CHECKSUM = struct.Struct("<I")
_HEADER = _FIELDS.size + _CHECKSUM.size
# A loss of power, unlike a kill, may lose the records of the last second.
_SECONDS_BETWEEN_SYNCS = 1.0


class Kind(enum.IntEnum):
    SPEC = 1
    FRAME = 2
    CHUNK = 3
    EXPORT = 4


@dataclasses.dataclass(frozen=True)
class Record:
    """The header of a record in a journal."""

    kind: Kind
    state: int
    "The state of the chunk, such as `DONE`; 0 in a record that is not about a chunk."
    number: int
    "The number of the chunk; 0 in a record that is not about a chunk."
    start: int
    "The position of the content in the file, in bytes."
    length: int
    checksum: int

    @property
    def description(self) -> str:
        if self.kind == Kind.CHUNK:
            return f"chunk {self.number}"
        return f"{JOURNAL}, {self.kind.name.lower()}"

    @property
    def end(self) -> int:
        return self.start + self.length

    @property
    def size(self) -> int:
        return _HEADER + self.length


class Journal:
    """The open file of a journal. If `append` is true, records can be added."""

    def __init__(self, path: Path, *, append: bool = False) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND if append else os.O_RDONLY
        self._file = os.open(path, flags, 0o666)
        self._synced = time.monotonic()
        self._end: int | None = None

    def close(self) -> None:
        os.close(self._file)

    def records(self) -> Iterator[Record | int]:
        """Yield each complete record, and the position in the file of each damaged header."""
        size = self.size
        if size == 0:
            return
        with mmap.mmap(self._file, size, access=mmap.ACCESS_READ) as data:
            place = 0
            while place + _HEADER <= size:
                record = _read_header(data, place)
                if record is None:
                    yield place
                    place = data.find(_MARK, place + 1)
                    while place >= 0 and _read_header(data, place) is None:
                        place = data.find(_MARK, place + 1)
                    if place < 0:
                        return
                elif record.end > size:
                    return
                else:
                    yield record
                    place = record.end

    def content(self, record: Record) -> bytes:
        content = os.pread(self._file, record.length, record.start)
        if zlib.crc32(content) != record.checksum:
            raise ValueError(f"the checksum of the record at byte {record.start} does not match")
        return content

    def append(self, kind: Kind, content: bytes, number: int = 0, state: int = 0) -> Record:
        """Append a record, which is kept even if this process is killed afterwards."""
        if self._end is not None:
            os.ftruncate(self._file, self._end)
            self._end = None
        checksum = zlib.crc32(content)
        fields = _FIELDS.pack(_MARK, kind, state, number, len(content), checksum)
        left = memoryview(fields + _CHECKSUM.pack(zlib.crc32(fields)) + content)
        start = self.size + _HEADER
        while left:
            left = left[os.write(self._file, left) :]
        if time.monotonic() > self._synced + _SECONDS_BETWEEN_SYNCS:
            self.sync()
        return Record(kind, state, number, start, len(content), checksum)

    @property
    def size(self) -> int:
        """The size of the file, in bytes."""
        return os.fstat(self._file).st_size

    def append_at(self, size: int) -> None:
        """Let the next record begin at `size` bytes; it replaces an incomplete record there."""
        self._end = size

    def sync(self) -> None:
        """Wait until all records are on the disk."""
        os.fsync(self._file)
        self._synced = time.monotonic()


def _read_header(data: mmap.mmap, place: int) -> Record | None:
    """Read the header at byte offset `place`; `None` if there is no intact header."""
    fields = data[place : place + _FIELDS.size]
    checksum = data[place + _FIELDS.size : place + _HEADER]
    if len(checksum) < _CHECKSUM.size or _CHECKSUM.unpack(checksum) != (zlib.crc32(fields),):
        return None
    mark, kind, state, number, length, content = _FIELDS.unpack(fields)
    if mark != _MARK:
        return None
    if kind not in Kind.__members__.values():
        raise NewerVersionError(
            f"{JOURNAL}: it has records of the unknown kind {kind}; a newer jaxcell wrote it, and "
            "reads it: pip install --upgrade jaxcell"
        )
    return Record(Kind(kind), state, number, place + _HEADER, length, content)
