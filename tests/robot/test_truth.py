"""Without noise, robots follow the model on every map.

Steps and plans use the driver. Filters use it on two maps, and drive the body directly on others.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from wheels import (
    MAPS,
    bounce_filter,
    bounce_tables,
    map_cells,
    orbit,
    place_of,
    pose_of,
    walker_in,
)

from jaxcell import examples
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.followers import FilterFollower, run_follower
from jaxcell.robot.plan import plan_outcome, run_plan
from jaxcell.robot.walker import Drivable
from jaxcell.space import CellSpace, free_steps


# The bouncing angle of each map, and the sizes of its cells if they differ from those of the map.
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
# A step in this map takes a minute of the time of the robot.
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
def test_a_robot_bounces_as_in_the_model(name):
    cells, bounce = cells_of(name), CASES[name][0]
    image, bumped = bounce_tables(cells, bounce)
    # The robot starts one step before a bump.
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
    (cell,) = starts_in(cells, 1)
    walker, body = walker_in(cells, cell, robot=robot_for(name))
    outcome = run_follower(
        walker, FilterFollower(filter, "cycle", confirm=0), [math.radians(bounce)], limit=300
    )
    observed, visited = orbit(cells, bounce, cell, len(outcome.observations))
    assert outcome.observations == observed
    assert outcome.result == "localized"
    assert place_of(cells, body) == visited[-1]
    assert visited[-1] in outcome.cells


def plan_from(cells: CellSpace, cell: int, count: int) -> tuple[list[float], int]:
    """A plan that turns by random angles at bumps, and its last cell."""
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
    outcome = run_plan(walker, actions)
    assert outcome == plan_outcome(actions, outcome.observations)
    assert outcome.result == "arrived"
    assert place_of(cells, body) == goal


def test_a_plan_that_meets_another_map_is_refuted():
    """In a corridor of three cells, the third step bumps."""
    for actions, observations, text in [
        ([0.0, 0.0, 0.0], "001", "action 2 of 3: the robot bumped where the plan has free space"),
        ([1.0, 0.0, 0.0], "0", "action 0 of 3: the robot met no wall where the plan has one"),
    ]:
        outcome = run_plan(examples.walker(), actions)
        assert outcome.result == "refuted"
        assert outcome.reason == f"{text}; the robot observed {observations}"
        assert plan_outcome(actions, "").result == "unfinished"
