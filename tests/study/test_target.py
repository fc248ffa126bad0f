"""The target of a coverage is read from an image or from a variable of a NetCDF file."""

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from jaxcell.bounce.coverage import coverage_target
from jaxcell.examples import lab
from jaxcell.study.bounce.target import read_target


@pytest.fixture(scope="module")
def worth():
    """A random number for each square of the lab, from the lowest row on."""
    return np.random.default_rng(0).integers(1, 255, lab().free.shape, np.uint8)


@pytest.mark.parametrize("kind", ["grey", "color", "deep"])
def test_bright_parts_of_an_image_are_worth_more(tmp_path, worth, kind):
    grey = Image.fromarray(worth[::-1])
    deep = Image.fromarray(worth[::-1].astype(np.uint16) * 200)
    image = {"grey": grey, "color": grey.convert("RGB"), "deep": deep}[kind]
    image.save(file := tmp_path / "image.png")
    expected = coverage_target(lab(), worth[lab().free].astype(float))
    np.testing.assert_allclose(read_target(lab(), str(file)), expected, rtol=1e-6)


@pytest.fixture
def file(tmp_path, worth):
    rows, columns = worth.shape
    variables = {
        "on_grid": (("x", "y"), worth.T),
        "on_positions": ("position", worth[lab().free]),
        "on_time": ("time", [1.0]),
        "on_part": (("x", "z"), np.ones((columns, 2))),
    }
    at = {"x": 0.6 + np.arange(columns), "y": 0.5 + np.arange(rows)}
    whole = xr.Dataset(variables, at).sortby("y", ascending=False)
    whole.to_netcdf(path := tmp_path / "wanted.nc", engine="netcdf4")
    return path


@pytest.mark.parametrize("name", ["on_grid", "on_positions"])
def test_a_variable_is_read_over_coordinates_and_over_positions(file, worth, name):
    expected = coverage_target(lab(), worth[lab().free].astype(float))
    np.testing.assert_allclose(read_target(lab(), f"{file}:{name}"), expected)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (":on_time", "over position, or over coordinates x and y .* over time"),
        (":on_part", "over position, or over coordinates x and y .* over x, z"),
        (":nothing", "which holds on_grid, on_positions, on_time, on_part"),
        ("", "expected a variable of the file, FILE.nc:VARIABLE"),
    ],
)
def test_other_variables_are_refused(file, name, message):
    with pytest.raises(ValueError, match=f"^target .*wanted.nc{name}: .*{message}"):
        read_target(lab(), f"{file}{name}")


def test_coordinates_must_reach_over_the_map(tmp_path):
    grid = xr.Dataset({"worth": (("y", "x"), np.ones((2, 2)))}, {"x": [0.5, 1.5], "y": [0.5, 3.5]})
    grid.to_netcdf(file := tmp_path / "small.nc", engine="netcdf4")
    with pytest.raises(ValueError, match=r"reaches 6 m beyond its coordinates x, .* 0.5 to 1.5"):
        read_target(lab(), f"{file}:worth")


@pytest.mark.parametrize(
    ("content", "message"),
    [("dark", "it is 0 at all positions"), ("text", "expected an image that can be read")],
)
def test_other_images_are_refused(tmp_path, content, message):
    file = tmp_path / "image.png"
    file.write_text("no image")
    if content == "dark":
        Image.fromarray(np.zeros((4, 8), np.uint8)).save(file)
    with pytest.raises(ValueError, match=f"^target .*image.png: {message}"):
        read_target(lab(), str(file))
