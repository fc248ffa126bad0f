"""Drift maps, against an oracle that maps cell by cell, and by hand."""

import dataclasses
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from oracles.drifter import SINK, Current, Drifter
from seas import double_gyre, sea, seas, water_and_flow

from jaxcell import examples
from jaxcell.base import memory
from jaxcell.drift import (
    METHODS,
    DriftStep,
    Flow,
    Water,
    crossing_time,
    drift_map,
    drift_maps,
    open_currents,
)
from jaxcell.mapping import Chain


GYRES = Path(__file__).parents[2] / "data" / "ocean" / "gyres.nc"
SPREADS, EDGES = ("turned", "all", "sampled"), ("uniform", "exit")


def check_rows(currents, current, cells, duration, **rules):
    """Rows of the map are those of the oracle."""
    chain = drift_map(Water.of(currents), Flow.of(currents).mean(), DriftStep(duration, **rules))
    assert chain.cells == len(current.squares)
    oracle = Drifter(current, duration, **rules)
    P, leaving = chain.to_scipy(), np.asarray(chain.leaving)
    for z in cells(chain.cells).tolist():
        expected = oracle.images(z)
        left = expected.pop(SINK, 0.0)
        row = np.zeros(chain.cells)
        row[list(expected)] = list(expected.values())
        np.testing.assert_allclose(P[[z]].toarray()[0], row, atol=1e-9)
        assert leaving[z] == pytest.approx(left, abs=1e-9)


@given(seas(), st.sampled_from(SPREADS), st.sampled_from(EDGES), st.data())
def test_the_map_of_a_random_sea_is_that_of_single_cells(currents, spread, edge, data):
    rho, samples = data.draw(st.sampled_from([0.0, 0.3, 0.8, 1.0])), data.draw(st.integers(1, 3))
    rules = {"rho": rho, "spread": spread, "edge": edge, "samples": samples}
    check_rows(currents, Current.of(currents), np.arange, 1.0, **rules)


def jet():
    """A sea around the Earth, with an island."""
    lon, lat = np.meshgrid(np.arange(0.0, 360, 10), np.arange(-15.0, 20, 10))
    east = np.random.default_rng(0).uniform(0.2, 1, lon.shape)
    wet = np.ones(lon.shape, bool)
    wet[1, 3] = False
    plane = sea(east, 0.2 * east, wet, dx=1.1e6, dy=1.1e6)
    return plane.assign_coords(lon=(("y", "x"), lon), lat=(("y", "x"), lat))


@pytest.mark.parametrize("edge", EDGES)
@pytest.mark.parametrize("spread", SPREADS)
@pytest.mark.parametrize("globe", [False, True])
def test_the_map_of_a_large_sea_is_that_of_single_cells(globe, spread, edge):
    if globe:
        currents, current = jet(), Current.of(jet(), wraps=True)
    else:
        currents, current = open_currents(GYRES).isel(layer=slice(2, 3)), Current.read(GYRES, 2)
    random = np.random.default_rng(0)
    rules = {"rho": 0.7, "spread": spread, "edge": edge}
    check_rows(
        currents,
        current,
        lambda count: random.choice(count, 60, replace=False),
        1.5e6 if globe else 3400.0,
        **rules,
    )


def tide():
    """Three records of eddies in a sea with islands, from which some drifters leave."""
    random = np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(12) / 3, np.arange(10) / 3)
    east, north = (
        np.array([0.6 * np.sin(x + a) * np.cos(y + b) for a, b in waves])
        for waves in random.uniform(0, 6, (2, 3, 2))
    )
    return sea(east + 0.2, north, random.random(x.shape) < 0.85)


def test_the_map_of_a_tide_is_that_of_a_solver():
    """Points in 25 places of each cell, for an hour and a half from the middle of an hour on."""
    currents, start, seconds = tide(), 1800.0, 5400.0
    current, step = Current.of(currents), dataclasses.replace(METHODS["drifters"], substeps=16)
    chain = drift_map(Water.of(currents), Flow.of(currents), step.lasting(seconds), start=start)
    P, leaving = chain.to_scipy().toarray(), np.asarray(chain.leaving)
    off = (np.arange(5) - 2) / 5
    row, column = np.array(current.squares).T[:, :, None, None]
    begin = np.broadcast_arrays(column + off, row + off[:, None])
    x, y, beyond = (
        one.reshape(chain.cells, 25)
        for one in current.solved(*(one.ravel() for one in begin), start, seconds)
    )
    # A point so near to an edge may be on either side of it.
    near = (np.abs(np.stack([x, y]) % 1 - 0.5) < 2e-3).any(axis=0) | (np.abs(beyond) < 0.02)
    sure, left = np.flatnonzero(~near.any(axis=1)), beyond > 0
    assert sure.size > 0.7 * chain.cells
    assert 0.1 < left[sure].mean() < 0.2
    for z in sure.tolist():
        expected = np.zeros(chain.cells)
        for k in np.flatnonzero(~left[z]):
            expected[current.landing(current.squares[z], x[z, k], y[z, k], False)] += 1 / 25
        np.testing.assert_allclose(P[z], expected, atol=1e-9)
        assert leaving[z] == pytest.approx(left[z].mean(), abs=1e-9)


def test_a_period_is_the_product_of_its_records():
    random = np.random.default_rng(3)
    east, north = random.normal(size=(2, 3, 6, 7))
    currents = sea(east, north, random.random((6, 7)) < 0.9, dx=1800.0, dy=1800.0)
    water, flow = Water.of(currents), Flow.of(currents)
    for edge in EDGES:
        step = DriftStep(3600.0, edge=edge)
        tide = drift_maps(water, flow.repeated(), step)
        product = np.eye(water.cells)
        for record in range(3):
            steady = Flow.of(currents, record=record)
            product = product @ drift_map(water, steady, step).to_scipy().toarray()
        for value in np.eye(water.cells)[::5]:
            np.testing.assert_allclose(tide.push(value, 3), value @ product, atol=1e-12)
            np.testing.assert_allclose(tide.pull(value, 3), product @ value, atol=1e-12)


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"rho": 1.1}, "rho: expected a probability from 0 to 1, got 1.1"),
        ({"rho": math.nan}, "rho: expected"),
        ({"spread": "some"}, "spread: expected 'turned', 'all' or 'sampled', got 'some'"),
        ({"samples": 0}, "samples: expected 1 or more, got 0"),
        ({"substeps": 0}, "substeps: expected 1 or more, got 0"),
        ({"edge": "wall"}, "edge: expected 'uniform' or 'exit', got 'wall'"),
        ({"method": "leap"}, "method: expected 'euler' or 'rk4', got 'leap'"),
        ({"duration": 0.0}, "duration: expected a number of seconds other than 0, got 0"),
        ({"duration": math.nan}, "duration: expected .*, got nan"),
    ],
)
def test_steps_out_of_range_are_refused(rules, message):
    with pytest.raises(ValueError, match=message):
        DriftStep(**rules)


def test_a_duration_that_does_not_fit_the_period_is_refused():
    east = np.ones((3, 4, 8))
    several = Flow.of(sea(east, east)).repeated()
    message = "multiple of the period, 10800 s, such as 3600 s, got 4000 s"
    with pytest.raises(ValueError, match=message):
        drift_maps(Water.of(double_gyre(4, 8)), several, DriftStep(4000))


def test_a_map_of_ten_million_cells_is_refused_with_the_memory_it_needs(monkeypatch):
    water, flow = examples.gyres()
    monkeypatch.setattr(memory, "free", lambda: 4_000_000_000)
    monkeypatch.setattr(Water, "cells", 10_000_000)
    needs = "drift map of 10,000,000 cells of water needs about 9.0 GB of memory, and 4.0 GB"
    with pytest.raises(MemoryError, match=needs):
        drift_map(water, flow, METHODS["drifters"])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("spread", SPREADS)
def test_maps_of_a_program_are_those_of_each_current(method, spread):
    water, flow = water_and_flow(double_gyre(6, 12))
    step = dataclasses.replace(METHODS[method], spread=spread, samples=2)

    def chain(scale, duration):
        moving = dataclasses.replace(flow, rate=scale * flow.rate)
        return drift_map(water, moving, step.lasting(duration))

    scales, durations = jnp.array([1.0, 0.4]), 2 * crossing_time(water, flow) * jnp.ones(2)
    found = jax.jit(jax.vmap(chain))(scales, durations)
    for k in range(2):
        one = Chain(found.image[k], found.probability[k]).to_scipy()
        expected = chain(float(scales[k]), float(durations[k])).to_scipy()
        np.testing.assert_allclose(one.toarray(), expected.toarray(), atol=1e-15)
