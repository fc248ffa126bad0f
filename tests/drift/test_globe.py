"""Grids that go round the Earth: the last column is beside the first.

The oracles are the same field begun at another meridian, and many copies of it side by side, read
as a regional grid, which has no seam where it matters.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from seas import sea

from jaxcell import drift
from jaxcell.mapping import persistent_groups


ROWS, COLUMNS = 5, 9
COPIES = 5


def globe(seed=0, layers=1, dry=4, speed=2.0, columns=COLUMNS):
    """A random current around the Earth with some land, in steps of a few cells."""
    draw = np.random.default_rng(seed)
    wet = np.ones((layers, ROWS, columns), bool)
    wet.reshape(layers, -1)[:, draw.permutation(ROWS * columns)[:dry]] = False
    east, north = draw.uniform(-speed, speed, (2, 1, layers, ROWS, columns))
    currents = sea(east, north, wet, dx=1.0, dy=0.83)
    column, row = np.meshgrid(np.arange(columns), np.arange(ROWS))
    currents["lon"] = (("y", "x"), (column * 360.0 / columns + 10 + 180) % 360 - 180)
    currents["lat"] = (("y", "x"), 3.0 * row - 6)
    return currents


def begun_at(currents, shift):
    return currents.roll(x=shift, roll_coords=True)


def copies(currents):
    """The field several times side by side, as if each copy were elsewhere."""
    wide = xr.concat([currents] * COPIES, dim="x", data_vars="minimal", coords="minimal")
    return wide.assign_coords(
        lon=(("y", "x"), np.broadcast_to(0.5 * np.arange(wide.sizes["x"]), (ROWS, wide.sizes["x"])))
    )


def moved(water, other, shift):
    """The number in the other water of each cell of the water, by as many columns to the East."""
    return other.number[water.row, (water.column + shift) % water.number.shape[1]]


def chains(currents, **options):
    water, flow = drift.Water.of(currents), drift.Flow.of(currents)
    return water, flow, drift.drift_map(water, flow, drift.DriftStep(1.0, **options))


OPTIONS = [
    {"spread": spread, "edge": edge}
    for spread in ("turned", "all", "sampled")
    for edge in ("uniform", "exit")
]


@pytest.mark.parametrize("options", OPTIONS, ids=lambda one: "-".join(one.values()))
def test_a_chain_does_not_depend_on_the_first_meridian(options):
    here, there = globe(), begun_at(globe(), 4)
    water, flow, chain = chains(here, samples=2, **options)
    other, turned_flow, turned = chains(there, samples=2, **options)
    assert water.wraps
    to = moved(water, other, 4)
    expected, found = chain.to_scipy().toarray(), turned.to_scipy().toarray()
    np.testing.assert_allclose(found[np.ix_(to, to)], expected, atol=1e-12)
    np.testing.assert_allclose(np.asarray(turned.leaving)[to], chain.leaving, atol=1e-12)
    check, again = (
        dataclasses.asdict(drift.diagnose(*place, persistent_groups(one), drift.DriftStep(1.0)))
        for *place, one in ((water, flow, chain), (other, turned_flow, turned))
    )
    np.testing.assert_array_equal(np.sort(check.pop("pieces")), np.sort(again.pop("pieces")))
    assert check == pytest.approx(again)


def test_pieces_meet_across_the_seam():
    wet = np.zeros((ROWS, COLUMNS), bool)
    wet[1, [0, -1]] = True  # side by side
    wet[3, 4] = wet[4, -1] = True  # alone, and at no corner of another
    currents = sea(np.ones((ROWS, COLUMNS)), np.zeros((ROWS, COLUMNS)), wet)
    round_it = currents.assign_coords(lon=globe().lon, lat=globe().lat)
    assert drift.Water.of(currents).piece.tolist() == [0, 1, 2, 3]
    water = drift.Water.of(round_it)
    assert water.piece.tolist() == [0, 0, 1, 2]
    assert water.neighbor[:, 0].tolist() == [-1, -1, -1, 1, -1, -1, -1, -1]
    wet[2, 0] = wet[3, -1] = True  # from corner to corner
    water = drift.Water.of(round_it.assign(water=(("layer", "y", "x"), wet[None])))
    assert water.piece.tolist() == [0, 0, 0, 1, 0, 0]


def test_the_nearest_water_may_be_across_the_seam():
    wet = np.zeros((ROWS, COLUMNS), bool)
    wet[1], wet[1, 0] = True, False
    currents = sea(np.zeros((ROWS, COLUMNS)), np.zeros((ROWS, COLUMNS)), wet)
    water = drift.Water.of(currents.assign_coords(lon=globe().lon, lat=globe().lat))
    x = np.array([[0.2, -0.2, COLUMNS + 0.2, 2 * COLUMNS - 0.2, COLUMNS / 1.0 - 1.1]])
    landed = water.landing(x, np.full(x.shape, 1.0), origin=np.full(5, 3))
    assert water.column[landed[0]].tolist() == [1, COLUMNS - 1, 1, COLUMNS - 1, COLUMNS - 1]


def test_simulated_drifters_do_not_depend_on_the_first_meridian():
    here = globe(2)
    water, flow = drift.Water.of(here), drift.Flow.of(here)
    turned = begun_at(here, 4)
    other, turned_flow = drift.Water.of(turned), drift.Flow.of(turned)
    # In one row, so that the same drifters are released.
    cells = water.number[2, :3]
    cells = np.sort(cells[cells >= 0])
    to = moved(water, other, 4)
    key = jax.random.key(3)
    drifters = drift.simulate_drifters(key, water, flow, cells, 1.0, 6, drifters=40, rho=0.6)
    again = drift.simulate_drifters(
        key, other, turned_flow, to[cells], 1.0, 6, drifters=40, rho=0.6
    )
    x, y = np.asarray(drifters.x), np.asarray(drifters.y)
    assert x.min() < -0.5  # some go across the seam
    np.testing.assert_allclose(np.asarray(again.x), x + 4, atol=1e-9)
    np.testing.assert_allclose(again.y, y, atol=1e-9)
    np.testing.assert_array_equal(again.cell, np.where(drifters.cell >= 0, to[drifters.cell], -1))


def test_a_jet_goes_round_the_earth():
    currents = globe(dry=0)
    jet = currents.assign(u=xr.ones_like(currents.u), v=xr.zeros_like(currents.v))
    water, flow, chain = chains(jet, rho=1.0, edge="exit")
    groups = persistent_groups(chain)
    assert np.asarray(groups.group).reshape(ROWS, COLUMNS).tolist() == [
        [row] * COLUMNS for row in range(ROWS)
    ]
    drifted = drift.simulate_drifters(
        jax.random.key(0), water, flow, int(water.number[2, 0]), 1.0, 2 * COLUMNS, drifters=3
    )
    np.testing.assert_allclose(drifted.x[-1] - drifted.x[0], 2 * COLUMNS, atol=1e-9)
    assert (drifted.cell[COLUMNS] == drifted.cell[0]).all()
    assert (drifted.cell[1] == water.number[2, 1]).all()
    comparison = drift.compare(water, chain, drifted, [k / 3600 for k in range(2 * COLUMNS)])
    np.testing.assert_allclose(comparison.total_variation, 0, atol=1e-12)
    np.testing.assert_allclose(comparison.transport, 0, atol=1e-12)


def test_distances_go_the_shorter_way_round():
    water = drift.Water.of(globe(dry=0))
    x = jnp.array([[0.0, 0.0], [COLUMNS - 1.0, COLUMNS - 1.0]])
    cell = np.array([[18, 18], [18 + COLUMNS - 1] * 2], np.int32)
    drifted = drift.Drifters(x, 0 * x + 2, cell, 3600.0)
    whole = np.arange(water.cells, dtype=np.int32)[None]
    stays = drift.drift_map(
        water,
        drift.Flow(jnp.zeros((1, 2, ROWS, COLUMNS)), jnp.zeros(1), True),
        drift.DriftStep(1.0, edge="exit"),
    )
    assert (np.asarray(stays.image) == whole).all()
    assert drift.compare(water, stays, drifted, [0, 1]).transport.tolist() == [0, 1]
    apart = persistent_groups(stays)
    sees = drift.visible_deployment(water, 1.6, apart)
    # A camera sees its row from the column before to that after: three cameras for nine columns.
    assert len(sees.cover) == 3 * ROWS


def test_lyapunov_exponents_and_ridges_are_those_of_many_copies():
    here = globe(4, dry=0, speed=0.8)
    water, flow = drift.Water.of(here), drift.Flow.of(here)
    wide = copies(here)
    plain, beyond = drift.Water.of(wide), drift.Flow.of(wide)
    middle = plain.number[water.row, water.column + COPIES // 2 * COLUMNS]
    exponents = drift.ftle(water, flow, 1.0, steps=4)
    expected = drift.ftle(plain, beyond, 1.0, steps=4)
    np.testing.assert_allclose(exponents, expected[middle], atol=1e-9)
    crest = drift.ridges(water, exponents, share=1)
    all_copies = exponents[water.number[plain.row, plain.column % COLUMNS]]
    np.testing.assert_array_equal(crest, drift.ridges(plain, all_copies, share=1)[middle])
    assert crest.reshape(ROWS, COLUMNS)[:, [0, -1]].any()
    label = np.where(water.column < 4, 0, 1)
    ridge = water.column == COLUMNS - 1
    # Borders are columns 3, 4, 8 and 0; the ridge is 8, and 0 and 7 are beside it.
    assert drift.agreement(water, label, ridge, within=0).near == 1 / 4
    assert drift.agreement(water, label, ridge).near == 2 / 4


def test_a_flow_that_does_not_wrap_is_refused():
    here = globe()
    plain = drift.Flow.of(copies(here).isel(x=slice(COLUMNS)))
    with pytest.raises(ValueError, match="flow: wraps: expected True as for this water, got False"):
        drift.drift_map(drift.Water.of(here), plain, drift.DriftStep(1.0))
