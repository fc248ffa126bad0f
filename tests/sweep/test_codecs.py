"""Files of arrays, beside those that Zarr writes and reads."""

import json

import numpy as np
import pytest
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from jaxcell.sweep.codecs import check_codecs, decoded, encoded, has_checksums


CODECS = (ZstdCodec(), Crc32cCodec())
KINDS = ["bool", "int8", "uint16", "int64", "float32", "float64", "complex128"]


@pytest.fixture
def array(tmp_path):
    """Writes values by Zarr, in chunks of four by three, and gives the array and its metadata."""

    def written(values, codecs=CODECS):
        found = zarr.create_array(
            tmp_path / "array",
            data=values,
            chunks=(4, 3),
            fill_value=values.dtype.type(1),
            compressors=codecs,
            config={"write_empty_chunks": True},
        )
        return found, json.loads((tmp_path / "array" / "zarr.json").read_bytes())

    return written


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("codecs", [(), (ZstdCodec(),), (ZstdCodec(level=3), Crc32cCodec())])
def test_they_are_those_of_zarr(array, tmp_path, kind, codecs):
    values = np.random.default_rng(0).integers(0, 9, (7, 6)).astype(kind)
    found, metadata = array(values, codecs)
    assert has_checksums(metadata) == (len(codecs) == 2)
    # The second has one row less than a chunk.
    for i, part in enumerate((values[:4, :3], values[4:, :3])):
        file = tmp_path / "array" / "c" / str(i) / "0"
        content = file.read_bytes()
        assert encoded(part, found.fill_value, metadata) == content
        np.testing.assert_array_equal(decoded(content, metadata)[: len(part)], part)
        assert decoded(content, metadata).dtype == values.dtype


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
    _, metadata = array(np.zeros((4, 3)), (zarr.codecs.GzipCodec(),))
    with pytest.raises(ValueError, match="speed has the codec gzip; expected bytes, zstd, crc32c"):
        check_codecs("speed", metadata)
