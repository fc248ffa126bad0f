import itertools
import json

import numpy as np
import pytest
from wheels import map_cells

from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.patrol import Patrol, replay_patrol, run_patrol
from jaxcell.robot.routing import wave
from jaxcell.robot.run_log import RunLog, read_log
from jaxcell.robot.tasks.files import load_task
from jaxcell.robot.tasks.patrol_task import save_patrols
from jaxcell.robot.walker import Walker
from jaxcell.space import CellSpace, Workspace, free_steps


LAB = map_cells("lab_b.json", directions=4)
# Unit squares, with a thin wall between free squares.
PARTED = CellSpace.of(
    Workspace([(0, 0), (4, 0), (4, 3), (0, 3)], [[(1.95, 0.9), (2.05, 0.9), (2.05, 3), (1.95, 3)]]),
    1.0,
    8,
)


def round_tour(cells, stops) -> tuple[np.ndarray, np.ndarray]:
    """A walk that visits some positions in a cycle, and stays at the others."""
    image = np.arange(cells.positions)[None].repeat(2, 0)
    image[:, stops] = np.roll(stops, -1)
    return image, np.full(image.shape, 0.5)


def random_walk(cells, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    image = rng.integers(cells.positions, size=(3, cells.positions))
    return image, rng.dirichlet(np.ones(3), cells.positions).T


@pytest.fixture
def task_of(tmp_path):
    def make(cells, *walks, start=0, robot=0):
        path = tmp_path / "patrol.json"
        save_patrols(path, cells, walks, [start] * len(walks), 2.5)
        return load_task(path, robot)

    return make


def patrol_of(task, **fields) -> Patrol:
    known = {"start": task.start, "facing": 0, "seed": 0, "visits": 10, "most_bumps": 20}
    return Patrol(task, **known | {"limit": 1000} | fields)


@pytest.fixture
def patrolled(tmp_path):
    """Run a patrol with a log, and check that a replay has the same outcome."""

    def run(task, workspace, look=None, **fields):
        x, y, _ = task.cells.centre(task.start)
        body, path = Body(workspace, (float(x), float(y), 0.0)), tmp_path / "run.jsonl"
        walker = Walker(SimulatedCreate(body), task.step, strides=task.strides)
        patrol = patrol_of(task, **fields)
        path.unlink(missing_ok=True)
        with RunLog(path, {"kind": "patrol", "patrol": patrol.settings}) as log:
            outcome = run_patrol(walker, patrol, look=look, log=log)
        kept = read_log(path)
        assert replay_patrol(kept, task) == outcome
        return outcome, kept, body

    return run


def place_of(cells, body) -> int:
    return int(cells.index(body.x, body.y))


@pytest.mark.parametrize("cells", [LAB, PARTED], ids=["lab_b", "parted"])
def test_a_file_has_the_steps_of_the_map(task_of, cells):
    task = task_of(cells, random_walk(cells, 0), random_walk(cells, 1), robot=1)
    plane = CellSpace.of(cells.workspace, cells.cell, 4)
    assert task.ways.tolist() == free_steps(plane).tolist()
    assert (task.robot, task.robots, task.reach) == (1, 2, 2.5)
    assert (task.cell, task.step, task.directions) == (1.0, 1.0, 4)
    image, probability = random_walk(cells, 1)
    assert task.image.tolist() == image.tolist()
    assert task.probability.tolist() == probability.tolist()
    assert task.cells.centre(5)[:2] == plane.centre(5)[:2]
    json.dumps(task.header)


def test_a_robot_visits_the_drawn_cells_on_shortest_paths(task_of, patrolled):
    stops = np.array([0, 18, 7])
    task = task_of(LAB, round_tour(LAB, stops))
    seen = []
    outcome, run, body = patrolled(task, LAB.workspace, seen.append, visits=7)
    assert outcome.result == "patrolled"
    assert outcome.visited == (18, 7, 0, 18, 7, 0, 18)
    assert outcome.position == 18 == place_of(LAB, body)
    # The robot takes shortest paths without a bump, and looks in each cell.
    tour = [0, *outcome.visited]
    length = sum(int(wave(task.ways, b)[a]) for a, b in itertools.pairwise(tour))
    assert outcome.observations == "0" * length
    assert seen[0] == 0
    assert len(seen) == length + 1
    other = task_of(LAB, round_tour(LAB, np.array([0, 7, 18])))
    with pytest.raises(
        ValueError, match=r"observation 0: the log has direction .* of another policy"
    ):
        replay_patrol(run, other)


def test_a_robot_with_memory_goes_on_in_its_direction(task_of, patrolled):
    """From the middle of a corridor of three cells, it goes to the other end."""
    hall = CellSpace.of(Workspace([(0, 0), (3, 0), (3, 1), (0, 1)]), 1.0, 8)
    walk = np.array([[1, 2, 4, 1, 3, 4]]), np.ones((1, 6))
    task = task_of(hall, walk)
    outcome, _, _ = patrolled(task, hall.workspace, visits=9)
    assert outcome.visited == (1, 2, 1, 0, 1, 2, 1, 0, 1)


def test_an_intruder_ends_a_patrol(task_of, patrolled):
    task = task_of(LAB, round_tour(LAB, np.array([0, 18])))
    looked = []

    def look(position):
        looked.append(position)
        return "a cross" if len(looked) == 4 else None

    outcome, run, _ = patrolled(task, LAB.workspace, look)
    assert (outcome.result, outcome.intruder) == ("reported", "a cross")
    assert outcome.position == looked[-1]
    assert outcome.observations == "000"
    assert [e["intruder"] for e in run.events if e["event"] == "report"] == ["a cross"]
    assert patrolled(task, LAB.workspace, lambda _: 1)[0].observations == ""


def test_a_robot_goes_round_an_obstacle_that_is_not_in_the_map(task_of, patrolled):
    hall = CellSpace.of(Workspace([(0, 0), (5, 0), (5, 3), (0, 3)]), 1.0, 8)
    task = task_of(hall, round_tour(hall, np.array([5, 9])), start=5)
    box = Workspace([(0, 0), (5, 0), (5, 3), (0, 3)], [[(2, 1), (3, 1), (3, 2), (2, 2)]])
    outcome, _, body = patrolled(task, box, visits=5)
    assert outcome.result == "patrolled"
    assert outcome.visited == (9, 5, 9, 5, 9)
    # The robot bumps once, from the West, and then avoids the obstacle.
    assert outcome.obstacles == ((6, 0),)
    assert outcome.observations.count("1") == 1
    assert "in the way 1 time where" in outcome.reason
    assert place_of(hall, body) == 9


def test_a_robot_that_cannot_leave_its_cell_is_refuted(task_of, patrolled):
    hall = CellSpace.of(Workspace([(0, 0), (3, 0), (3, 1), (0, 1)]), 1.0, 8)
    task = task_of(hall, round_tour(hall, np.array([0, 2])))
    room = Workspace([(0, 0), (1, 0), (1, 1), (0, 1)])
    outcome, _, body = patrolled(task, room, most_bumps=4)
    assert (outcome.result, outcome.observations) == ("refuted", "1111")
    assert outcome.reason.endswith("lost its place; the robot observed 1111")
    assert (body.x, body.y) == pytest.approx((0.5, 0.5), abs=0.02)
    outcome, _, _ = patrolled(task, hall.workspace, limit=3)
    assert outcome.result == "unfinished"
    assert len(outcome.observations) == 3


@pytest.mark.parametrize("seed", [0, 1])
def test_draws_have_the_probabilities_of_the_policy(task_of, seed):
    hall = CellSpace.of(Workspace([(0, 0), (3, 0), (3, 3), (0, 3)]), 1.0, 8)
    image, probability = random_walk(hall, seed)
    probability[0, :] = 0
    probability /= probability.sum(axis=0)
    task = task_of(hall, (image, probability), start=4)
    patrol = patrol_of(task, seed=seed, visits=2000, limit=10**6)
    while (way := patrol.next()) is not None:
        patrol.observe(way, False)
    visited = np.array([4, *patrol.visited])
    assert len(visited) == 2001
    counts = np.zeros((9, 9))
    np.add.at(counts, (visited[:-1], visited[1:]), 1)
    law = np.zeros((9, 9))
    np.add.at(law, (np.arange(9), image), probability)
    assert not counts[law == 0].any()
    times = counts.sum(axis=1)
    often = times > 100
    deviation = np.abs(counts - times[:, None] * law)[often]
    assert (deviation < 6 * np.sqrt(times[often, None] * law[often]) + 6).all()


def test_robots_and_seeds_draw_differently(task_of):
    def visits(robot, seed):
        walk = random_walk(LAB, 3)
        patrol = patrol_of(task_of(LAB, walk, walk, robot=robot), seed=seed, visits=30)
        while (way := patrol.next()) is not None:
            patrol.observe(way, False)
        return tuple(patrol.visited)

    assert visits(0, 1) == visits(0, 1)
    assert len({visits(0, 1), visits(1, 1), visits(0, 2), visits(1, 2)}) == 4


@pytest.mark.parametrize(
    ("field", "value"), [("visits", 0), ("most_bumps", 0), ("limit", 0), ("start", 19)]
)
def test_bad_settings_of_a_patrol_are_refused(task_of, field, value):
    with pytest.raises(ValueError, match=f"{field}: expected"):
        patrol_of(task_of(LAB, random_walk(LAB, 0)), **{field: value})
