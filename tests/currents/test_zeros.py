"""Land and sea bed that are stored as velocities of exactly 0."""

import json

import numpy as np
import pytest
from drift import products
from drift.products import write

from jaxcell.base.doubts import Doubt
from jaxcell.cli import main
from jaxcell.drift import open_currents


# Iceland is from 24 to 13.5 degrees West at this latitude; its interior is far from any coast.
LON, LAT = np.arange(-34.0, -15.9, 1.0), np.array([64.6, 64.8, 65.0, 65.2])
INLAND, AT_SEA = (LON >= -20) & (LON <= -17), LON == -30


def file(zero, *, depth=None, fill=0.0):
    """Two records of a current of 0.1 m/s or more, with `fill` in the squares of `zero`."""
    shape = (2, 4, LON.size) if depth is None else (2, len(depth), 4, LON.size)
    speed = 0.1 + np.random.default_rng(0).random((2, *shape))
    speed[:, :, zero] = fill
    time = products.hours(count=2)
    return products.regular("uo", "vo", speed, lon=LON, lat=LAT, depth=depth, time=time)


def squares(columns):
    return np.broadcast_to(columns, (4, LON.size))


def test_zeros_on_land_by_the_coastline_are_land(tmp_path):
    path = write(tmp_path, file(squares(INLAND)))
    with pytest.warns(Doubt, match=r"16 squares .* exactly 0 at all records; they are land by Nat"):
        currents = open_currents(path)
    np.testing.assert_array_equal(currents.water[0], squares(~INLAND))
    np.testing.assert_array_equal(currents.land[0], squares(INLAND))
    assert "16 squares have a velocity of exactly 0" in currents.attrs["notes"]


def test_zeros_at_sea_are_water_and_a_doubt(tmp_path):
    path = write(tmp_path, file(squares(INLAND | AT_SEA)))
    with pytest.warns(Doubt, match="4 squares .* are water by Natural Earth"):
        currents = open_currents(path)
    np.testing.assert_array_equal(currents.water[0], squares(~INLAND))


def test_a_square_that_moves_once_is_water(tmp_path):
    dataset = file(squares(INLAND))
    dataset["uo"][1, 0, 15] = 0.25
    with pytest.warns(Doubt, match="15 squares have a velocity"):
        currents = open_currents(write(tmp_path, dataset))
    assert currents.water.values[0, 0, 15]


def test_the_mask_of_a_file_is_believed(tmp_path):
    dataset = file(squares(INLAND))
    flags = {"flag_values": np.array([0.0, 1.0]), "flag_meanings": "land sea"}
    dataset["kind"] = ("latitude", "longitude"), np.ones((4, LON.size)), flags
    with pytest.warns(Doubt, match="16 squares .* are water by kind, and count as water"):
        currents = open_currents(write(tmp_path, dataset))
    assert currents.water.values.all()


def test_zeros_below_moving_water_are_sea_bed_if_nothing_is_missing(tmp_path):
    zero = np.zeros((3, 4, LON.size), bool)
    zero[1:, :, AT_SEA] = zero[2, :, LON == -29] = True
    dataset = file(zero, depth=[0.0, 10.0, 20.0])
    with pytest.warns(Doubt, match="12 squares .* lie below others that move, and count as sea b"):
        currents = open_currents(write(tmp_path, dataset))
    np.testing.assert_array_equal(currents.water, ~zero)
    dataset["uo"][:, 0, 0, 0] = np.nan
    with pytest.warns(Doubt, match="12 squares .* are water by"):
        currents = open_currents(write(tmp_path, dataset))
    assert currents.water.values[:, 1].all()


def test_the_command_says_it_above_the_answer(tmp_path, capsys):
    path = write(tmp_path, file(squares(INLAND | AT_SEA)))
    assert main(["drift", str(path), "--until", "1", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["cells"] == 4 * (LON.size - INLAND.sum())
    assert "sea.nc: 16 squares have a velocity of exactly 0 at all records; they are land" in err
    assert "sea.nc: 4 squares have a velocity of exactly 0 at all records; they are water" in err
