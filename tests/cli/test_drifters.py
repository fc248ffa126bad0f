"""Drifters that were observed, from a file of them."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jaxcell import bundled
from jaxcell.cli import main


DRIFTERS = Path(__file__).parents[2] / "data" / "ocean" / "drifters.nc"


@pytest.fixture(autouse=True)
def _own_cache(monkeypatch):
    monkeypatch.setattr("jaxcell.base.runtime.configure_jax", lambda: None)


def run(capsys, *args, file=DRIFTERS):
    """Exit status, the JSON object on standard output, and standard error."""
    status = main(["drifters", str(file), *map(str, args), "--json"])
    captured = capsys.readouterr()
    return status, json.loads(captured.out) if captured.out else None, captured.err


def test_the_two_gyres_are_found_in_trajectories(capsys, tmp_path):
    args = ("--nearly-closed", 2, "--samples", 10, "--after", 100, "--verify", "--out", tmp_path)
    status, found, error = run(capsys, *args)
    assert (status, error) == (0, "")
    assert found["verified"]["agrees"]
    assert (found["file"], found["lag_d"], found["cell_deg"]) == ("data/ocean/drifters.nc", 5, 1)
    assert (found["drifters"], found["cells"]) == (200, 288)
    west, east = found["nearly_closed_sets"]["sets"]
    assert west["size"] + east["size"] > 280
    assert abs(west["lon"] + 54) < 2
    assert abs(east["lon"] + 42) < 2
    leaks = {one["name"]: one for one in found["estimates"]}
    for rank, one in enumerate((west, east)):
        estimate = leaks[f"leakage of set {rank}"]
        assert estimate["value"] == pytest.approx(one["leakage"])
        assert 0 < estimate["error"] < 0.01
    with xr.open_dataset(tmp_path / "drifters.nc") as dataset:
        assert int(dataset["count"].sum()) == found["moves"]
        # They go to the middles.
        lon, lat = dataset.lon.values, dataset.lat.values
        middle = np.minimum(np.hypot(lon + 54, lat - 26), np.hypot(lon + 42, lat - 26)) < 4
        share = dataset.distribution[0].values
        assert np.nansum(share[middle]) > 1.3 * middle[~np.isnan(share)].mean()
        assert np.nanmax(dataset.distribution_error) < 0.05
        assert (dataset.layer_persistent_groups == dataset.persistent_groups).all()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--lag", 0), "--lag: expected more than 0 days, got 0"),
        (("--cell", 91), "--cell: expected more than 0 and at most 90 degrees, got 91"),
        (("--samples", 1), "--samples: expected 2 or more, got 1"),
        (("--least", 1000), "--least: no cell has 1000 moves in 432000 s; the most has 28"),
        (("--bounds", 0, 0, 1, 1), "--bounds: no drifter was within them"),
        (
            ("--after", -1),
            "--after: expected more than 0 and at most 50000 days, 10,000 times the lag, got -1",
        ),
    ],
)
def test_bad_input_is_one_line_and_status_2(capsys, args, message):
    status, found, error = run(capsys, *args)
    assert (status, found, error) == (2, None, f"jaxcell drifters: {message}\n")


def test_a_file_without_trajectories_is_named(capsys):
    gyres = bundled("gyres")
    status, found, error = run(capsys, file=gyres)
    assert (status, found) == (2, None)
    assert error.startswith(f"jaxcell drifters: {gyres}: lon: the drifters along")
