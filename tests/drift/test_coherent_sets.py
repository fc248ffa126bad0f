"""Coherent sets of two currents whose vortices are known."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage
from scipy.integrate import solve_ivp

from jaxcell import drift


DAY = 86400.0
RADIUS, SPEED, WIDTH = 6.371e6, 62.66, 1.77e6
LENGTH, HALF = np.pi * RADIUS, 3e6


def bickley(time, x, y):
    """The Bickley jet of Rypina et al. (2007), with the waves of Hadjighasemi et al. (2016)."""
    away = (y - HALF) / WIDTH
    sech, tanh = 1 / np.cosh(away) ** 2, np.tanh(away)
    waves = zip((0.0075, 0.15, 0.3), (2, 4, 6), (0.1446, 0.205, 0.461), strict=True)
    along, across = np.ones_like(x), np.zeros_like(x)
    for height, number, speed in waves:
        phase = number / RADIUS * (x - speed * SPEED * time)
        along += 2 * tanh * height * np.cos(phase)
        across -= height * number / RADIUS * np.sin(phase)
    return SPEED * sech * along, SPEED * WIDTH * sech * across


def on_squares(velocity, width, height, rows, columns, times, wraps):
    """The cells of a rectangle, and a velocity at their centres."""
    dx, dy = width / columns, height / rows
    x, y = np.meshgrid((np.arange(columns) + 0.5) * dx, (np.arange(rows) + 0.5) * dy)
    whole = np.ones_like(x)
    number = np.arange(x.size, dtype=np.int32).reshape(x.shape)
    water = drift.Water(number, dx * whole, dy * whole, 0 * x, 0 * x, 0 * x, 0.0, wraps=wraps)
    rate = np.stack([np.stack(velocity(time, x, y)) / [[[dx]], [[dy]]] for time in times])
    return water, drift.Flow(jnp.asarray(rate), jnp.asarray(times), wraps), (dx, dy)


def kept(velocity, sets, water, sides, seconds, points=4000):
    """The share of points in each set that end in its place, in the velocity itself."""
    random, sides = np.random.default_rng(0), np.array(sides)[:, None]
    cell = random.integers(0, water.cells, points)
    begin = (np.stack([water.column[cell], water.row[cell]]) + random.random((2, points))) * sides

    def rate(time, places):
        return np.concatenate(velocity(time, *places.reshape(2, -1)))

    path = solve_ivp(rate, (0, seconds), begin.ravel(), rtol=1e-6, atol=1e-4 * sides.min())
    column, row = np.floor(path.y[:, -1].reshape(2, -1) / sides).astype(int)
    last, _ = water.at(row, column)
    number, end = sets.begin[cell], np.where(last < 0, -1, sets.end[last])
    return np.array([(end[number == k] == k).mean() for k in range(sets.count)])


def test_the_six_vortices_of_the_bickley_jet_are_found():
    days = 40
    times = np.arange(0, days * DAY + 1, DAY / 2)
    water, flow, sides = on_squares(bickley, LENGTH, 2 * HALF, 20, 60, times, True)
    sets = drift.coherent_sets(water, flow, 24 * days)
    # Water on one side of the jet, and three vortices on each side of it.
    assert sets.count == 7
    vortices = []
    for k in range(sets.count):
        column, row = water.column[sets.begin == k], water.row[sets.begin == k]
        around = np.exp(2j * np.pi * (column + 0.5) / 60).mean()
        if abs(around) > 0.8:
            vortices.append((k, float(np.angle(around)), float(row.mean() + 0.5)))
    number, angle, row = map(np.array, zip(*vortices, strict=True))
    assert number.size == 6
    assert (row < 9).sum() == (row > 11).sum() == 3
    for side in (row < 10, row > 10):
        gaps = np.diff(np.sort(angle[side]), append=np.sort(angle[side])[0] + 2 * np.pi)
        np.testing.assert_allclose(gaps, 2 * np.pi / 3, atol=0.4)
    for k in number:
        grid = water.on_grid(sets.begin == k, False)
        _, pieces = scipy.ndimage.label(np.hstack([grid, grid]))
        assert pieces <= 3
    assert sets.leakage[number].max() < 0.2
    share = kept(bickley, sets, water, sides, days * DAY)
    assert share[number].min() > 0.75
    np.testing.assert_allclose(share[number], 1 - sets.leakage[number], atol=0.08)


def test_the_double_gyre_has_the_two_coherent_sets_of_its_source():
    """Froyland and Padberg-Gehle (2014): A = 0.25, period 1, amplitude 0.25, times 0 to 10.

    The two sets are the left and the right gyre, whose border is not the line in the middle.
    """

    def gyre(time, x, y):
        part = 0.25 * np.sin(2 * np.pi * time)
        f, slope = part * x**2 + (1 - 2 * part) * x, 2 * part * x + 1 - 2 * part
        along = -np.pi * 0.25 * np.sin(np.pi * f) * np.cos(np.pi * y)
        return along, np.pi * 0.25 * np.cos(np.pi * f) * np.sin(np.pi * y) * slope

    times = np.linspace(0, 10, 201)
    water, flow, sides = on_squares(gyre, 2.0, 1.0, 20, 40, times, False)
    sets = drift.coherent_sets(water, flow, 10 / 3600, 2)
    assert sets.count == 2
    left = sets.begin[water.number[10, 10]]
    assert sets.begin[water.number[10, 30]] == 1 - left
    sizes = np.bincount(sets.begin[sets.begin >= 0])
    assert sizes.min() / sizes.max() > 0.8
    share = kept(gyre, sets, water, sides, 10.0)
    assert share.min() > 0.8
    np.testing.assert_allclose(share, 1 - sets.leakage, atol=0.05)


def test_the_number_of_sets_is_that_before_the_largest_gap():
    times = np.arange(0, 10 * DAY + 1, DAY / 2)
    water, flow, _ = on_squares(bickley, LENGTH, 2 * HALF, 12, 40, times, True)
    whole = drift.coherent_sets(water, flow, 240, 9).value
    expected = 2 + int(np.argmax(whole[1:-1] - whole[2:]))
    found = drift.coherent_sets(water, flow, 240, most=8)
    assert found.value.size == pytest.approx(expected)
