import itertools
import math

import numpy as np
import pytest

from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.walker import Walker, cell_strides
from jaxcell.space import CellSpace, Workspace


@pytest.mark.parametrize("directions", [1, 4, 8, 12, 16, 360])
@pytest.mark.parametrize("step", [1.0, 1.4, 2.0])
def test_strides_lead_to_centres_of_cells(directions, step):
    cells = CellSpace.of_grid(np.ones((9, 9), bool), directions, cell=0.5)
    for k, (ahead, left) in enumerate(cell_strides(directions, 0.5, step * 0.5)):
        x, y, theta = map(float, cells.centre(k * cells.positions + 40))
        end = cells.index(
            x + step * 0.5 * round(math.cos(theta), 9), y + step * 0.5 * round(math.sin(theta), 9)
        )
        centre = cells.centre(int(end))
        assert x + ahead * math.cos(theta) - left * math.sin(theta) == pytest.approx(centre[0])
        assert y + ahead * math.sin(theta) + left * math.cos(theta) == pytest.approx(centre[1])


def test_steps_without_a_heading_have_one_length():
    hall = Workspace([(-9, -9), (9, -9), (9, 9), (-9, 9)])
    body = Body(hall, (0.0, 0.0, math.radians(45)))
    walker = Walker(SimulatedCreate(body), 1.0)
    for _ in range(3):
        assert not walker.step()
    assert math.hypot(body.x, body.y) == pytest.approx(3, abs=0.01)
    assert walker.estimate == pytest.approx((3, 0, 0), abs=0.01)


def test_the_next_step_corrects_the_error_of_a_step():
    hall = Workspace([(-99, -99), (99, -99), (99, 99), (-99, 99)])
    body = Body(hall, (0.0, 0.0, 0.0))
    walker = Walker(SimulatedCreate(body), 1.0, tolerance=0.05, turn_tolerance=0.02)
    for _ in range(10):
        for _ in range(4):
            walker.step()
        walker.rotate(math.pi / 2)
    # Forty errors of up to 5 cm in one direction would add up to two metres.
    assert math.hypot(body.x - 4, body.y - 4) < 0.3
    assert walker.error < 0.2


def test_wrong_settings_of_a_walker_are_refused():
    wheels = SimulatedCreate(Body(Workspace([(0, 0), (9, 0), (9, 9)]), (5.0, 2.0, 0.0)))
    for field, value in itertools.product(["step", "tolerance"], [0.0, math.nan, -1.0]):
        with pytest.raises(ValueError, match=f"{field}: expected a positive number"):
            Walker(wheels, **{"step": 1.0, field: value})
    strides = cell_strides(8, 1.0, 1.0)
    with pytest.raises(ValueError, match="direction: expected 0 to 7, got 8"):
        Walker(wheels, 1.0, strides=strides, direction=8)
    with pytest.raises(ValueError, match="30 deg is not a whole number of the 8 directions"):
        Walker(wheels, 1.0, strides=strides).rotate(math.radians(30))
    Walker(wheels, 1.0, strides=strides).rotate(1.5708)
