"""The drift map, cell by cell."""

from pathlib import Path

import numpy as np
import pytest
from oracles.drifter import SINK, Drifter
from seas import sea

from jaxcell import drift


GYRES = Path(__file__).parents[2] / "data" / "ocean" / "gyres.nc"


def jet():
    """A sea around the Earth, with an island."""
    lon, lat = np.meshgrid(np.arange(0.0, 360, 10), np.arange(-15.0, 20, 10))
    east = np.random.default_rng(0).uniform(0.2, 1, lon.shape)
    wet = np.ones(lon.shape, bool)
    wet[1, 3] = False
    found = sea(east, 0.2 * east, wet, dx=1.1e6, dy=1.1e6)
    return found.assign_coords(lon=(("y", "x"), lon), lat=(("y", "x"), lat))


@pytest.mark.parametrize("edge", ["uniform", "exit"])
@pytest.mark.parametrize("spread", ["turned", "all", "sampled"])
@pytest.mark.parametrize("globe", [False, True])
def test_the_map_is_that_of_single_cells(globe, spread, edge):
    currents = jet() if globe else drift.open_currents(GYRES).isel(layer=slice(2, 3))
    water, flow = drift.Water.of(currents), drift.Flow.of(currents).mean()
    assert water.wraps == globe
    duration = 1.5e6 if globe else 3400.0
    options = {"rho": 0.7, "spread": spread, "edge": edge}
    P = drift.drift_map(water, flow, drift.DriftStep(duration, **options)).to_scipy()
    one = Drifter(currents, water, 0, duration, **options)
    for z in np.random.default_rng(0).choice(water.cells, 60, replace=False).tolist():
        expected = one.images(z)
        left = expected.pop(SINK, 0.0)
        row = np.zeros(water.cells)
        row[list(expected)] = list(expected.values())
        np.testing.assert_allclose(P[[z]].toarray()[0], row, atol=1e-9)
        assert P[[z]].sum() == pytest.approx(1 - left, abs=1e-9)
