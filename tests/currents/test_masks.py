"""Masks of water and land, by names, flags and standard names."""

import numpy as np
import pytest
from drift import products
from drift.products import refused
from hypothesis import given
from hypothesis.extra.numpy import arrays

from jaxcell.drift import open_currents


WET = products.island()
FLAGS = {"flag_values": np.array([0, 1], "i4"), "flag_meanings": "land water"}


@pytest.mark.parametrize("standard_name", ["land_binary_mask", "sea_binary_mask", None])
def test_in_a_file_of_croco_1_is_water(standard_name):
    mask = products.AGRIF | ({"standard_name": standard_name} if standard_name else {})
    currents = open_currents(products.croco(WET, mask=mask))
    np.testing.assert_array_equal(currents.water[0], WET)
    for name, speed, axis in (("u", 0.3, 1), ("v", -0.2, 0)):
        expected = products.to_centres(speed * products.open_faces(WET)[name], axis)
        expected = np.where(WET, expected, np.nan)
        np.testing.assert_allclose(currents[name][0, 0], expected, atol=1e-12)
    assert "mask_rho: 1 is water, by its name" in currents.attrs["notes"]


def regular(wet, values=None, name="m", **attributes):
    """Currents on longitude and latitude, missing on land, with a mask of some values."""
    lat, lon = (0.1 * np.arange(size) for size in wet.shape)
    u = np.where(wet, 0.1, np.nan)
    currents = products.regular(values=(u, u), lon=lon, lat=lat, time=products.hours(count=1))
    if values is not None:
        currents[name] = ("latitude", "longitude"), values, attributes
    return currents


# The values of land and of water, and the attributes that say which is which.
MASKS = {
    "by flags": (0, 1, FLAGS),
    "flags before the standard name": (0, 1, FLAGS | {"standard_name": "land_binary_mask"}),
    "flags the other way": (
        2, 1, {"flag_values": np.array([1, 2], "i4"), "flag_meanings": "sea land"}),
    "a third flag": (
        2, 0, {"flag_values": np.array([0, 1, 2], "i4"), "flag_meanings": "ocean, lake, land"}),
    "options": (1, 0, {"option_0": "water", "option_1": "land"}),
    "options without a dash": (0, 1, {"option0": "land", "option1": "water"}),
    "options in brackets": (0, 1, {"option(0)": "land", "option(1)": "water"}),
    "sea by standard name": (0, 1, {"standard_name": "sea_binary_mask"}),
    "land by standard name": (1, 0, {"standard_name": "land_binary_mask"}),
    "by name, as NEMO": (0, 1, {"name": "tmask"}),
    "by name before flags": (0, 1, {"name": "tmask", "option_0": "water", "option_1": "land"}),
}  # fmt: skip


@pytest.mark.parametrize("case", MASKS)
@pytest.mark.parametrize("lost", [False, True])
def test_masks_are_known_by_attributes(case, lost):
    """They are known even if land has a velocity, so that only the mask tells it."""
    on_land, on_water, attributes = MASKS[case]
    values = np.where(WET, float(on_water), on_land)
    dataset = regular(WET if lost else np.ones_like(WET), values=values, **attributes)
    currents = open_currents(dataset)
    np.testing.assert_array_equal(currents.water[0], WET)
    assert f"{attributes.get('name', 'm')}: " in currents.attrs["notes"]


@pytest.mark.parametrize(
    "attributes",
    [{}, {"flag_meanings": "good bad", "flag_values": np.array([0, 1], "i4")},
     {"flag_meanings": "land water"}, {"option_0": "land"}],
)  # fmt: skip
def test_variables_without_a_meaning_are_no_mask(attributes):
    dataset = regular(WET, values=np.where(WET, 0.0, 1.0), **attributes)
    np.testing.assert_array_equal(open_currents(dataset).water[0], WET)


def exchanged(wet):
    file = products.croco(wet)
    return file.assign(mask_rho=1 - file.mask_rho)


def test_a_mask_against_all_the_data_is_refused():
    land = (~WET).sum()
    # Every water cell has a water cell beside it, and so a current through that side.
    message = (
        rf"mask_rho: none of the {land} cells that are water by it has a current other than 0, but "
        rf"{WET.sum()} of the {WET.sum()} that are land have; are land and water exchanged\? "
        r"\(1 is water, by its name\)"
    )
    refused(exchanged(WET), message)
    dataset = regular(WET, values=1.0 * WET, standard_name="land_binary_mask")
    message = rf"m: none of the {land} .* {WET.sum()} of .*by the standard name land_bin"
    refused(dataset, message)


def test_masks_of_the_sides_against_all_the_data_are_refused():
    file = products.croco(WET)
    for name, is_open in products.open_faces(WET).items():
        file[f"mask_{name}"] = products.FACES[name], 1.0 * ~is_open
    refused(file, r"mask_rho, mask_u, mask_v: none of the .* exchanged\?")


def test_a_sea_at_rest_and_a_sea_with_some_current_are_read():
    still = open_currents(products.croco(WET, u=0.0, v=0.0))
    np.testing.assert_array_equal(still.water[0], WET)
    garbage = products.croco(WET)
    for name in ("u", "v"):
        values = garbage[name].values
        values[values == 0] = 0.7
        values[..., 3, :] = 0
    np.testing.assert_array_equal(open_currents(garbage).water[0], WET)


@given(arrays(bool, (4, 5)))
def test_right_masks_are_read_and_exchanged_masks_refused(wet):
    """Only for masks whose water and land have neighbours of their kind, and so a current."""
    if not (wet[:, 1:] & wet[:, :-1]).any() or wet.all():
        return
    np.testing.assert_array_equal(open_currents(products.croco(wet)).water[0], wet)
    refused(exchanged(wet), r"are land and water exchanged\?")
