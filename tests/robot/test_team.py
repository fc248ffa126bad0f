import math

import numpy as np
import pytest
from wheels import map_cells, pose_of

from jaxcell.bounce import team_trajectory
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.run_log import RunLog, read_log
from jaxcell.robot.tasks.files import load_task
from jaxcell.robot.team import Member, member_actions, run_member, save_team
from jaxcell.robot.walker import Walker
from jaxcell.space import CellSpace, Workspace, free_steps


COMMON = {"cell_m": 1.0, "directions": 8, "step_m": 1.0, "robot_radius_m": 0.0}
LAB = map_cells("lab_b.json")


@pytest.fixture
def team_file(tmp_path):
    team = team_trajectory(LAB, [0, 70, 141], math.radians(135), part_steps=6)
    path, bumped = team.cell, team.bumped
    actions = member_actions(path, bumped, free_steps(LAB))
    file = tmp_path / "team.json"
    save_team(
        file, COMMON, [pose_of(LAB, int(z)) for z in path[0]], [math.radians(135)] * 3, actions
    )
    return file, path, bumped


def test_each_robot_follows_its_part_of_the_trajectory_alone(team_file, tmp_path):
    file, path, bumped = team_file
    there = free_steps(LAB)
    done = ""
    for robot in range(3):
        task = load_task(file, robot)
        assert (task.robot, task.robots) == (robot, 3)
        assert task.start == pytest.approx(pose_of(LAB, int(path[0, robot])))
        done += task.actions
        body = Body(LAB.workspace, task.start)
        walker = Walker(
            DirectBody(body),
            1.0,
            strides=task.strides,
            direction=int(path[0, robot]) // LAB.positions,
        )
        log_file = tmp_path / f"{robot}.jsonl"
        with RunLog(log_file, task.header) as log:
            outcome = run_member(walker, task, log=log)
        assert outcome.result == "arrived"
        assert int(LAB.index(*body.pose)) == path[-1, robot]
        # The robot senses the walls, and no other robot.
        walls = np.take(there, path[:-1, robot]) == path[:-1, robot] % LAB.positions
        moved = path[1:, robot] % LAB.positions != path[:-1, robot] % LAB.positions
        assert outcome.observations == "".join(
            "1" if wall else "0"
            for wall, b, m in zip(walls, bumped[:, robot], moved, strict=True)
            if (b and wall) or m
        )
        member = Member(task.actions)
        member.replay(read_log(log_file).observations)
        assert member.outcome() == outcome
    # They meet walls and each other, and turn to both sides.
    assert set(done) == set("012+-")


class Floor(Walker):
    """A walker that bumps as a list prescribes."""

    def __init__(self, bumps):
        self.bumps, self.turned, self.observations = list(bumps), [], ""

    def step(self):
        bumped = bool(self.bumps.pop(0))
        self.observations += str(int(bumped))
        return bumped

    def rotate(self, angle):
        self.turned.append(round(math.degrees(angle)))


def task_of(tmp_path, actions, bounce=135):
    file = tmp_path / "team.json"
    save_team(file, COMMON, [(0.5, 0.5, 0.0)], [math.radians(bounce)], [actions])
    return load_task(file)


def test_a_robot_waits_for_another_in_its_way(tmp_path):
    floor, waits = Floor([0, 1, 1, 0, 1]), []
    outcome = run_member(floor, task_of(tmp_path, "002+1-"), pause=1.5, sleep=waits.append)
    assert outcome.result == "arrived"
    assert outcome.observations == "01101"
    assert floor.turned == [135, 45, 135, -45]
    assert waits == [1.5, 1.5]


@pytest.mark.parametrize(
    ("actions", "bumps", "message"),
    [
        ("001", [0, 1, 1, 1], "action 1 of 3: the robot bumped 3 times where its way is free"),
        ("0210", [0, 0], "action 2 of 4: the robot met no wall where there is one"),
    ],
)
def test_a_trajectory_that_meets_another_map_is_refuted(tmp_path, actions, bumps, message):
    outcome = run_member(Floor(bumps), task_of(tmp_path, actions), sleep=lambda _: None)
    assert outcome.result == "refuted"
    observed = "".join(map(str, bumps))
    assert outcome.reason == f"{message}; the robot observed {observed}"
    member = Member(actions)
    member.replay(observed)
    assert member.outcome() == outcome


def test_a_log_that_was_cut_off_is_unfinished():
    member = Member("0012")
    member.replay("00")
    assert member.outcome().result == "unfinished"
    with pytest.raises(ValueError, match="more observations than the robot has steps"):
        Member("02").replay("00")


def test_actions_distinguish_walls_from_robots():
    # Two robots bump into each other first, and later into walls.
    hall = CellSpace.of(Workspace([(0, 0), (4, 0), (4, 1), (0, 1)]), 1.0, 4)
    path = np.array([[1, 2 * 4 + 2], [2 * 4 + 1, 2], [2 * 4, 3], [0, 2 * 4 + 3]])
    bumped = np.array([[True, True], [False, False], [True, True]])
    assert member_actions(path, bumped, free_steps(hall)) == ["201", "201"]
