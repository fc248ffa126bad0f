"""The synthetic sea that comes with jaxcell."""

from pathlib import Path

import numpy as np
from seas import water_and_flow

from jaxcell import drift
from jaxcell.base.certificate import Outcome


GYRES = Path(__file__).parents[2] / "data" / "ocean" / "gyres.nc"


def test_voyages_pass_an_eddy_that_almost_traps_drifters():
    currents = drift.open_currents(GYRES, time=1)
    layers = [water_and_flow(currents.isel(layer=[k])) for k in range(currents.sizes["layer"])]
    step = drift.DriftStep(float(np.mean([drift.crossing_time(*layer) for layer in layers])))
    maps = [drift.drift_map(*layer, step) for layer in layers]
    sea = drift.Sea.of([water for water, _ in layers], maps)
    for goal in (120, 400):
        voyage = drift.discounted_voyage(sea, goal)
        assert voyage.certificate.outcome is Outcome.CONVERGED
        assert (np.asarray(voyage.probability) == 1).all()
        assert (np.asarray(drift.surest_voyage(sea, goal).probability) == 1).all()
