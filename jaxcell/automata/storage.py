"""A file of int32 arrays and a JSON header, with a checksum.

Magic bytes and version, length of the header, header, length of the payload, payload, SHA-256 of
all before. The payload is one zlib stream of the differences between neighbours in each array, in
pieces, each as its lowest bytes, then the next ones, and so on: sorted cells differ by little, so
most of it is zeros.
"""

import hashlib
import itertools
import json
import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int32

from ..files import replacing


_MAGIC = b"jaxcell\0"
_VERSION = 1
_PREFIX = struct.Struct("<8sII")
_LENGTH = struct.Struct("<Q")
_PIECE = 1 << 20
# No zlib stream grows more than this many times when it is read.
_ZLIB_RATIO = 1032


def write_arrays(
    path: str | os.PathLike[str],
    header: Mapping[str, Any],
    arrays: Mapping[str, Int32[np.ndarray, "_"]],
) -> None:
    """Writes a file at once or not at all; equal content gives equal bytes.

    **Arguments:**

    - `path`: the file to write or replace.
    - `header`: any JSON object.
    - `arrays`: the arrays by name.
    """
    lengths = {name: array.size for name, array in arrays.items()}
    text = json.dumps({"header": header, "arrays": lengths}, sort_keys=True).encode()
    compressor = zlib.compressobj(level=1)
    payload = bytearray()
    for name in sorted(arrays):
        previous = np.zeros(1, np.int32)
        for begin in range(0, lengths[name], _PIECE):
            piece = arrays[name][begin : begin + _PIECE].astype("<i4")
            planes = np.diff(piece, prepend=previous).view(np.uint8).reshape(-1, 4).T
            payload += compressor.compress(planes.tobytes())
            previous = piece[-1:]
    payload += compressor.flush()
    content = b"".join(
        [
            _PREFIX.pack(_MAGIC, _VERSION, len(text)),
            text,
            _LENGTH.pack(len(payload)),
            payload,
        ]
    )
    with replacing(path) as temporary:
        temporary.write_bytes(content + hashlib.sha256(content).digest())


def read_arrays(
    path: str | os.PathLike[str],
) -> tuple[dict[str, Any], dict[str, Int32[np.ndarray, "_"]]]:
    """Reads a file of [`write_arrays`][].

    **Returns:** the header and the arrays.

    **Raises:** `ValueError` if it is not such a file, is of another version, or was truncated or
    altered.
    """
    content = memoryview(Path(path).read_bytes())
    if content[: len(_MAGIC)] != _MAGIC:
        raise ValueError(f"{path}: not a jaxcell file")
    if len(content) < _PREFIX.size:
        raise ValueError(f"{path}: truncated; {len(content)} bytes are less than its prefix")
    _, version, text_size = _PREFIX.unpack_from(content)
    body, digest = content[:-32], content[-32:]
    intact = hashlib.sha256(body).digest() == digest
    if intact and version != _VERSION:
        raise ValueError(f"{path}: format version {version}; this program reads {_VERSION}")
    if not intact:
        raise ValueError(f"{path}: truncated or altered; its checksum does not agree")
    begin = _PREFIX.size + text_size + _LENGTH.size
    if begin > len(body) or _LENGTH.unpack_from(body, begin - _LENGTH.size)[0] != len(body) - begin:
        raise ValueError(f"{path}: its lengths do not agree with its {len(content)} bytes")
    try:
        described = json.loads(bytes(body[_PREFIX.size : begin - _LENGTH.size]))
        header, lengths = described["header"], described["arrays"]
        if not isinstance(header, dict) or not isinstance(lengths, dict):
            raise ValueError("expected a header and the lengths of arrays")
        if not all(type(length) is int for length in lengths.values()):
            raise ValueError("expected whole numbers as the lengths of arrays")
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise ValueError(f"{path}: its header cannot be read: {error}") from error
    size = 4 * sum(lengths.values())
    if min(lengths.values(), default=0) < 0 or size > _ZLIB_RATIO * (len(body) - begin):
        raise ValueError(f"{path}: arrays of {size} bytes cannot come from its payload")
    return header, _unpack(path, body[begin:], lengths)


def _unpack(
    path: str | os.PathLike[str], payload: memoryview, lengths: Mapping[str, int]
) -> dict[str, Int32[np.ndarray, "_"]]:
    inflater = _Inflater(payload)
    arrays = {}
    try:
        for name in sorted(lengths):
            array = np.empty(lengths[name], np.int32)
            previous = np.int32(0)
            for begin in range(0, array.size, _PIECE):
                piece = array[begin : begin + _PIECE]
                planes = np.frombuffer(inflater.read(4 * piece.size), np.uint8).reshape(4, -1)
                np.cumsum(np.ascontiguousarray(planes.T).view("<i4"), out=piece, dtype=np.int32)
                piece += previous
                previous = piece[-1]
            arrays[name] = array
        inflater.finish()
    except zlib.error as error:
        raise ValueError(f"{path}: its payload cannot be read: {error}") from error
    return arrays


class _Inflater:
    """Reads a zlib stream piece by piece; `zlib.error` where it is not what it should be."""

    def __init__(self, payload: memoryview):
        self._slices = iter(
            [bytes(payload[i : i + (1 << 16)]) for i in range(0, len(payload), 1 << 16)]
        )
        self._decompressor = zlib.decompressobj()

    def read(self, size: int) -> bytearray:
        read = bytearray()
        while len(read) < size:
            waiting = self._decompressor.unconsumed_tail or next(self._slices, b"")
            more = self._decompressor.decompress(waiting, size - len(read))
            if not more and (not waiting or self._decompressor.eof):
                raise zlib.error("it ends early")
            read += more
        return read

    def finish(self) -> None:
        for waiting in itertools.chain([self._decompressor.unconsumed_tail], self._slices):
            if self._decompressor.decompress(waiting, 1):
                raise zlib.error("it goes on past its arrays")
        if not self._decompressor.eof or self._decompressor.unused_data:
            raise zlib.error("its end is not where it should be")
