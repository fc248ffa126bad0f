"""A run that is resumed from its log equals a run without a stop."""

import math

import numpy as np
import pytest
from robot_files import SPEC
from wheels import body_in, bounce_filter, map_cells, orbit

from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.followers import FilterFollower, run_follower
from jaxcell.robot.patrol import Patrol, run_patrol
from jaxcell.robot.plan import run_plan
from jaxcell.robot.run_log import LoggedRun, RunLog, read_log
from jaxcell.robot.tasks.files import load_task
from jaxcell.robot.tasks.patrol_task import save_patrols
from jaxcell.robot.team import run_member, save_team
from jaxcell.robot.walker import Walker, cell_strides


LAB = map_cells("lab_a.json")
STRIDES = cell_strides(LAB.directions, 1.0, 1.0)
START = 20
WORD, _ = orbit(LAB, 135, START, 12)


class Stopping(DirectBody):
    """A robot that is stopped after a number of straight stretches."""

    def __init__(self, body, stretches):
        super().__init__(body)
        self.left = stretches

    def forward(self, distance, *, tolerance):
        self.left -= 1
        if self.left < 0:
            raise RobotStopped("there is a cliff")
        return super().forward(distance, tolerance=tolerance)


def filter_run(folder):
    filter = bounce_filter(LAB, 135)
    return lambda walker, log: run_follower(
        walker, FilterFollower(filter), [math.radians(135)], log=log
    )


def plan_run(folder):
    actions = [math.radians(135) * int(bumped) for bumped in WORD]
    return lambda walker, log: run_plan(walker, actions, log=log)


def team_run(folder):
    """A robot that turns before its first step, and stays once because of another robot."""
    actions = f"+-{WORD}2"
    save_team(folder / "team.json", SPEC, [(0.5, 0.5, 0.0)], [math.radians(135)], [actions])
    task = load_task(folder / "team.json")
    return lambda walker, log: run_member(walker, task, log=log, sleep=lambda _: None)


def patrol_run(folder):
    walk = np.random.default_rng(0).integers(LAB.positions, size=(3, LAB.positions))
    weight = np.full(walk.shape, 1 / 3)
    save_patrols(folder / "patrol.json", LAB, [(walk, weight)], [START % LAB.positions], 2.5)
    task = load_task(folder / "patrol.json")
    settings = {"start": START % LAB.positions, "facing": 0, "seed": 1, "visits": 6}
    seen = []

    def run(walker, log):
        patrol = Patrol(task, **settings, most_bumps=9, limit=40)
        return run_patrol(walker, patrol, look=seen.append, log=log)

    run.seen = seen
    return run


@pytest.mark.parametrize("make", [filter_run, plan_run, team_run, patrol_run])
def test_a_run_is_resumed_from_its_log(make, tmp_path):
    run = make(tmp_path)
    x, y, theta = map(float, LAB.centre(START))
    direction, strides = START // LAB.positions, STRIDES
    if make is patrol_run:
        direction, theta, strides = 0, 0.0, cell_strides(4, 1.0, 1.0)

    def walker_at(pose, stretches, recalled=""):
        body = body_in(LAB, START)
        body.x, body.y, body.theta = pose
        robot = Stopping(body, stretches)
        return Walker(robot, 1.0, strides=strides, direction=direction, recalled=recalled), body

    walker, body = walker_at((x, y, theta), 10**6)
    whole, end = run(walker, None), body.pose
    assert len(whole.observations) > 5
    seen = getattr(run, "seen", [])
    looked = seen.copy()
    for stretches in (2, 5, 9):
        seen.clear()
        walker, _ = walker_at((x, y, theta), stretches)
        path = tmp_path / f"{stretches}.jsonl"
        with pytest.raises(RobotStopped), RunLog(path, {}) as log:
            run(walker, log)
        before = read_log(path).observations
        # A robot that was stopped within a step is put back to the start of the step.
        ahead, left, turned = walker.place
        there = complex(x, y) + complex(ahead, left) * complex(math.cos(theta), math.sin(theta))
        walker, body = walker_at((there.real, there.imag, theta + turned), 10**6, before)
        with RunLog(tmp_path / f"{stretches}-on.jsonl", {}) as log:
            assert run(walker, log) == whole
        assert body.pose[:2] == pytest.approx(end[:2], abs=0.02)
        assert math.remainder(body.pose[2] - end[2], 2 * math.pi) == pytest.approx(0, abs=0.02)
        assert seen == looked
        again = read_log(tmp_path / f"{stretches}-on.jsonl")
        assert again.observations == whole.observations
        recalled = [event.get("recalled") for event in again.events if "observation" in event]
        assert recalled == [True] * len(before) + [None] * (len(recalled) - len(before))


def test_a_robot_does_not_move_while_its_walker_counts_earlier_steps():
    class Still:
        def forward(self, distance, *, tolerance):
            raise AssertionError("it drove")

        turn = forward

    walker = Walker(Still(), 1.0, strides=STRIDES, direction=1, recalled="010")
    walker.rotate(math.pi / 4)
    assert [walker.step() for _ in range(3)] == [False, True, False]
    walker.rotate(math.pi / 2)
    # The robot is two cells North of its start, where it faced North-East.
    assert walker.place == pytest.approx((math.sqrt(2), math.sqrt(2), 0.75 * math.pi))
    assert walker.estimate == pytest.approx(walker.place)
    assert walker.observations == "010"
    assert not walker.drives
    with pytest.raises(AssertionError, match="it drove"):
        walker.step()
    assert walker.drives


@pytest.mark.parametrize("direction", [-1, 1.5, "2"])
def test_a_header_with_a_bad_direction_is_refused(direction):
    with pytest.raises(ValueError, match="direction: expected a whole number or null"):
        LoggedRun({"direction": direction}, (), True).direction  # noqa: B018
