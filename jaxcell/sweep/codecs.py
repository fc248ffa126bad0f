"""What is in a file of an array: as Zarr has it, without importing Zarr or waiting for it."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numcodecs.checksum32 import CRC32C
from numcodecs.zstd import Zstd


_CODECS = {"zstd": Zstd, "crc32c": lambda: CRC32C(location="end")}


def check_codecs(name: str, metadata: Mapping[str, Any]) -> None:
    """Raise `ValueError` for an array whose files are not encoded as those of a sweep are.

    **Arguments:**

    - `name`: of the array.
    - `metadata`: of the array, as in its `zarr.json`; so for the others here.
    """
    known = ("bytes", *_CODECS)
    for codec in metadata["codecs"]:
        if codec["name"] not in known:
            raise ValueError(f"{name} has the codec {codec['name']}; expected {', '.join(known)}")


def has_checksums(metadata: Mapping[str, Any]) -> bool:
    """Whether the files of an array have checksums: those of old versions of jaxcell have none."""
    return any(codec["name"] == "crc32c" for codec in metadata["codecs"])


def decoded(content: bytes, metadata: Mapping[str, Any]) -> np.ndarray:
    """The values of a file, as many as a chunk of Zarr has: more than there are at an edge.

    **Raises:** `ValueError` or `RuntimeError` if it is damaged.
    """
    for codec in reversed([*_codecs(metadata)]):
        content = codec.decode(content)
    return np.frombuffer(content, _kind(metadata)).reshape(_shape(metadata))


def encoded(values: np.ndarray, fill: Any, metadata: Mapping[str, Any]) -> bytes:
    """What the file of some values has in it; `fill` is for the places that are beyond an edge."""
    whole = np.full(_shape(metadata), fill, _kind(metadata))
    whole[tuple(slice(size) for size in values.shape)] = values
    content = whole.tobytes()
    for codec in _codecs(metadata):
        content = codec.encode(content)
    return bytes(content)


def _codecs(metadata: Mapping[str, Any]) -> Iterator[Any]:
    """Those after the first, which makes bytes of an array."""
    for codec in metadata["codecs"][1:]:
        yield _CODECS[codec["name"]](**codec.get("configuration", {}))


def _kind(metadata: Mapping[str, Any]) -> np.dtype:
    return np.dtype(metadata["data_type"]).newbyteorder("<")


def _shape(metadata: Mapping[str, Any]) -> list[int]:
    return metadata["chunk_grid"]["configuration"]["chunk_shape"]
