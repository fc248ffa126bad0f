"""Robots that turn toward the wall at a bump, in the models and in the emulator."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from jaxcell import bounce, space
from jaxcell.automata import Belief
from jaxcell.robot import Walker
from jaxcell.robot.emulation.body import Body, Noise
from jaxcell.robot.emulation.direct import DirectBody


ROOM = space.Workspace([(0, 0), (4, 0), (4, 3), (0, 3)], [[(2, 1), (3, 1), (3, 2), (2, 2)]])
CELLS = space.CellSpace.of(ROOM, 1.0, 24)
LEGS = space.stride_legs(24, 1.0, 1.0)
STRIDES = space.cell_strides(24, 1.0, 1.0)
GIVE = 1e-6
SLIP = 0.005
BUMP_TURN = math.radians(3)
BUMP_SKID = 0.02
TURN = math.radians(135)


def emulated(cell: int, **fields: Any) -> tuple[Walker, Body]:
    pose = tuple(map(float, CELLS.centre(cell)))
    body = Body(ROOM, pose, **{"give": GIVE, "noise": Noise(bump_turn=BUMP_TURN)} | fields)
    direction = cell // CELLS.positions
    return Walker(DirectBody(body), 1.0, strides=STRIDES, direction=direction), body


@pytest.mark.parametrize("degrees", [0, 15, 30, 45, 60])
@pytest.mark.parametrize("side", [1, -1])
def test_a_bump_turns_toward_the_wall_by_the_sine_of_twice_the_incidence(degrees, side):
    walls = space.felt_walls(ROOM, 0.0)
    heading = side * math.radians(degrees)
    pose = np.array([[3.5, 1.5, heading]])
    after, bumped = space.slipping_step(
        pose, np.array([[2.0, 0, 0]]), 0.0, np.zeros((1, 9)), walls, space.Slip(bump_turn=0.05)
    )
    assert bumped.all()
    # A robot that heads to the left of East turns right, toward the wall.
    expected = -0.05 * math.sin(2 * heading)
    assert after[0, 2] - heading == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("degrees", [-60, 0, 30, 45])
def test_a_robot_whose_wheels_skid_at_a_bump_stands_behind_its_start(degrees):
    heading = math.radians(degrees)
    after, _ = space.slipping_step(
        np.array([[3.5, 1.5, heading]]),
        np.array([[2.0, 0, 0]]),
        0.0,
        np.zeros((1, 9)),
        space.felt_walls(ROOM, 0.0),
        space.Slip(bump_skid=BUMP_SKID),
    )
    behind = BUMP_SKID * math.cos(heading) ** 2
    expected = (3.5 - behind * math.cos(heading), 1.5 - behind * math.sin(heading), heading)
    assert after[0] == pytest.approx(expected, abs=1e-9)


def test_the_emulated_robot_is_turned_and_skids_as_the_model_says():
    walls = space.felt_walls(ROOM, GIVE)
    slip = space.Slip(bump_turn=BUMP_TURN, bump_skid=BUMP_SKID)
    noise = Noise(bump_turn=BUMP_TURN, bump_skid=BUMP_SKID)
    pose = np.stack(CELLS.centre(np.arange(CELLS.size)), axis=1)
    legs = np.repeat(LEGS, CELLS.positions, axis=0)
    after, bumped = space.slipping_step(pose, legs, 0.0, np.zeros((CELLS.size, 9)), walls, slip)
    ahead = space.free_ahead(walls, pose[:, :2], pose[:, 2])
    met = pose[:, :2] + ahead[:, None] * np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    to_corner = np.hypot(*(met[:, None] - walls.reshape(-1, 2)).T).min(axis=0)
    # The model simplifies bumps in the second of two stretches, and near corners.
    compared = np.flatnonzero(bumped & (ahead < legs[:, 0]) & (to_corner >= 0.01)).tolist()
    assert len(compared) > 20
    for cell in compared:
        walker, body = emulated(cell, noise=noise)
        assert walker.step()
        turned = math.remainder(body.theta - after[cell, 2], 2 * math.pi)
        assert turned == pytest.approx(0.0, abs=1e-5)
        assert math.dist(body.pose[:2], after[cell, :2]) < 0.005


def test_a_belief_has_to_know_the_turn_at_bumps_to_hold_the_robot():
    held = []
    for known in (BUMP_TURN, 0.0):
        slip = space.Slip.of(SLIP, give=0.02, bump_turn=known)
        belief = Belief(bounce.slip_map(bounce.FineCells.within(CELLS, slip), [TURN], slip))
        rng, right = np.random.default_rng(0), []
        for cell in rng.integers(CELLS.size, size=30).tolist():
            state = belief.start()
            for observed, place in run(cell, 20, rng):
                state = belief.observe(state, observed)
                right.append(place in belief.estimate(state).cells)
        held.append(np.mean(right))
    assert held[0] > 0.98
    assert held[1] < 0.97


def test_bounded_sets_hold_a_robot_that_turns_and_skids_at_bumps():
    fine = bounce.FineCells.of(CELLS, squares=1, directions=9, reach=4)
    slip = space.Slip.of(3 * SLIP, give=0.02, bump_turn=BUMP_TURN, bump_skid=BUMP_SKID)
    sets = bounce.bounded_map(fine, TURN, slip)
    rng = np.random.default_rng(1)
    for cell in rng.integers(CELLS.size, size=6).tolist():
        state = sets.start()
        for observed, place in run(cell, 12, rng, bump_skid=BUMP_SKID):
            state = sets.observe(state, observed)
            assert place in sets.estimate(state).cells


def run(
    cell: int, steps: int, rng: np.random.Generator, *, bump_skid: float = 0.0
) -> Iterator[tuple[int, int]]:
    """Yield each observation of an emulated robot that slips, and its cell."""
    noise = Noise(distance=SLIP, rotation=SLIP, veer=SLIP, bump_turn=BUMP_TURN, bump_skid=bump_skid)
    walker, body = emulated(cell, give=0.02, noise=noise, rng=rng)
    for _ in range(steps):
        bumped = walker.step()
        if bumped:
            walker.rotate(TURN)
        yield int(bumped), int(CELLS.index(*body.pose))
