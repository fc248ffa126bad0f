"""Simulated runs of a plan, compared with a robot that drives in small ticks."""

import math

import numpy as np
import pytest

from jaxcell import bounce
from jaxcell.space import CellSpace, Slip, Workspace


WIDTH, HEIGHT, TICK = 4.0, 3.0, 0.02


class Ticking:
    """Robots in an empty room, which drive in ticks with a heading that wanders."""

    def __init__(self, x, y, theta, slip, runs):
        self.x, self.y, self.theta = (np.full(runs, value) for value in (x, y, theta))
        self.slip, self.draw = slip, np.random.default_rng(1)

    def drive(self, distance, here):
        """Drive each robot by a distance, or to a wall, where its wheels stand still."""
        factor = 1 + self.draw.normal(0, self.slip.step, self.x.size)
        gone, stopped = np.zeros(self.x.size), ~here
        for k in range(math.ceil(np.abs(distance).max() / TICK)):
            part = np.clip(np.abs(distance) - k * TICK, 0, TICK) * np.sign(distance)
            x = self.x + part * factor * np.cos(self.theta)
            y = self.y + part * factor * np.sin(self.theta)
            give = self.slip.give
            in_wall = (x < -give) | (x > WIDTH + give) | (y < -give) | (y > HEIGHT + give)
            stopped |= in_wall
            self.x, self.y = np.where(stopped, self.x, x), np.where(stopped, self.y, y)
            gone += np.where(stopped, 0.0, part)
            wander = self.draw.normal(0, self.slip.heading * np.sqrt(np.abs(part)))
            self.theta = self.theta + np.where(stopped, 0.0, wander)
        return gone, stopped & here

    def follow(self, actions):
        """Return a mask of the robots whose observations are those of the plan."""
        here = np.ones(self.x.size, bool)
        for action in actions:
            gone, bumped = self.drive(np.ones(self.x.size), here)
            self.drive(-np.where(bumped, gone, 0.0), bumped)
            turn = math.remainder(action, 2 * math.pi)
            self.theta += np.where(
                bumped, turn * (1 + self.draw.normal(0, self.slip.turn, self.x.size)), 0.0
            )
            here &= bumped == (action != 0)
        return here


@pytest.mark.parametrize(("error", "turns"), [(0.02, 3), (0.05, 3), (0.08, 2)])
def test_a_plan_arrives_as_often_as_on_robots_in_small_ticks(error, turns):
    room = Workspace([(0, 0), (WIDTH, 0), (WIDTH, HEIGHT), (0, HEIGHT)])
    cells = CellSpace.of(room, 1.0, 4)
    quarter = math.pi / 2
    plan = [0.0, 0.0, 0.0, quarter, 0.0, 0.0, quarter, 0.0, 0.0, 0.0, quarter][: 4 * turns - 1]
    slip, runs = Slip.of(error, give=0.02), 20_000
    ends = bounce.plan_runs(cells, 0, plan, slip, runs=runs)
    robots = Ticking(0.5, 0.5, 0.0, slip, runs)
    here = robots.follow(plan)
    share = here.mean()
    assert len(ends) / runs == pytest.approx(share, abs=0.02)
    for found, expected in zip(ends.T, (robots.x, robots.y, robots.theta), strict=True):
        assert found.mean() == pytest.approx(expected[here].mean(), abs=0.02)
        assert found.std() == pytest.approx(expected[here].std(), rel=0.1)
