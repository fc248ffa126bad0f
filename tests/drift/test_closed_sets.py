"""Parts of the sea that drifters hardly leave."""

import dataclasses

import numpy as np
import pytest
from seas import double_gyre, sea, water_and_flow

from jaxcell import drift, mapping


@pytest.fixture(scope="module")
def gyres():
    """Two gyres side by side, and their maps by steps of 1 to 4 cells."""
    water, flow = water_and_flow(double_gyre(12, 24))
    steps = [factor * drift.crossing_time(water, flow) for factor in (1, 2, 4)]
    method = drift.METHODS["drifters"]
    return water, {step: drift.drift_map(water, flow, method.lasting(step)) for step in steps}


def test_each_gyre_is_nearly_closed_for_all_steps(gyres):
    water, maps = gyres
    left, groups = water.column < 12, []
    for step, chain in maps.items():
        sets = drift.nearly_closed_sets(water, chain, step, 2)
        assert abs(sets.steps * step - 24 * 3600) <= step / 2
        assert np.mean(np.where(left, 0, 1) == sets.begin) > 0.95
        assert 0 < sets.leakage.max() < 0.05
        groups.append(mapping.persistent_groups(chain).count)
    # The groups, meanwhile, are those of the step.
    assert len(set(groups)) > 1


def test_whole_periods_make_a_window_and_small_pieces_are_left_out():
    wet = np.ones((1, 102), bool)
    wet[0, 100] = False
    water = drift.Water.of(sea(0.0 * wet, 0.0 * wet, wet))
    image = np.arange(101, dtype=np.int32)[None]
    still = mapping.Chain(image, np.ones((1, 101)))
    image = np.where(image < 100, image // 50 * 50 + (image + 1) % 50, image)
    turn = mapping.Chain(image, np.ones((1, 101)))
    tide = mapping.ChainSequence.of([still, turn, turn, turn, turn])
    closed = drift.nearly_closed_sets(water, tide, 3600.0, 2)
    assert closed.steps == 25
    assert closed.begin.tolist() == [0] * 50 + [1] * 50 + [-1]


def test_a_window_shorter_than_the_period_has_the_steps_of_its_hours():
    water = drift.Water.of(sea(np.zeros((2, 50)), np.zeros((2, 50))))
    image = np.arange(100, dtype=np.int32)[None]
    half = mapping.Chain(np.where(image < 50, (image + 1) % 50, image), np.ones((1, 100)))
    months = mapping.ChainSequence.of([half] * 30)
    for hours, steps in ((24.0, 1), (72.0, 3), (720.0, 30), (1500.0, 60)):
        closed = drift.nearly_closed_sets(water, months, 86400.0, 2, hours=hours)
        assert closed.steps == steps


def test_sets_that_lose_half_of_their_drifters_are_left_out():
    water = drift.Water.of(sea(np.zeros((1, 60)), np.zeros((1, 60))))
    part = np.arange(60) // 20
    same = (part[:, None] == part) / 20
    # Part 0 keeps its drifters; half of those of the others and more leave the map.
    stays = np.where(part == 0, 0.99, 0.45)
    chain = mapping.Chain.from_scipy(stays[:, None] * same)
    closed = drift.nearly_closed_sets(water, chain, 86400.0, 3)
    np.testing.assert_allclose(closed.leakage, [0.01])
    assert closed.begin.tolist() == [0] * 20 + [-1] * 40


def test_sets_are_numbered_from_layer_to_layer():
    waters = [drift.Water.of(sea(np.zeros((3, 8)), np.zeros((3, 8))))] * 2
    waters[1] = dataclasses.replace(waters[1], depth=5.0)
    # A step leads to any cell of the half, except with a small probability.
    half = np.arange(24) % 8 // 4
    same = (half[:, None] == half) / 12
    chains = [mapping.Chain.from_scipy((1 - e) * same + e * same[::-1]) for e in (0.001, 0.01)]
    closed = drift.ClosedSets.of(waters, chains, 12 * 3600.0, 2)
    assert closed.number[:, 0].tolist() == [[0] * 4 + [1] * 4, [2] * 4 + [3] * 4]
    assert closed.size.tolist() == [12] * 4
    assert closed.depth.tolist() == [0, 0, 5, 5]
    assert closed.window_hours == 24
    leaves = 1 - np.repeat([0.999**2 + 0.001**2, 0.99**2 + 0.01**2], 2)
    np.testing.assert_allclose(closed.leakage, leaves)
    lon, lat = waters[0].lon, waters[0].lat
    # A half mixes, so its drifters are in its middle.
    np.testing.assert_allclose(closed.lat, lat[1, 0])
    np.testing.assert_allclose(closed.lon, np.tile([lon[0, :4].mean(), lon[0, 4:].mean()], 2))
