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
def test_a_pair_with_a_lost_byte_is_no_other_command(right, left, lost):
    right, left = sent(right, left)
    command = drive_direct(right=right, left=left)
    damaged = CommandParser().feed(command[:lost] + command[lost + 1 :])
    assert {parsed.opcode for parsed in damaged} <= {145}


@pytest.mark.parametrize(("side", "lost"), [(1, 46), (-1, 92)], ids=["straight", "turn"])
def test_a_motion_keeps_its_kind_at_every_speed(side, lost):
    for speed in range(-500, 501):
        right, left = sent(speed, side * speed)
        assert right == side * left
        assert right * speed >= 0
        assert abs(right) <= abs(speed) <= abs(right) + lost
        # A speed without an opcode is not changed.
        if not OPCODES & set(drive_direct(right=speed, left=side * speed)[1:]):
            assert right == speed


@given(right=SPEEDS, left=SPEEDS)
def test_a_pair_that_is_replaced_is_slower_on_the_same_arc(right, left):
    pair, wanted = sent(right, left), (right, left)
    assert not OPCODES & set(drive_direct(right=pair[0], left=pair[1])[1:])
    fast = max((0, 1), key=lambda wheel: abs(wanted[wheel]))
    slow = 1 - fast
    assert abs(pair[fast]) <= abs(wanted[fast])
    assert pair[fast] * wanted[fast] >= 0
    # The error of the slower wheel is at most half a mm/s.
    assert abs(pair[slow] * wanted[fast] - wanted[slow] * pair[fast]) <= abs(wanted[fast]) / 2


@pytest.mark.parametrize(("right", "left"), [(0.501, 0.0), (0.0, float("nan"))])
def test_a_speed_out_of_range_is_refused(right, left):
    with pytest.raises(ValueError, match=r"= (0.501|nan): expected -0.5 to 0.5 m/s"):
        wheel_speeds(right=right, left=left)


def test_the_default_speeds_of_the_clock_are_sent_unchanged():
    defaults = {
        name: parameter.default
        for name, parameter in inspect.signature(ByClock.__init__).parameters.items()
    }
    wheel = defaults["turning"] * WHEEL_BASE / 2
    for right, left in [(defaults["speed"],) * 2, (wheel, -wheel), (-wheel, wheel)]:
        pair = wheel_speeds(right=right, left=left)
        assert [speed / 1000 for speed in pair] == pytest.approx([right, left], abs=1e-3)
