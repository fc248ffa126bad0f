import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from helpers import run

from jaxcell import drift
from jaxcell.cli import main
from jaxcell.study import Drift


GYRES = Path(__file__).parents[2] / "data" / "ocean" / "gyres.nc"
# The number of seconds with three groups in every layer.
STEP = ("--duration", 3400, "--method", "source")

pytestmark = pytest.mark.usefixtures("few_drifters")


def eastward(dims, east, lon, lat, **coords):
    """Currents in which water flows to the East."""
    velocities = {"u": ("eastward", east), "v": ("northward", np.zeros_like(east))}
    return xr.Dataset(
        {
            name: (dims, values, {"standard_name": f"{toward}_sea_water_velocity"})
            for name, (toward, values) in velocities.items()
        },
        {
            "lon": ("lon", lon, {"units": "degrees_east"}),
            "lat": ("lat", lat, {"units": "degrees_north"}),
            **coords,
        },
    )


@pytest.fixture(scope="module")
def stream(tmp_path_factory):
    """A file in which the water goes to the East, a kilometre an hour."""
    east = np.full((1, 1, 4, 9), 1 / 3.6, np.float32)
    time = ("time", [np.datetime64("2020-05-01", "ns")])
    depth = ("depth", [0.0], {"units": "m", "positive": "down"})
    places = 0.009 * np.arange(9), 0.009 * np.arange(4)
    currents = eastward(("time", "depth", "lat", "lon"), east, *places, time=time, depth=depth)
    file = tmp_path_factory.mktemp("stream") / "stream.nc"
    currents.to_netcdf(file)
    return file


def test_velocities_and_grid_may_be_in_separate_files(stream, tmp_path):
    with xr.open_dataset(stream, decode_times=False) as whole:
        positions = whole[["lon", "lat"]]
        bare = whole.drop_vars(["lon", "lat"]).rename(u="east", v="north")
        for name in ("east", "north"):
            bare[[name]].to_netcdf(tmp_path / f"{name}.nc")
        positions.to_netcdf(tmp_path / "grid.nc")
    grid, names = tmp_path / "grid.nc", ("east", "north")
    apart = Drift(file=(tmp_path / "e*.nc", tmp_path / "north.nc"), grid=grid, variables=names)
    found, expected = apart.currents(), drift.open_currents(stream)
    xr.testing.assert_equal(found, expected)


def test_a_goal_upstream_has_no_answer(capsys, stream):
    args = "drift", stream, "--method source --edge exit --rho 1 --start 0.04,0.01"
    status, found, error = run(capsys, *args, "--goal", "0.01,0.01,0")
    assert status == 1
    assert found["surest"]["start_probability"] == 0
    assert found["surest"]["start_hours"] is None
    assert found["surest"]["start_hours_if_it_arrives"] is None
    assert error == "No policy brings a drifter from the start to the goal.\n"
    status, found, error = run(capsys, *args, "--goal", "0.07,0.01,0")
    assert (status, error) == (0, "")
    assert found["voyage"]["start_probability"] == 1
    # Four cells, a kilometre each, at a kilometre an hour.
    assert found["voyage"]["start_hours"] == pytest.approx(4, rel=0.01)
    assert found["layers"][0]["mean_leaving"] == 1
    assert found["layers"][0]["persistent_groups"] == 0
    assert [one["groups"] for one in found["sensitivity"]][1:] == [0, 0]


def test_a_step_that_is_too_short_causes_a_warning(capsys):
    args = ["--duration", "900", "--depths", "0", "--method", "source"]
    assert main(["drift", str(GYRES), *args]) == 0
    captured = capsys.readouterr()
    assert re.search("At 0 m: .* the grid, and not the water", captured.err)
    advice = '; take a longer duration or the spread "sampled".\n'
    assert advice in captured.err.replace(" \n", " ")
    # Enough for a terminal, and where the rest is.
    assert len(captured.out.splitlines()) <= 40
    assert "The rest is in the files of --out, and in --json." in captured.out


def test_a_current_around_the_earth_is_periodic(capsys, tmp_path):
    """A jet has no end, in the result, in its verification and in the recording."""
    lon, lat = np.arange(0.0, 360, 10), np.arange(-15.0, 20, 10)
    jet = eastward(("lat", "lon"), np.ones((lat.size, lon.size)), lon, lat)
    jet.to_netcdf(file := tmp_path / "jet.nc")
    args = "--method source --edge exit --rho 1 --duration 1.1e6 --verify --out"
    status, found, error = run(capsys, "drift", file, args, tmp_path / "out")
    assert (status, error) == (0, "")
    (layer,) = found["layers"]
    assert [group["cells"] for group in layer["groups"]] == [lon.size] * lat.size
    assert layer["mean_leaving"] == 0
    assert any("goes round the Earth" in note for note in found["notes"])
    # A land cell and disturbances, too.
    jet["u"][1, 3] = np.nan
    jet.to_netcdf(file)
    for spread in ("turned", "all", "sampled"):
        args = f"--edge exit --spread {spread} --verify"
        status, _, error = run(capsys, "drift", file, args)
        assert status == 0, error


def test_six_layers_fit_on_a_screen_with_the_main_numbers_first(
    capsys, monkeypatch, stream, tmp_path
):
    monkeypatch.setenv("COLUMNS", "80")
    with xr.open_dataset(stream) as one:
        depths = {"depth": ("depth", [0.0, 10, 25, 50, 75, 100], one.depth.attrs)}
        deep = xr.concat([one.load().drop_vars("depth")] * 6, "depth").assign_coords(depths)
    deep.transpose("time", "depth", "lat", "lon").to_netcdf(tmp_path / "deep.nc")
    # So short a step is warned of in every layer.
    assert main(["drift", str(tmp_path / "deep.nc"), "--duration", "300"]) == 0
    captured = capsys.readouterr()
    said = captured.out.splitlines() + captured.err.splitlines()
    assert len(said) <= 40
    assert "more of that kind, at other depths" in captured.err
    rows = [line.split("│")[1].strip() for line in said if line.startswith("│")]
    assert rows[:5] == [
        "time that the answer is about",
        "drifters that the map has in a wrong cell then",
        "persistent groups",
        "probability of leaving the map, mean",
        "probability of leaving off the edge of the grid, mean",
    ]
    # One row for each layer.
    assert rows[-6:] == [str(layer) for layer in range(6)]
