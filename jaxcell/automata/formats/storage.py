"""Files of int32 arrays and a JSON header, in the `.npz` format of NumPy with another suffix.

An array is stored as the differences between neighbouring numbers, because most differences of
sorted cells are small and compress well.
"""

import contextlib
import json
import os
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int32

from ...base.documents import Fields, about
from ...base.memory import check
from ...base.paths import replacing
from ...base.results import LARGEST_HEADER, current_run


_HEADER = "header"
_VERSION = 1
# The first bytes of files of earlier versions, which were not `.npz` files.
_OLD = b"jaxcell\0"
LARGEST = 2**30
"""The largest number of bytes that a file may decompress to: the largest filters take a tenth of
it, and the computer of a robot has little memory."""


class _TooLargeError(Exception):
    pass


def write_arrays(
    path: str | os.PathLike[str],
    header: Mapping[str, Any],
    arrays: Mapping[str, Int32[np.ndarray, "_"]],
) -> None:
    """Write a header and arrays to a file, completely or not at all.

    Equal contents give equal bytes.
    """
    run = {} if current_run() is None else {"run_id": current_run()}
    header = {"version": _VERSION, **run, **header}
    text = json.dumps(header, sort_keys=True).encode()
    stored: dict[str, Any] = {_HEADER: np.frombuffer(text, np.uint8)}
    stored |= {name: np.diff(arrays[name], prepend=np.int32(0)) for name in sorted(arrays)}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **stored)


def read_kind(path: str | os.PathLike[str]) -> str:
    """Read the `kind` in the header of a file that [`write_arrays`][] wrote, but not the arrays."""
    return str(_read(path, headed=True)[0].get("kind"))


@contextlib.contextmanager
def reading(
    path: str | os.PathLike[str], kind: str
) -> Iterator[tuple[dict[str, Any], dict[str, Int32[np.ndarray, "_"]]]]:
    """Read the header and the arrays of a file, and check its kind and its metadata.

    A `KeyError` or a `ValueError` in the `with` block becomes a `ValueError` that names the file.
    """
    header, arrays = read_arrays(path)
    with about(path):
        try:
            if header["kind"] != kind:
                raise ValueError(f"it is a {str(header['kind'])[:60]}, not a {kind}")
            if not isinstance(header["metadata"], dict):
                raise ValueError("metadata: expected an object")
            yield header, arrays
        except KeyError as error:
            raise ValueError(f"{error} is missing") from error


def checked_metadata(metadata: Mapping[str, Any]) -> Any:
    """Check that metadata is a JSON object, and return it as a file would store it."""
    try:
        return json.loads(json.dumps(dict(metadata), allow_nan=False))
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"metadata: expected a JSON object: {error}") from error


def read_arrays(
    path: str | os.PathLike[str],
) -> tuple[dict[str, Any], dict[str, Int32[np.ndarray, "_"]]]:
    """Read the header and the arrays of a file that [`write_arrays`][] wrote."""
    header, arrays = _read(path)
    for name, array in arrays.items():
        if array.dtype != np.int32 or array.ndim != 1:
            raise ValueError(f"{path}: {name}: expected a list of 32-bit numbers")
        np.cumsum(array, dtype=np.int32, out=array)
    return header, arrays


def _read(
    path: str | os.PathLike[str], headed: bool = False
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read the header and the arrays in their stored form; if `headed`, only the header."""
    with Path(path).open("rb") as file:
        if file.read(len(_OLD)) == _OLD:
            raise ValueError(
                f"{path}: it is of an earlier version of jaxcell, whose files are not read; "
                "make the filter again"
            )
        file.seek(0)
        try:
            with zipfile.ZipFile(file) as parts:
                size = sum(part.file_size for part in parts.infolist())
                head = parts.getinfo(f"{_HEADER}.npy").file_size
            if head > LARGEST_HEADER:
                raise _TooLargeError(f"its header has {head:,} bytes, more than {LARGEST_HEADER:,}")
            if size > LARGEST:
                raise _TooLargeError(f"it decompresses to {size:,} bytes, more than {LARGEST:,}")
            check(size, str(path), "expected a smaller file")
            with np.lib.npyio.NpzFile(file) as stored:
                arrays = {name: stored[name] for name in ([_HEADER] if headed else stored.files)}
            header = json.loads(arrays.pop(_HEADER).tobytes())
        except MemoryError as error:
            raise MemoryError(f"{path}: {error}") from None
        except _TooLargeError as error:
            raise ValueError(f"{path}: {error}") from None
        # The exceptions of zipfile and NumPy for a damaged file are not documented.
        except Exception as error:
            text = f"{path}: not a jaxcell file, truncated or altered: {str(error)[:200]}"
            raise ValueError(text) from error
    if not isinstance(header, dict):
        raise ValueError(f"{path}: its header: expected a JSON object")
    Fields(header, f"{path}: ").check_version(_VERSION)
    return header, arrays
