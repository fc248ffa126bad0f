"""What is in the files of an array: as Zarr has it, without importing Zarr or waiting for it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numcodecs.checksum32 import CRC32C
from numcodecs.vlen import VLenUTF8
from numcodecs.zstd import Zstd


_CODECS = {"zstd": Zstd(level=0), "crc32c": CRC32C(location="end")}


def described_array(
    dtype: np.dtype,
    shape: Sequence[int],
    chunks: Sequence[int],
    fill: Any,
    dimensions: Sequence[str],
    attributes: Mapping[str, Any],
) -> dict[str, Any]:
    """The metadata of an array of numbers, booleans or strings, as in its `zarr.json`.

    **Arguments:**

    - `chunks`: the shape of what a file of it holds.
    - `fill`: what stands where there is no file.
    """
    if dtype.kind == "U":
        first: dict[str, Any] = {"name": "vlen-utf8", "configuration": {}}
    elif dtype.itemsize == 1:
        first = {"name": "bytes"}
    else:
        first = {"name": "bytes", "configuration": {"endian": "little"}}
    zstd = {"name": "zstd", "configuration": {"level": 0, "checksum": False}}
    # A file has at least one place, where an array may have none.
    places = [max(size, 1) for size in chunks]
    return {
        "shape": [*shape],
        "data_type": "string" if dtype.kind == "U" else dtype.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": places}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": _plain_fill(np.asarray(fill, dtype).item()),
        "codecs": [first, zstd, {"name": "crc32c"}],
        "attributes": dict(attributes),
        "dimension_names": [*dimensions],
        "zarr_format": 3,
        "node_type": "array",
        "storage_transformers": [],
    }


def _plain_fill(value: Any) -> Any:
    """A fill value in JSON."""
    if isinstance(value, complex):
        return [_plain_fill(value.real), _plain_fill(value.imag)]
    return "NaN" if value != value else value


def check_codecs(name: str, metadata: Mapping[str, Any]) -> None:
    """Raise `ValueError` for an array whose files are not encoded as those of a sweep are.

    **Arguments:**

    - `name`: of the array.
    - `metadata`: of the array, by `described_array`; so for the others here.
    """
    codecs = [codec["name"] for codec in metadata["codecs"]]
    if codecs != ["bytes", *_CODECS]:
        raise ValueError(
            f"{name} has the codecs {', '.join(codecs)}; expected bytes, {', '.join(_CODECS)}"
        )


def kind_of(metadata: Mapping[str, Any]) -> np.dtype:
    """The type of the numbers or booleans of an array."""
    return np.dtype(metadata["data_type"]).newbyteorder("<")


def fill_of(metadata: Mapping[str, Any]) -> Any:
    """What stands where nothing is known of an array of numbers or booleans."""
    value = metadata["fill_value"]
    kind = kind_of(metadata).type
    return kind(complex(*map(float, value))) if isinstance(value, list) else kind(value)


def decoded(content: bytes, metadata: Mapping[str, Any]) -> np.ndarray:
    """The values of a file, as many as a chunk of Zarr has: more than there are at an edge.

    **Raises:** `ValueError` or `RuntimeError` if it is damaged.
    """
    for codec in reversed(_CODECS.values()):
        content = codec.decode(content)
    if metadata["data_type"] == "string":
        return VLenUTF8().decode(content).astype(np.str_)
    return np.frombuffer(content, kind_of(metadata)).reshape(_shape(metadata))


def encoded(values: np.ndarray, metadata: Mapping[str, Any]) -> bytes:
    """What the file of some values has in it; beyond an edge it has the fill value."""
    if values.dtype.kind == "U":
        content = VLenUTF8().encode(values.astype(object))
    else:
        whole = np.full(_shape(metadata), fill_of(metadata), kind_of(metadata))
        whole[tuple(slice(size) for size in values.shape)] = values
        content = whole.tobytes()
    for codec in _CODECS.values():
        content = codec.encode(content)
    return bytes(content)


def _shape(metadata: Mapping[str, Any]) -> list[int]:
    return metadata["chunk_grid"]["configuration"]["chunk_shape"]
