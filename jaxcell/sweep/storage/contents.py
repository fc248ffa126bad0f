"""The contents of a journal: the last readable record of each kind and chunk."""

import dataclasses
from collections.abc import Mapping

from ..workers.work import Computed
from .journal import JOURNAL, Journal, Kind, Record
from .records import Begun, Exported, decode


@dataclasses.dataclass
class Contents:
    """The last readable records of a journal, and its damage."""

    begun: Begun | None = None
    frame: Computed | None = None
    chunks: dict[int, Record] = dataclasses.field(default_factory=dict)
    exported: Mapping[str, str] | None = None
    "The SHA-256 of each file of the result; `None` if the result has to be made."
    readable: list[Record] = dataclasses.field(default_factory=list)
    damage: dict[str, Record | None] = dataclasses.field(default_factory=dict)
    "The damaged records, by their descriptions; `None` for a record with a damaged header."

    @classmethod
    def read(cls, journal: Journal, *, check: bool) -> "Contents":
        """Read a journal.

        **Raises:** `msgspec.DecodeError` for a record with unknown content.
        """
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

    def _add(self, record: Record, content: bytes) -> None:
        self.readable.append(record)
        # A record after the list of the files means that the result is out of date.
        self.exported = None
        if record.kind == Kind.SPEC:
            self.begun = decode(content, Begun)
        elif record.kind == Kind.FRAME:
            self.frame = decode(content, Computed)
        elif record.kind == Kind.EXPORT:
            self.exported = decode(content, Exported).files
        else:
            self.chunks[record.number] = record
            self.damage.pop(record.description, None)
