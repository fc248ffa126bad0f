"""Files with a part of the levels, and depths with the sign that they are known by."""

import re

import numpy as np
import pytest
from drift import products
from drift.products import refused

from jaxcell.drift import open_currents


SEA = np.ones((3, 4), bool)
LEVELS, DEPTH, HC, THETA = 32, 40.0, 20.0, 5.0
# The velocity of each level tells which one it is.
SPEED = 0.01 * np.arange(1, LEVELS + 1)


def height(s, stretching, depth=DEPTH):
    """The height of a level over a flat surface, by the formula of CF."""
    return depth * (HC * s + depth * stretching) / (HC + depth)


HEIGHTS = height(*products.stretched(LEVELS, THETA))


def s_levels(part=slice(None), wet=SEA, **options):
    options = {"u": SPEED, "v": 0.0, "levels": LEVELS, "depth": DEPTH, "theta": THETA} | options
    return products.croco(wet, part=part, **options)


@pytest.mark.parametrize(
    ("part", "depths"),
    [
        (slice(None), (0, 0.01, 7.5, 39.99, 40)),
        (slice(-1, None), (0,)),
        (slice(-8, None), (0, 3, 4.1)),
        (slice(0, 8), (40, 38, 16.7)),
        (slice(4, 12), (20,)),
        (slice(None, None, 2), (1, 25)),
    ],
)
def test_depths_within_the_levels_are_interpolated(part, depths):
    currents = open_currents(s_levels(part), depths=depths)
    expected = np.interp(-np.sort(np.array(depths, float)), HEIGHTS[part], SPEED[part])
    np.testing.assert_allclose(currents.u[0, :, 1, 1], expected, atol=1e-12)


# Levels of the file, the chosen depth, the nearest level and its layer, and the end of the error.
BEYOND = {
    "the lowest is not the surface": (slice(0, 1), None, HEIGHTS[0], 0, "-0.984375 only"),
    "the second alone": (slice(28, 29), 0, HEIGHTS[28], 0, "-0.109375 only"),
    "the two lowest": (
        slice(0, 2), 0, HEIGHTS[1], HEIGHTS[1] - HEIGHTS[0], "2 levels from -0.984375 to -0.95312"),
    "the surface is not 10 m": (slice(-1, None), 10, HEIGHTS[-1], 0, "-0.015625 only"),
    "the upper eight are not 30 m": (
        slice(-8, None), 30, HEIGHTS[-8], HEIGHTS[-7] - HEIGHTS[-8], "8 levels from -0.23"),
}  # fmt: skip


@pytest.mark.parametrize("case", BEYOND)
def test_depths_beyond_the_levels_are_refused(case):
    part, depths, nearest, layer, has = BEYOND[case]
    depth = depths or 0
    message = (
        f"depths: {depth:g} m below the surface is {abs(nearest + depth):.3g} m away from the "
        "nearest level of the file at row 0, column 0; expected a layer "
        f"({layer:.3g} m there) at most; s_rho has {has}"
    )
    refused(s_levels(part), re.escape(message), depths=depths)


def test_cells_in_which_the_levels_reach_count_only():
    """The upper half reaches 20 m where the sea is deep, and elsewhere the bed is above that."""
    wet = SEA.copy()
    wet[0, 0] = False
    depth = np.where(np.arange(4) < 2, 15.0, 2000.0)
    currents = open_currents(s_levels(slice(16, None), wet, depth=depth), depths=20)
    np.testing.assert_array_equal(currents.water[0], (depth > 20) & wet)
    shelf = s_levels(slice(16, None), wet, depth=np.minimum(depth, 30))
    refused(shelf, r"depths: 20 m below .* at row 0, column 2", depths=20)


@pytest.mark.parametrize(("levels", "theta"), [(3, 0.1), (5, 10.0), (40, 10.0)])
def test_a_whole_file_reaches_from_the_surface_to_the_bed(levels, theta):
    """It does so for last layers of any thickness."""
    speed = 0.01 * np.arange(1, levels + 1)
    currents = open_currents(s_levels(levels=levels, theta=theta, u=speed), depths=(0, DEPTH))
    np.testing.assert_allclose(currents.u[0, :, 1, 1], speed[[-1, 0]], atol=1e-12)


@pytest.mark.parametrize(("level", "is_read"), [(0, False), (20, False), (31, True)])
def test_a_single_level_must_be_that_of_the_surface(level, is_read):
    whole = s_levels()
    alone = whole.assign_coords(s_rho=whole.sc_r).isel(s_rho=level)
    if is_read:
        np.testing.assert_allclose(open_currents(alone).u[0, 0, 1, 1], SPEED[level])
        return
    s = (level + 0.5 - LEVELS) / LEVELS
    message = f"s_rho: u has a single level, and it is not that of the surface: {s:g}"
    refused(alone, re.escape(message))


def fixed(depth, **attributes):
    """Currents on fixed depths: 0.5 m/s at the surface, less by 0.01 with each metre."""
    east = 0.5 - 0.01 * np.abs(depth)[:, None, None]
    currents = products.regular(values=(east, 0), depth=depth, time=products.hours(count=1))
    currents.depth.attrs.update(attributes)
    return currents


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("first", [0.0, 0.5])
@pytest.mark.parametrize("positive", ["down", "up", "Down", None])
def test_the_surface_is_nearest_to_0(sign, order, first, positive):
    depth = sign * np.array([first, 5.0, 10.0])[::order]
    attributes = {} if positive is None else {"positive": positive}
    file = fixed(depth, **attributes)
    currents = open_currents(file)
    np.testing.assert_array_equal(currents.depth, [first, 5, 10])
    np.testing.assert_allclose(currents.u[0, :, 1, 1], [0.5 - 0.01 * first, 0.45, 0.4])
    odd = positive is not None and (sign > 0) == (positive == "up")
    assert ("taken as below the surface" in currents.attrs["notes"]) == odd
    np.testing.assert_allclose(open_currents(file, depths=10).u, 0.4)


def test_depths_on_both_sides_of_0_need_a_direction():
    depth = np.array([0.5, -5.0, -10.0])
    up = open_currents(fixed(depth, positive="up"))
    np.testing.assert_array_equal(up.depth, [-0.5, 5, 10])
    refused(fixed(depth), r"depth: expected depths on one side of 0, got")


@pytest.mark.parametrize(("level", "depth"), [(0, 0.0), (2, 10.0)])
@pytest.mark.parametrize("written", [False, True])
def test_a_depth_may_be_a_scalar_coordinate(tmp_path, level, depth, written):
    file = fixed(np.array([0.0, -5, -10])).isel(depth=level)
    file = products.write(tmp_path, file) if written else file
    for depths in (None, depth):
        currents = open_currents(file, depths=depths)
        assert currents.depth.values.tolist() == [depth]
        np.testing.assert_allclose(currents.u, 0.5 - 0.01 * depth)
    refused(file, r"depths: uo has a single level, at .* by depth; no layer at 3 m", depths=3)
