import math

import numpy as np
import pytest
from wheels import bounce_filter, bounce_tables, map_cells

from jaxcell.robot.body import Body, Noise
from jaxcell.robot.create import Create
from jaxcell.robot.direct import DirectRobot
from jaxcell.robot.driver import RobotStopped
from jaxcell.robot.emulator import Emulator, Line
from jaxcell.robot.runner import run_filter
from jaxcell.robot.walker import Walker, cell_strides
from jaxcell.space import Workspace


LAB = map_cells("lab_a.json")
ROOM = Workspace([(0, 0), (4, 0), (4, 3), (0, 3)])
STRIDES = cell_strides(8, 1.0, 1.0)


def pose_of(cell: int) -> tuple[float, float, float]:
    x, y, theta = LAB.centre(cell)
    return float(x), float(y), float(theta)


@pytest.mark.slow
def test_it_agrees_with_the_robot_on_the_line():
    cell, bounce = 70, math.radians(45)
    filter = bounce_filter(LAB, 45)
    body = Body(LAB.workspace, pose_of(cell))
    walker = Walker(DirectRobot(body), 1.0, strides=STRIDES, direction=cell // LAB.positions)
    outcome = run_filter(walker, filter, bounce)
    with Emulator(Body(LAB.workspace, pose_of(cell)), line=Line(speedup=20.0)) as robot:
        with Create.open(robot.port, patience=5.0) as create:
            create.arm()
            walker = Walker(create, 1.0, strides=STRIDES, direction=cell // LAB.positions)
            assert run_filter(walker, filter, bounce) == outcome
        x, y, theta = robot.pose
    # Turns may miss by 0.4 degrees, and the encoders round: the way sums that up to centimetres.
    assert body.pose[:2] == pytest.approx((x, y), abs=0.1)
    assert math.remainder(body.theta - theta, 2 * math.pi) == pytest.approx(0, abs=0.05)
    assert LAB.index(*body.pose) == LAB.index(x, y, theta)


def test_it_follows_the_bounce_map():
    image, bumped = bounce_tables(LAB, 135)
    for cell in np.random.default_rng(1).choice(LAB.size, 12, replace=False).tolist():
        body = Body(LAB.workspace, pose_of(cell))
        walker = Walker(DirectRobot(body), 1.0, strides=STRIDES, direction=cell // LAB.positions)
        for _ in range(8):
            assert walker.step() == bumped[cell]
            if bumped[cell]:
                walker.rotate(math.radians(135))
            cell = int(image[cell])
            assert int(LAB.index(*body.pose)) == cell


def test_it_goes_as_far_as_it_is_told():
    body = Body(ROOM, (1.0, 1.5, 0.0))
    robot = DirectRobot(body)
    assert robot.forward(0.537, tolerance=1e-9) == pytest.approx((0.537, 0.0, False))
    assert robot.turn(-1.2, tolerance=1e-9) == pytest.approx((0.0, -1.2, False))
    assert robot.turn(1.2, tolerance=1e-9) == pytest.approx((0.0, 1.2, False))
    assert robot.forward(-0.3, tolerance=1e-9) == pytest.approx((-0.3, 0.0, False))
    assert body.pose == pytest.approx((1.237, 1.5, 0.0))
    distance, _, bumped = robot.forward(5.0, tolerance=0.001)
    # The bumper gives way by 2 cm.
    assert bumped
    assert distance == pytest.approx(4.02 - 1.237)
    # It is still pressed.
    assert robot.forward(0.1, tolerance=0.001) == (0.0, 0.0, True)
    with pytest.raises(RobotStopped, match="are left, and it stands"):
        robot.forward(-5.0, tolerance=0.001)


def test_each_motion_slips_in_its_own_way():
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(100):
        body = Body(ROOM, (1.0, 1.5, 0.0), noise=Noise(distance=0.05), rng=rng)
        robot = DirectRobot(body)
        robot.forward(0.5, tolerance=1e-9)
        x = body.x
        robot.forward(0.5, tolerance=1e-9)
        ratios.append(((x - 1) / 0.5 - 1, (body.x - x) / 0.5 - 1))
    first, second = np.array(ratios).T
    assert first.std() == pytest.approx(0.05, rel=0.2)
    assert second.std() == pytest.approx(0.05, rel=0.2)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.3
