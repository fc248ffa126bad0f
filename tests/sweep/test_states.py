"""States as readers find them, beside what Zarr finds in the same files."""

import json

import numpy as np
import pytest
import zarr

from jaxcell.sweep import run_sweep, sweep_status, verify_sweep
from jaxcell.sweep.storage.states import States


TEXT = "[grid]\ny = [0.5, 1.5, 2.5]\nz = [1, 2]\nx = {count = 11}"


@pytest.mark.parametrize("most", [1, 300, 2**20])
def test_they_are_those_that_zarr_reads(stub_spec, tmp_path, monkeypatch, most):
    monkeypatch.setattr("jaxcell.sweep.boxes._FILE_BYTES", most)
    spec, out = stub_spec("fail = 5", text=TEXT), tmp_path / "out"
    run_sweep(spec, out, chunks=range(spec.chunk_count - 3))
    expected = zarr.open_array(out / "sweep.zarr" / "status", mode="r")[...]
    assert {*np.unique(expected)} == {0, 1, 2}
    np.testing.assert_array_equal(States(out, spec).members(), expected)


def test_a_status_that_only_zarr_can_read_is_refused(stub_spec, tmp_path):
    out = tmp_path / "out"
    run_sweep(stub_spec(), out)
    path = out / "sweep.zarr" / "zarr.json"
    document = json.loads(path.read_bytes())
    codecs = document["consolidated_metadata"]["metadata"]["status"]["codecs"]
    codecs[1] = {"name": "gzip", "configuration": {"level": 1}}
    path.write_text(json.dumps(document))
    with pytest.raises(ValueError, match=r"out: .* the codecs bytes, gzip, crc32c; expected"):
        sweep_status(out)


def test_a_result_without_its_metadata_is_damaged(stub_spec, tmp_path):
    out = tmp_path / "out"
    run_sweep(stub_spec(), out)
    (out / "sweep.zarr" / "zarr.json").unlink()
    with pytest.raises(ValueError, match=r"damaged: .* no zarr.json; to mend it: jaxcell sweep"):
        sweep_status(out)
    assert verify_sweep(out).damaged == ("zarr.json",)
    assert sweep_status(out).complete
