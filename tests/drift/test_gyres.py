"""The synthetic sea that comes with jaxcell."""

from pathlib import Path

import numpy as np
from seas import water_and_flow

from jaxcell import drift
from jaxcell.base.certificate import Outcome


GYRES = Path(__file__).parents[2] / "data" / "ocean" / "gyres.nc"


def test_each_eddy_of_the_surface_gathers_drifters():
    water, flow = water_and_flow(drift.open_currents(GYRES, time=1))
    step = drift.crossing_time(water, flow)
    behaviour = drift.long_term_behaviour(drift.drift_map(water, flow, drift.DriftStep(step)), step)
    # One in the western basin and two in the eastern one, and water that leads to any of them.
    assert behaviour.groups.size.tolist() == [17, 26, 61]
    assert behaviour.transient.domiciles == ((0,), (1,), (2,), (0, 1, 2))
    assert drift.diagnose(water, flow, behaviour.groups, drift.DriftStep(step)).warning is None
    chosen = drift.deployment_cells(behaviour)
    assert drift.reachable(behaviour.chain, chosen.cells).all()
    # As in the source, it takes longest where it is open in which group a drifter ends.
    hours = np.asarray(behaviour.hours)
    mean = [hours[behaviour.transient.group == part].mean() for part in range(4)]
    assert np.argmax(mean) == 3


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
