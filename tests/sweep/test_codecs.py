"""Files of arrays, beside those that Zarr writes and reads."""

import itertools
import json

import numpy as np
import pytest
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from jaxcell.sweep.storage.codecs import (
    check_codecs,
    decoded,
    described_array,
    encoded,
)
from jaxcell.sweep.storage.frame import fill


CODECS = (ZstdCodec(), Crc32cCodec())
KINDS = ["bool", "int8", "uint16", "int64", "float32", "float64", "complex128"]


@pytest.fixture
def array(tmp_path):
    """Writes values by Zarr, in chunks of four by three, and gives the array and its metadata."""

    def written(values, codecs=CODECS):
        found = zarr.create_array(
            tmp_path / "array",
            data=values,
            overwrite=True,
            chunks=(4, 3),
            fill_value=values.dtype.type(1),
            compressors=codecs,
            config={"write_empty_chunks": True},
        )
        return found, json.loads((tmp_path / "array" / "zarr.json").read_bytes())

    return written


@pytest.mark.parametrize("kind", KINDS)
def test_they_are_those_of_zarr(array, tmp_path, kind):
    values = np.random.default_rng(0).integers(0, 9, (7, 6)).astype(kind)
    _, metadata = array(values)
    # The second has one row less than a chunk.
    for i, part in enumerate((values[:4, :3], values[4:, :3])):
        file = tmp_path / "array" / "c" / str(i) / "0"
        content = file.read_bytes()
        assert encoded(part, metadata) == content
        np.testing.assert_array_equal(decoded(content, metadata)[: len(part)], part)
        assert decoded(content, metadata).dtype == values.dtype


@pytest.mark.parametrize(
    ("kind", "filled"),
    [*itertools.product([*KINDS, "uint64", ">f8", "complex64"], (True, False)), ("str", False)],
)
def test_metadata_is_that_of_zarr(tmp_path, kind, filled):
    dtype = np.dtype(kind)
    value = fill(dtype) if filled else np.zeros((), dtype)[()]
    attributes = {"long_name": "größe", "some": [1, 2.5, None, True, float("nan")]}
    zarr.create_array(
        tmp_path,
        shape=(3, 5),
        chunks=(2, 3),
        dtype=np.dtypes.StringDType() if dtype.kind == "U" else dtype,
        fill_value=value,
        compressors=CODECS,
        attributes=attributes,
        dimension_names=["a", "b"],
    )
    metadata = described_array(dtype, (3, 5), (2, 3), value, ("a", "b"), attributes)
    assert json.dumps(metadata, indent=2) == (tmp_path / "zarr.json").read_text()


def test_files_of_strings_are_those_of_zarr(tmp_path):
    values = np.array(["b.json", "", "größe", "\U0001f916 and more"])
    zarr.create_array(
        tmp_path, data=values.astype(np.dtypes.StringDType()), chunks=(4,), compressors=CODECS
    )
    metadata = described_array(values.dtype, (4,), (4,), "", ("name",), {})
    assert encoded(values, metadata) == (content := (tmp_path / "c" / "0").read_bytes())
    assert decoded(content, metadata).tolist() == values.tolist()


@pytest.mark.parametrize("place", [0, 5, -1])
def test_a_flipped_bit_is_seen(array, tmp_path, place):
    _, metadata = array(np.arange(12.0).reshape(4, 3))
    content = bytearray((tmp_path / "array" / "c" / "0" / "0").read_bytes())
    content[place] ^= 16
    with pytest.raises(RuntimeError, match="do not match"):
        decoded(bytes(content), metadata)
    with pytest.raises(ValueError, match="too short"):
        decoded(b"", metadata)


def test_codecs_of_others_are_told(array):
    for codecs, told in {
        (
            zarr.codecs.GzipCodec(),
        ): "speed has the codecs bytes, gzip; expected bytes, zstd, crc32c",
        (ZstdCodec(),): "speed has the codecs bytes, zstd; expected bytes, zstd, crc32c",
    }.items():
        _, metadata = array(np.zeros((4, 3)), codecs)
        with pytest.raises(ValueError, match=told):
            check_codecs("speed", metadata)
