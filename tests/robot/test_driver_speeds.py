import inspect

from hypothesis import given, strategies as st

from jaxcell.robot.clock import ByClock
from jaxcell.robot.driver import _millimetres
from jaxcell.robot.open_interface import CommandParser, drive_direct
from jaxcell.robot.packets import WHEEL_BASE


SPEEDS = st.floats(-0.5, 0.5)


@given(right=SPEEDS, left=SPEEDS, lost=st.integers(0, 4))
def test_a_lost_byte_makes_no_other_command_of_a_speed(right, left, lost):
    speeds = {"right": _millimetres("right", right), "left": _millimetres("left", left)}
    command = drive_direct(**speeds)
    parser = CommandParser()
    damaged = parser.feed(command[:lost] + command[lost + 1 :])
    assert [one.opcode for one in damaged if one.opcode != 145] == []


@given(speed=SPEEDS)
def test_a_speed_gives_way_to_the_next_slower_one(speed):
    sent = _millimetres("speed", speed)
    asked = round(1000 * speed)
    assert abs(sent) <= abs(asked) <= abs(sent) + 46
    assert sent * asked >= 0
    if (abs(asked) <= 82 and abs(asked) != 7) or 174 <= abs(asked) <= 248:
        assert sent == asked


def test_the_clock_is_right_about_the_speeds_that_are_sent():
    defaults = {
        name: parameter.default
        for name, parameter in inspect.signature(ByClock.__init__).parameters.items()
    }
    wheel = defaults["turning"] * WHEEL_BASE / 2
    for speed in (defaults["speed"], -defaults["speed"], wheel, -wheel):
        assert abs(_millimetres("wheel", speed) / 1000 - speed) < 1e-3
