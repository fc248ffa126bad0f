import inspect

import pytest
from hypothesis import given, strategies as st

from jaxcell.robot.create.clock import ByClock
from jaxcell.robot.create.open_interface import CommandParser, drive_direct
from jaxcell.robot.create.packets import WHEEL_BASE
from jaxcell.robot.create.speeds import wheel_speeds


SPEEDS = st.integers(-500, 500)
OPCODES = {7, *range(128, 174)}


def sent(right: int, left: int) -> tuple[int, int]:
    return wheel_speeds(right=right / 1000, left=left / 1000)


@given(right=SPEEDS, left=SPEEDS, lost=st.integers(0, 4))
def test_a_lost_byte_makes_no_other_command_of_a_pair(right, left, lost):
    right, left = sent(right, left)
    command = drive_direct(right=right, left=left)
    damaged = CommandParser().feed(command[:lost] + command[lost + 1 :])
    assert [one.opcode for one in damaged if one.opcode != 145] == []


@pytest.mark.parametrize(("side", "lost"), [(1, 46), (-1, 92)], ids=["straight", "turn"])
def test_a_motion_keeps_its_kind_at_every_speed(side, lost):
    for speed in range(-500, 501):
        right, left = sent(speed, side * speed)
        assert right == side * left
        assert right * speed >= 0
        assert abs(right) <= abs(speed) <= abs(right) + lost
        # Nothing gives way without need.
        if not OPCODES & set(drive_direct(right=speed, left=side * speed)[1:]):
            assert right == speed


@given(right=SPEEDS, left=SPEEDS)
def test_a_pair_that_gives_way_is_slower_on_the_same_arc(right, left):
    found = sent(right, left)
    assert not OPCODES & set(drive_direct(right=found[0], left=found[1])[1:])
    wanted = (right, left)
    fast = max((0, 1), key=lambda wheel: abs(wanted[wheel]))
    slow = 1 - fast
    assert abs(found[fast]) <= abs(wanted[fast])
    assert found[fast] * wanted[fast] >= 0
    # The slower wheel is off by half a mm/s at most.
    assert abs(found[slow] * wanted[fast] - wanted[slow] * found[fast]) <= abs(wanted[fast]) / 2


@pytest.mark.parametrize(("right", "left"), [(0.501, 0.0), (0.0, float("nan"))])
def test_a_speed_out_of_range_is_refused(right, left):
    with pytest.raises(ValueError, match=r"= (0.501|nan): expected -0.5 to 0.5 m/s"):
        wheel_speeds(right=right, left=left)


def test_the_clock_is_right_about_the_speeds_that_are_sent():
    defaults = {
        name: parameter.default
        for name, parameter in inspect.signature(ByClock.__init__).parameters.items()
    }
    wheel = defaults["turning"] * WHEEL_BASE / 2
    for right, left in [(defaults["speed"],) * 2, (wheel, -wheel), (-wheel, wheel)]:
        pair = wheel_speeds(right=right, left=left)
        assert [speed / 1000 for speed in pair] == pytest.approx([right, left], abs=1e-3)
