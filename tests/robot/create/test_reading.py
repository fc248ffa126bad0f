"""Readings of the sensors, and blocked wheels that they reveal."""

import dataclasses
import math

import pytest

from jaxcell.robot.create.packets import METRES_PER_COUNT, WHEEL_BASE, Contact, Mode, members
from jaxcell.robot.create.reading import STREAM, Reading, Strain


VALUES = {packet.name: 0 for packet in members(STREAM)} | {"capacity": 2696, "charge": 2000}


def reading(previous=None, *, first_mode=0, **values):
    return Reading.of(VALUES | values, time=0.0, previous=previous, first_mode=first_mode)


def test_distances_add_up_if_an_encoder_wraps():
    now = reading(left_encoder=65530, right_encoder=5)
    assert (now.left, now.right) == (0, 0)
    now = reading(now, left_encoder=4, right_encoder=65535)
    assert now.left == pytest.approx(10 * METRES_PER_COUNT)
    assert now.right == pytest.approx(-6 * METRES_PER_COUNT)
    now = reading(now, left_encoder=65530, right_encoder=5)
    assert (now.left, now.right) == (pytest.approx(0), pytest.approx(0))


def test_the_encoders_measure_a_metre_and_a_quarter_turn():
    counts = round(1 / METRES_PER_COUNT)
    assert counts == pytest.approx(508.8 / (math.pi * 0.072), abs=0.5)
    now = reading(reading(), left_encoder=counts, right_encoder=counts)
    assert (now.distance, now.heading) == (pytest.approx(1, abs=1e-3), 0)
    arc = round(math.pi / 2 * WHEEL_BASE / 2 / METRES_PER_COUNT)
    now = reading(reading(), left_encoder=-arc % 65536, right_encoder=arc)
    assert (now.distance, now.heading) == (0, pytest.approx(math.pi / 2, abs=0.01))


@pytest.mark.parametrize(("said", "first", "mode"), [(2, 0, 2), (3, 1, 2), (4, 1, 3), (4, 0, 3)])
def test_robots_may_count_their_modes_from_one(said, first, mode):
    assert reading(mode=said, first_mode=first).mode is Mode(mode)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({}, None),
        ({"contact": int(Contact.BUMP)}, None),
        ({"contact": int(Contact.WHEEL_DROP_LEFT)}, "wheel"),
        ({"contact": int(Contact.WHEEL_DROP_RIGHT)}, "wheel"),
        ({"cliff_left": 1}, "cliff"),
        ({"cliff_front_left": 1}, "cliff"),
        ({"cliff_front_right": 1}, "cliff"),
        ({"cliff_right": 1}, "cliff"),
        ({"charger": 1}, "charger"),
        ({"charger": 2}, "charger"),
        ({"charge": 269}, "battery"),
        ({"charge": 0, "capacity": 0}, None),
    ],
)
def test_dangers_are_named(values, named):
    danger = reading(**values).danger
    assert danger is None if named is None else named in danger


def test_a_reading_has_si_units():
    now = reading(voltage=16123, charging_state=2)
    assert (now.voltage, now.charge, now.capacity) == (16.123, 2.0, 2.696)
    assert now.battery == pytest.approx(2000 / 2696)
    assert not now.bump
    assert dataclasses.replace(now, contact=Contact.BUMP_LEFT).bump


def frames(strain, wheels, *, left=(), right=(), overcurrent=()):
    """Find the first frame with a reason for a stop, and the reason."""
    for i in range(max(map(len, (left, right, overcurrent)))):
        frame = reading(
            left_encoder=left[i] % 65536 if left else 20 * i,
            right_encoder=right[i] % 65536 if right else 20 * i,
            overcurrent=overcurrent[i] if overcurrent else 0,
        )
        reason = strain.observe(wheels, frame)
        if reason:
            return i, reason
    return None


def test_a_wheel_that_does_not_turn_as_commanded_is_blocked():
    i, reason = frames(Strain(), (100, 100), left=[65535] * 100)
    assert reason == "the left wheel is blocked: it does not turn"
    assert 0.9 < i * 0.015 < 1.1
    assert "right wheel" in frames(Strain(), (-100, 100), right=[7] * 100)[1]
    # The least speed of a motor, 0.03 m/s, is one count per frame; here are half a count.
    assert frames(Strain(), (30, 30), left=[65500 + i // 2 for i in range(200)]) is None
    assert frames(Strain(), (-30, -30), right=[-(i // 2) for i in range(200)]) is None
    assert frames(Strain(), (0, 0), left=[5] * 200, right=[5] * 200) is None
    assert frames(Strain(), (100, 0), right=list(range(0, 2000, 10)), left=[5] * 200) is None


def test_a_motor_that_strains_for_longer_than_a_bump_is_blocked():
    for bits in (8, 16):
        i, reason = frames(Strain(), (100, 100), overcurrent=[bits] * 40)
        assert reason == "a wheel is blocked: its motor draws too much current"
        assert 0.2 < i * 0.015 < 0.4
    assert frames(Strain(), (100, 100), overcurrent=([8] * 15 + [0]) * 5) is None
    assert frames(Strain(), (100, 100), overcurrent=[1 | 2 | 4] * 100) is None, "the brushes"
    assert frames(Strain(), (0, 0), overcurrent=[8] * 100) is None
