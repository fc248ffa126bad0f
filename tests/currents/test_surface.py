"""Wind and waves at the surface, beside the current."""

import numpy as np
import pytest
from drift import products

from jaxcell import drift


STOKES = "sea_surface_wave_stokes_drift_{}ward_velocity"


@pytest.fixture
def dataset():
    """Two records and two depths, with land in one square, wind and Stokes drift."""
    random = np.random.default_rng(1)
    surface = "time", "latitude", "longitude"
    currents, winds = random.uniform(-1, 1, (2, 2, 2, 3, 4)), random.uniform(-20, 20, (2, 2, 3, 4))
    currents[..., 0, 0] = winds[..., 0, 0] = np.nan
    place = {"lon": 5 + 0.1 * np.arange(4), "lat": 40 + 0.1 * np.arange(3), "depth": [0.0, 10.0]}
    found = products.regular(values=currents, time=products.hours(count=2), **place)
    for name, wind in zip(("uwnd", "vwnd"), winds, strict=True):
        found[name] = surface, wind, {"units": "m s-1"}
    for name, way in (("a", "east"), ("b", "north")):
        about = {"standard_name": STOKES.format(way), "units": "cm/s"}
        found[name] = surface, random.uniform(-30, 30, (2, 3, 4)), about
    return found


@pytest.mark.parametrize("mean", [False, True])
def test_wind_and_waves_are_added_at_the_surface(dataset, mean):
    alone = drift.open_currents(dataset, mean=mean)
    pushed = drift.open_currents(dataset, mean=mean, windage=0.03, stokes=True)
    for name, wind, waves in (("u", "uwnd", "a"), ("v", "vwnd", "b")):
        push = 0.03 * dataset[wind].values + 0.01 * dataset[waves].values
        push = push.mean(axis=0, keepdims=True) if mean else push
        added = (pushed[name] - alone[name]).values
        np.testing.assert_allclose(added[:, 0], push, atol=1e-12)
        np.testing.assert_allclose(added[:, 1][np.isfinite(added[:, 1])], 0, atol=0)
    assert "uwnd, vwnd: 0.03 of it is added" in pushed.attrs["notes"]
    assert "uwnd" not in alone.attrs["notes"]


def test_missing_and_invalid_winds_are_refused(dataset):
    with pytest.raises(ValueError, match="windage: expected a share from 0 to 1, got 3"):
        drift.open_currents(dataset, windage=3)
    dataset["uwnd"][1, 2, 1] = np.nan
    with pytest.raises(ValueError, match=r"uwnd: expected a wind .* got nan at record 1, row 2"):
        drift.open_currents(dataset, windage=0.03)
    none = dataset.drop_vars(["uwnd", "a"])
    with pytest.raises(ValueError, match="wind: the file has no wind for windage; expected"):
        drift.open_currents(none, windage=0.03)
    with pytest.raises(ValueError, match="stokes: the file has no Stokes drift"):
        drift.open_currents(none, stokes=True)
