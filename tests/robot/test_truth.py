"""Without noise all comes true on every map, steps and plans through the whole driver.

Filters, teams and patrols go through it on two maps, and drive the body without it on others.
"""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from wheels import (
    MAPS,
    body_in,
    bounce_filter,
    bounce_tables,
    map_cells,
    place_of,
    pose_of,
    walker_in,
)

from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.followers import FilterFollower, run_follower
from jaxcell.robot.patrol import Patrol, run_patrol
from jaxcell.robot.plan import run_plan
from jaxcell.robot.routing import wave
from jaxcell.robot.tasks.files import load_task
from jaxcell.robot.tasks.patrol_task import save_patrols
from jaxcell.robot.team import member_actions, run_member, save_team
from jaxcell.robot.walker import Drivable, Walker
from jaxcell.space import CellSpace, free_steps


# The cells that a map suggests, but larger ones for the hall, which is 200 m long.
CASES = {
    "arena.json": (90, {}),
    "cafe.json": (67.5, {}),
    "complex.json": (135, {}),
    "depot.json": (135, {}),
    "harbour.json": (45, {}),
    "lab_a.json": (45, {}),
    "lab_b.json": (135, {}),
    "maze.txt": (45, {"directions": 8}),
    "office.yaml": (45, {"directions": 8}),
    "slanted.json": (67.5, {}),
    "room_200x125.json": (45, {"cell": 12.5, "directions": 8}),
}
# Where a step takes a minute of the robot's time, each kind of step is enough.
LARGEST = "room_200x125.json"
DRIVEN = ("arena.json", "lab_a.json")
some_maps = pytest.mark.parametrize("name", [name for name in CASES if name != LARGEST])


def cells_of(name: str) -> CellSpace:
    return map_cells(name, **CASES[name][1])


def robot_for(name: str) -> Callable[[Body], Drivable]:
    return SimulatedCreate if name in DRIVEN else DirectBody


def starts_in(cells: CellSpace, count: int, seed: int = 0) -> list[int]:
    return np.random.default_rng(seed).choice(cells.size, count, replace=False).tolist()


def test_every_map_of_the_data_is_tested():
    assert set(CASES) == {
        path.name for path in MAPS.iterdir() if path.suffix in (".json", ".txt", ".yaml")
    }


@pytest.mark.parametrize("name", CASES)
def test_a_robot_bounces_as_the_cells_say(name):
    cells, bounce = cells_of(name), CASES[name][0]
    image, bumped = bounce_tables(cells, bounce)
    # One step before a bump, so that there is one of each.
    at = np.flatnonzero(~bumped & bumped[image])
    starts = 1 if name == LARGEST else 2
    for cell in np.random.default_rng(1).choice(at, starts, replace=False).tolist():
        walker, body = walker_in(cells, cell)
        for _ in range(4):
            assert walker.step() == bumped[cell]
            if bumped[cell]:
                walker.rotate(math.radians(bounce))
            cell = int(image[cell])
            assert place_of(cells, body) == cell
            x, y, _ = pose_of(cells, cell)
            assert math.hypot(body.x - x, body.y - y) < cells.cell / 20


@some_maps
def test_a_filter_localizes_to_the_true_cell(name):
    cells, bounce = cells_of(name), CASES[name][0]
    filter = bounce_filter(cells, bounce)
    image, bumped = bounce_tables(cells, bounce)
    (cell,) = starts_in(cells, 1)
    walker, body = walker_in(cells, cell, robot=robot_for(name))
    outcome = run_follower(
        walker, FilterFollower(filter, "cycle"), [math.radians(bounce)], limit=300
    )
    observed = ""
    for _ in outcome.observations:
        observed += str(int(bumped[cell]))
        cell = int(image[cell])
    assert outcome.observations == observed
    assert outcome.result == "localized"
    assert place_of(cells, body) == cell
    assert cell in outcome.cells


def plan_from(cells: CellSpace, cell: int, count: int) -> tuple[list[float], int]:
    """A plan that turns by any angle at a bump, and where it ends."""
    there, rng = free_steps(cells), np.random.default_rng(cell)
    actions = []
    for _ in range(count):
        way, position = divmod(cell, cells.positions)
        turn = int(rng.integers(1, cells.directions)) if there[way, position] == position else 0
        actions.append(2 * math.pi * turn / cells.directions)
        cell = (way + turn) % cells.directions * cells.positions + int(there[way, position])
    return actions, cell


@some_maps
def test_a_plan_arrives(name):
    cells = cells_of(name)
    (cell,) = starts_in(cells, 1, seed=3)
    actions, goal = plan_from(cells, cell, 15)
    walker, body = walker_in(cells, cell)
    assert run_plan(walker, actions).result == "arrived"
    assert place_of(cells, body) == goal


def team_walk(cells: CellSpace, starts: list[int], steps: int) -> tuple[np.ndarray, np.ndarray]:
    """A walk of robots that turn by a quarter where a wall or another robot is."""
    there, quarter = free_steps(cells), cells.directions // 4
    path, bumped = [np.array(starts)], []
    for _ in range(steps):
        way, here = np.divmod(path[-1], cells.positions)
        end = there[way, here]
        hit = end == here
        for i, k in itertools.permutations(range(len(here)), 2):
            hit[i] |= end[i] in (end[k], here[k])
        way = np.where(hit, (way + quarter) % cells.directions, way)
        path.append(way * cells.positions + np.where(hit, here, end))
        bumped.append(hit)
    return np.array(path), np.array(bumped)


@some_maps
def test_each_robot_of_a_team_arrives(name, tmp_path):
    cells = cells_of(name)
    robots, steps = 2, 10
    path, bumped = team_walk(cells, starts_in(cells, robots, seed=5), steps)
    actions = member_actions(path, bumped, free_steps(cells))
    common = {
        "cell_m": cells.cell,
        "directions": cells.directions,
        "step_m": cells.cell,
        "robot_radius_m": cells.workspace.robot_radius,
    }
    poses = [pose_of(cells, z) for z in path[0].tolist()]
    save_team(tmp_path / "team.json", common, poses, [math.pi / 2] * robots, actions)
    for robot in range(robots):
        task = load_task(tmp_path / "team.json", robot)
        walker, body = walker_in(cells, int(path[0, robot]), robot=robot_for(name))
        assert run_member(walker, task, sleep=lambda _: None).result == "arrived"
        assert place_of(cells, body) == path[-1, robot]


@some_maps
def test_a_patrol_visits_what_is_drawn(name, tmp_path):
    cells = cells_of(name)
    plane = CellSpace.of(cells.workspace, cells.cell, 4)
    ways = free_steps(plane)
    start = plane.positions // 2
    away = wave(ways, start)
    goals = np.flatnonzero((away > 0) & (away <= 8))
    image = np.full((1, plane.positions), start)
    image[0, start] = np.random.default_rng(7).choice(goals)
    save_patrols(
        tmp_path / "patrol.json",
        cells,
        [(image, np.ones((1, plane.positions)))],
        [start],
        1.0,
    )
    task = load_task(tmp_path / "patrol.json")
    body = body_in(plane, start)
    patrol = Patrol(task, start=start, facing=0, seed=0, visits=2, most_bumps=1, limit=999)
    walker = Walker(robot_for(name)(body), task.step, strides=task.strides)
    outcome = run_patrol(walker, patrol)
    assert (outcome.result, outcome.visited) == ("patrolled", (image[0, start], start))
    assert "1" not in outcome.observations
    assert int(plane.index(body.x, body.y)) % plane.positions == start
