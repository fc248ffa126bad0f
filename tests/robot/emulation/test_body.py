import math

import numpy as np
import pytest

from jaxcell.robot.create.packets import METRES_PER_COUNT, WHEEL_BASE
from jaxcell.robot.emulation.body import Body, Noise
from jaxcell.space import Workspace


ROOM = Workspace([(0, 0), (4, 0), (4, 3), (0, 3)], robot_radius=0.17)
HALL = Workspace([(-50, -50), (50, -50), (50, 50), (-50, 50)])


def push(body: Body, seconds: float, left: float = 0.2, right: float = 0.2) -> None:
    for _ in range(round(seconds / 0.01)):
        body.advance(left, right, 0.01)


def test_the_wheels_determine_the_arc_of_the_body():
    body = Body(HALL, (1.0, 2.0, 0.3))
    push(body, 5.0, left=0.2, right=0.3)
    turn = 0.1 * 5 / WHEEL_BASE
    radius = 0.25 * 5 / turn
    assert body.theta == pytest.approx(0.3 + turn)
    assert body.x == pytest.approx(1 + radius * (math.sin(0.3 + turn) - math.sin(0.3)), abs=1e-4)
    assert body.y == pytest.approx(2 - radius * (math.cos(0.3 + turn) - math.cos(0.3)), abs=1e-4)
    assert body.travelled == pytest.approx([1.0, 1.5])


def test_encoders_count_and_wrap():
    body = Body(HALL, (0.0, 0.0, 0.0))
    push(body, 1.0, left=-0.1, right=0.1)
    count = 0.1 / METRES_PER_COUNT
    assert body.counts == (65536 - math.ceil(count), math.floor(count))


@pytest.mark.parametrize("give", [0.0, 0.02])
@pytest.mark.parametrize(
    ("degrees", "pressed"), [(0, (True, True)), (40, (False, True)), (-40, (True, False))]
)
def test_a_wall_stops_the_body_and_presses_the_bumper_on_its_side(give, degrees, pressed):
    # A robot that faces to the left of the normal of the wall has the wall to its right.
    body = Body(ROOM, (3.0, 1.5, math.radians(degrees)), give=give)
    push(body, 10.0)
    assert body.x == pytest.approx(4 - 0.17 + give, abs=1e-6)
    assert (body.bump_left, body.bump_right) == pressed
    went = (body.x - 3.0) / math.cos(math.radians(degrees))
    assert body.travelled == pytest.approx([went, went], abs=1e-6)
    push(body, 0.1, -0.2, -0.2)
    assert (body.bump_left, body.bump_right) == (False, False)


def test_a_body_that_backs_into_a_wall_has_no_bump():
    body = Body(ROOM, (1.0, 1.5, 0.0))
    push(body, 10.0, -0.2, -0.2)
    assert body.x == pytest.approx(0.17 - 0.02, abs=1e-6)
    assert (body.bump_left, body.bump_right) == (False, False)


def test_a_pressed_bumper_is_released_by_turning_away():
    body = Body(ROOM, (3.0, 1.5, 0.0))
    push(body, 10.0)
    quarter = math.pi / 4 * WHEEL_BASE / 2
    push(body, 1.0, -quarter, quarter)
    assert body.bump_right
    push(body, 1.0, -3 * quarter, 3 * quarter)
    assert (body.bump_left, body.bump_right) == (False, False)


def test_the_encoders_do_not_see_slip_which_is_drawn_for_each_stretch():
    noise = Noise(distance=0.1, rotation=0.1)
    body = Body(HALL, (0.0, 0.0, 0.0), noise=noise, rng=np.random.default_rng(1))
    steps, turns = [], []
    for _ in range(400):
        x, y, theta = body.pose
        push(body, 0.2)
        steps.append(math.hypot(body.x - x, body.y - y) / 0.04)
        push(body, 0.1, -0.1, 0.1)
        turns.append((body.theta - theta) / (0.02 / WHEEL_BASE))
    for errors in (steps, turns):
        assert np.mean(errors) == pytest.approx(1, abs=0.03)
        assert np.std(errors) == pytest.approx(0.1, rel=0.2)
    assert body.travelled == pytest.approx([400 * 0.03, 400 * 0.05])


def test_veer_grows_with_the_root_of_the_way():
    ends = []
    for seed in range(150):
        body = Body(HALL, (0.0, 0.0, 0.0), noise=Noise(veer=0.05), rng=np.random.default_rng(seed))
        for _ in range(40):
            body.advance(0.5, 0.5, 0.1)
        ends.append(body.theta)
    assert np.std(ends) == pytest.approx(0.05 * math.sqrt(2), rel=0.2)


def test_encoder_noise_is_not_motion():
    body = Body(HALL, (0.0, 0.0, 0.0), noise=Noise(encoder=0.3))
    push(body, 1.0)
    assert body.x == pytest.approx(0.2)
    assert body.travelled[0] != pytest.approx(0.2, abs=1e-5)
    assert body.travelled[0] != body.travelled[1]


def test_a_wrong_start_of_a_body_is_refused():
    with pytest.raises(ValueError, match=r"pose: a body of radius 0.17 m at \(0.1 m, 1 m\)"):
        Body(ROOM, (0.1, 1.0, 0.0))
    with pytest.raises(ValueError, match="veer: expected a finite number from 0, got -1"):
        Noise(veer=-1.0)
