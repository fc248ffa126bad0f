import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from drift import products
from helpers import run

from jaxcell.cli import main
from jaxcell.drift import open_currents
from jaxcell.study import Drift


GYRES = Path(__file__).parents[2] / "data" / "ocean" / "gyres.nc"

pytestmark = pytest.mark.usefixtures("few_drifters")


@pytest.fixture(scope="module")
def stream(tmp_path_factory):
    """A file in which the water goes to the East, a kilometre an hour."""
    time = products.hours(count=1, since="2020-05-01")
    places = {"lon": 0.009 * np.arange(9), "lat": 0.009 * np.arange(4), "depth": [0.0]}
    currents = products.regular(values=(1 / 3.6, 0), time=time, **places)
    file = tmp_path_factory.mktemp("stream") / "stream.nc"
    currents.to_netcdf(file)
    return file


def test_velocities_and_grid_may_be_in_separate_files(stream, tmp_path):
    with xr.open_dataset(stream, decode_times=False) as whole:
        positions = whole[["longitude", "latitude"]]
        bare = whole.drop_vars(["longitude", "latitude"]).rename(uo="east", vo="north")
        for name in ("east", "north"):
            bare[[name]].to_netcdf(tmp_path / f"{name}.nc")
        positions.to_netcdf(tmp_path / "grid.nc")
    grid, names = tmp_path / "grid.nc", ("east", "north")
    apart = Drift(file=(tmp_path / "e*.nc", tmp_path / "north.nc"), grid=grid, variables=names)
    currents, expected = apart.currents(), open_currents(stream)
    xr.testing.assert_equal(currents, expected)


def test_a_goal_upstream_has_no_answer(capsys, stream):
    args = "drift", stream, "--method source --edge exit --rho 1 --start 0.04,0.01"
    status, answer, error = run(capsys, *args, "--goal", "0.01,0.01,0")
    assert status == 1
    assert answer["surest"]["start_probability"] == 0
    assert answer["surest"]["start_hours"] is None
    assert answer["surest"]["start_hours_if_it_arrives"] is None
    assert error == "No policy brings a drifter from the start to the goal.\n"
    status, answer, error = run(capsys, *args, "--goal", "0.07,0.01,0")
    assert (status, error) == (0, "")
    assert answer["voyage"]["start_probability"] == 1
    # Four cells, a kilometre each, at a kilometre an hour.
    assert answer["voyage"]["start_hours"] == pytest.approx(4, rel=0.01)
    assert answer["layers"][0]["mean_leaving"] == 1
    assert answer["layers"][0]["persistent_groups"] == 0
    assert [one["groups"] for one in answer["sensitivity"]][1:] == [0, 0]


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


@pytest.mark.parametrize("spread", ["turned", "all", "sampled"])
def test_a_current_around_the_earth_is_verified(capsys, tmp_path, spread):
    """A jet has no end, and passes a land cell."""
    lon, lat = np.arange(0.0, 360, 10), np.arange(-15.0, 20, 10)
    east = np.ones((lat.size, lon.size))
    east[1, 3] = np.nan
    jet = products.regular(values=(east, 0 * east), lon=lon, lat=lat, time=products.hours(count=1))
    jet.to_netcdf(file := tmp_path / "jet.nc")
    status, answer, error = run(capsys, "drift", file, f"--edge exit --spread {spread} --verify")
    assert status == 0, error
    assert any("goes round the Earth" in note for note in answer["notes"])


def test_six_layers_fit_on_a_screen_with_the_main_numbers_first(
    capsys, monkeypatch, stream, tmp_path
):
    monkeypatch.setenv("COLUMNS", "80")
    with xr.open_dataset(stream) as one:
        depths = {"depth": ("depth", [0.0, 10, 25, 50, 75, 100], one.depth.attrs)}
        deep = xr.concat([one.load().drop_vars("depth")] * 6, "depth").assign_coords(depths)
    deep.transpose("time", "depth", ...).to_netcdf(tmp_path / "deep.nc")
    # So short a step is warned of in every layer.
    assert main(["drift", str(tmp_path / "deep.nc"), "--duration", "300"]) == 0
    captured = capsys.readouterr()
    said = captured.out.splitlines() + captured.err.splitlines()
    assert len(said) <= 40
    assert "more of that kind, at other depths" in captured.err
    rows = [line.split("│")[1].strip() for line in said if line.startswith("│")]
    assert rows[:5] == [
        "time that the answer is about",
        "in a wrong cell of the map then, released everywhere",
        "the same, released in one cell (start, or median of nine)",
        "rule at the coast",
        "cells of water",
    ]
    # One row for each layer.
    assert rows[-6:] == [str(layer) for layer in range(6)]


def test_a_dataset_is_a_sea():
    longitude, latitude = np.linspace(-80, -79, 10), np.linspace(25, 26, 10)
    axes, shape = ("time", "latitude", "longitude"), (1, 10, 10)
    velocities = {"uo": (axes, np.full(shape, 0.3)), "vo": (axes, np.full(shape, 0.1))}
    time = [np.datetime64("2020-01-01", "ns")]
    coords = {"time": time, "latitude": latitude, "longitude": longitude}
    question = Drift(file=xr.Dataset(velocities, coords=coords), duration=6 * 3600.0)
    result = question.run()
    assert result.cells == 100
    assert question.spec(result)["file"] == "a Dataset of the program"
