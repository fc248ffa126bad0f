"""Robots in other rooms that agree with a map, and starts from which robots touch a corner.

The robots are simulated by whole numbers, one by one.
"""

import functools

import numpy as np
import pytest
from grid_robot import GridRobot, filter_of, room

from jaxcell.automata.filter import CONFIRM
from jaxcell.bounce import (
    AdaptivelyLocalized,
    OffsetLocalized,
    Offsets,
    bounce_map,
    localization_filter,
    localization_policy,
)
from jaxcell.bounce.localization.localize import localize
from jaxcell.bounce.localization.other_rooms import ROOMS, filter_agreement, policy_agreement
from jaxcell.bounce.localization.result import Localized
from jaxcell.robot.followers import FilterFollower, PolicyFollower
from jaxcell.space import CELL_BY_CELL, ENDPOINT, CellSpace
from jaxcell.space.maps.random_rooms import random_room
from jaxcell.space.touching import touching_steps


FREE = room(3)
EIGHTHS = [1, 3]


def share(follow, confirm: int, shifts: list[int]) -> float:
    """The share of all robots in the random rooms that are localized."""
    rows, columns = FREE.shape
    results = []
    for number in range(ROOMS):
        free = random_room(0, number, columns, rows, 1 + number % 5)
        for cell in range(4 * int(free.sum())):
            outcome = GridRobot(free, cell).drive(follow(confirm=confirm), shifts)
            results.append(outcome.result == "localized")
    return sum(results) / len(results)


@pytest.mark.parametrize("confirm", [0, 10])
def test_the_share_of_robots_in_other_rooms_is_that_of_simulated_robots(confirm):
    cells, angles = CellSpace.of_grid(FREE, 4), np.radians([90.0, 180.0])
    filter = filter_of(FREE, 1)
    expected = share(functools.partial(FilterFollower, filter), confirm, [1])
    assert filter_agreement(filter, cells, np.pi / 2)[confirm] == expected
    policy = localization_policy(cells, angles).policy
    expected = share(functools.partial(PolicyFollower, policy), confirm, [1, 2])
    assert policy_agreement(policy, cells, angles)[confirm] == expected


def test_the_frame_of_a_drawn_map_is_no_part_of_the_room():
    """Robots in other rooms of the size of the array would hardly ever agree with the map."""
    plain, framed = (CellSpace.of_grid(free, 4) for free in (FREE, np.pad(FREE, (2, 1))))
    filter = filter_of(FREE, 1)
    expected = filter_agreement(filter, plain, np.pi / 2)
    assert filter_agreement(filter, framed, np.pi / 2) == expected
    assert expected[0] > 0


class OffsetRobot(GridRobot):
    """A robot at an offset from the lower left corner of its square, from 0 to 1."""

    offset: tuple[float, float]

    def step(self) -> bool:
        dx, dy = self.ahead[self.direction]
        if dx and dy:
            x, y = self.offset
            across, up = (1 - x if dx > 0 else x), (1 - y if dy > 0 else y)
            if not self.is_free(*((dx, 0) if across < up else (0, dy))):
                return True
        if not self.is_free(dx, dy):
            return True
        self.column, self.row = self.column + dx, self.row + dy
        return False


def test_the_share_of_robots_off_the_centres_in_other_rooms_is_that_of_simulated_robots():
    small, bounce = room(3, 4, 5, 2), 3 * np.pi / 4
    cells = CellSpace.of_grid(small, 8)
    offsets = Offsets.of(cells)
    filter = localization_filter(offsets.bounce_map(bounce))
    result = OffsetLocalized(filter, cells, offsets, bounce)
    found = {0: [], 10: []}
    for number in range(ROOMS):
        free = random_room(0, number, 5, 4, 1 + number % 5)
        for offset in np.random.default_rng(0).uniform(size=(4, 2)).tolist():
            for cell in range(8 * int(free.sum())):
                robot, follower = OffsetRobot(free, cell, 8), FilterFollower(filter, confirm=10)
                robot.offset = offset
                outcome = robot.drive(follower, [3])
                found[0].append(follower.agreed is not None)
                found[10].append(outcome.result == "localized")
    for confirm, results in found.items():
        assert result.agreement[confirm] == pytest.approx(np.mean(results), abs=1e-12)
    assert 0 < result.agreement[10] < result.agreement[0]
    assert result.evidence["other_room_shares"][str(CONFIRM)] == result.other_room_share


@pytest.mark.parametrize("seed", range(4))
def test_steps_that_touch_are_those_through_the_corner_of_a_blocked_square(seed):
    free = room(seed)
    cells = CellSpace.of_grid(free, 8)
    touched = []
    for cell in range(cells.size):
        robot = GridRobot(free, cell, 8)
        robot.step()
        touched.append(robot.touched)
    assert any(touched)
    np.testing.assert_array_equal(touching_steps(cells, CELL_BY_CELL).ravel(), touched)
    assert not touching_steps(cells, ENDPOINT).any()


def touching(follow, shifts: list[int]) -> list[bool]:
    """Which starts lead a robot through a corner before it is localized and confirmed."""
    touched = []
    for cell in range(8 * int(FREE.sum())):
        robot = GridRobot(FREE, cell, 8)
        assert robot.drive(follow(), shifts).result == "localized"
        touched.append(robot.touched)
    return touched


def test_the_starts_that_touch_a_corner_before_a_filter_localizes_are_counted():
    cells = CellSpace.of_grid(FREE, 8)
    mapped = bounce_map(cells, 3 * np.pi / 4)
    filter = localization_filter(mapped)
    run = localize(mapped, filter, 0)
    result = Localized(filter, cells, CELL_BY_CELL, 3 * np.pi / 4, run)
    touched = touching(functools.partial(FilterFollower, filter_of(FREE, 3, 8)), [3])
    np.testing.assert_array_equal(result.touching, touched)
    assert 0 < result.touching_starts == sum(touched)
    assert any(f"From {sum(touched)} of {cells.size} starts" in each for each in result.remarks)
    assert result.evidence["touching_starts"] == sum(touched)
    assert result.evidence["other_room_shares"][str(CONFIRM)] == result.other_room_share


def test_the_starts_that_touch_a_corner_before_a_policy_localizes_are_counted():
    policy = localization_policy(CellSpace.of_grid(FREE, 8), np.radians([45.0, 135.0]))
    result = AdaptivelyLocalized.of(policy, 0)
    touched = touching(functools.partial(PolicyFollower, policy.policy), EIGHTHS)
    np.testing.assert_array_equal(result.touching, touched)
    assert any(f"From {sum(touched)} of " in remark for remark in result.remarks)
