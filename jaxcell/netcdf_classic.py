"""The length that the header of a classic NetCDF file promises.

The NetCDF library reads the end that a truncated classic file has lost as zeros, without an error,
and a current of zero looks like slack water. So the header is read here first.
"""

import math
import os
from typing import BinaryIO


_ITEM_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}


def promised_length(path: str | os.PathLike[str]) -> int | None:
    """How many bytes a classic NetCDF file must have to hold its data.

    Classic files are those of versions 1, 2 (64-bit offsets) and 5 (64-bit data).

    **Returns:** the least length in bytes, or `None` if the file is of another kind.

    **Raises:** `ValueError` if the header itself is cut short or makes no sense.
    """
    with open(path, "rb") as file:
        magic = file.read(4)
        if magic[:3] != b"CDF" or magic[3:] not in (b"\x01", b"\x02", b"\x05"):
            return None
        return _Header(file, magic[3]).promised_length()


class _Header:
    """A header being read: numbers are big-endian, and names and values fill whole words of 4."""

    def __init__(self, file: BinaryIO, version: int) -> None:
        self.file = file
        self.left = os.fstat(file.fileno()).st_size - 4
        self.count_bytes = 8 if version == 5 else 4
        self.offset_bytes = 4 if version == 1 else 8

    def promised_length(self) -> int:
        records = self.count()
        streaming = records == 256**self.count_bytes - 1  # the number was not known when writing
        lengths = [self.dimension() for _ in range(self.list_length())]
        self.skip_attributes()
        fixed_end, record_begin, record_sizes = 0, None, []
        for _ in range(self.list_length()):
            shape, item, begin = self.variable(lengths)
            if shape and shape[0] == 0:
                record_begin = begin if record_begin is None else min(begin, record_begin)
                record_sizes.append((begin, math.prod(shape[1:]) * item))
            else:
                fixed_end = max(fixed_end, begin + math.prod(shape) * item)
        if record_begin is None or records == 0 or streaming:
            return fixed_end
        # Each variable of a record is padded to whole words, unless it is the only one. The padding
        # after the very last value may be absent.
        sizes = [size for _, size in record_sizes]
        stride = sizes[0] if len(sizes) == 1 else sum(-(-size // 4) * 4 for size in sizes)
        last = max(begin + size for begin, size in record_sizes)
        return max(fixed_end, last + (records - 1) * stride)

    def take(self, size: int) -> bytes:
        if size > self.left:
            raise ValueError("the header ends in the middle")
        self.left -= size
        return self.file.read(size)

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "big")

    def count(self) -> int:
        return self.number(self.count_bytes)

    def list_length(self) -> int:
        self.take(4)  # the tag says of which kind the list is, which its place says too
        return self.count()

    def skip_words(self, size: int) -> None:
        self.take(-(-size // 4) * 4)

    def dimension(self) -> int:
        self.skip_words(self.count())
        return self.count()

    def item_bytes(self) -> int:
        kind = self.number(4)
        if kind not in _ITEM_BYTES:
            raise ValueError(f"the header has a value of kind {kind}, which does not exist")
        return _ITEM_BYTES[kind]

    def skip_attributes(self) -> None:
        for _ in range(self.list_length()):
            self.skip_words(self.count())
            item = self.item_bytes()
            self.skip_words(item * self.count())

    def variable(self, lengths: list[int]) -> tuple[list[int], int, int]:
        """The shape (0 for the record dimension), bytes a value, and place of the first value."""
        self.skip_words(self.count())
        dimensions = [self.count() for _ in range(self.count())]
        if any(dimension >= len(lengths) for dimension in dimensions):
            raise ValueError(f"the header has {len(lengths)} dimensions, but a variable has more")
        self.skip_attributes()
        item = self.item_bytes()
        self.take(self.count_bytes)  # the size of the variable, which overflows for large ones
        return [lengths[d] for d in dimensions], item, self.number(self.offset_bytes)
