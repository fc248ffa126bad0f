import importlib.util
from pathlib import Path

import numpy as np
import pytest
import shapely

from jaxcell.bundled import bundled
from jaxcell.space import CellSpace, Workspace


pytestmark = pytest.mark.slow


SCRIPT = Path(__file__).parents[1] / "experiments" / "your_own_robot.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("your_own_robot", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def cells():
    return CellSpace.of(Workspace.load(bundled("maps/lab_a.json")), 1.0, 4)


@pytest.fixture(scope="module")
def walk(cells):
    """The transition matrix, one cell at a time."""
    free = shapely.union_all(cells.workspace.free_space)
    matrix = np.zeros((cells.size, cells.size))
    for z in range(cells.size):
        x, y, theta = (float(part) for part in cells.centre(z))
        end = round(x + np.cos(theta), 9), round(y + np.sin(theta), 9)
        if free.covers(shapely.LineString([(x, y), end])):
            matrix[z, cells.index(*end, theta)] = 1
        else:
            for k in range(cells.directions):
                matrix[z, cells.index(x, y, 2 * np.pi * k / cells.directions)] = 0.25
    return matrix


def test_the_chain_is_that_of_the_walls(script, cells, walk):
    np.testing.assert_allclose(script.random_bounce_map(cells).to_scipy().toarray(), walk)


def test_shares_and_times_solve_their_equations(script, cells, walk):
    goal = 5
    found = script.study(cells, goal)
    # Some positions can be left but never come back to, so the limit is that of a long walk.
    lazy = (walk + np.eye(cells.size)) / 2
    longrun = np.full(cells.size, 1 / cells.size) @ np.linalg.matrix_power(lazy, 1 << 20)
    share = longrun.reshape(4, -1).sum(axis=0)
    np.testing.assert_allclose(found.share, share, atol=1e-9)

    others = np.arange(cells.size) % cells.positions != goal
    steps = np.zeros(cells.size)
    inside = np.eye(others.sum()) - walk[np.ix_(others, others)]
    steps[others] = np.linalg.solve(inside, np.ones(others.sum()))
    np.testing.assert_allclose(found.steps_to_goal, steps.reshape(4, -1).mean(axis=0))
