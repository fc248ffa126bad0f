from pathlib import Path

import numpy as np
import pytest
import shapely

from jaxcell import bundled
from jaxcell.study.loading import load_study


SCRIPT = Path(__file__).parents[1] / "experiments" / "your_own_robot.py"
REFERENCE = f"{SCRIPT}:RandomBounce"
LAB = bundled("maps/lab_a.json")


@pytest.fixture(scope="module")
def asked():
    return load_study(REFERENCE)(map=LAB, directions=4, goal=5)


@pytest.fixture(scope="module")
def walk(asked):
    """The transition matrix, one cell at a time."""
    cells = asked.cells()
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


def test_shares_and_times_solve_their_equations(asked, walk):
    found, size = asked.run(), len(walk)
    # Some positions can be left but never come back to, so the limit is that of a long walk.
    lazy = (walk + np.eye(size)) / 2
    longrun = np.full(size, 1 / size) @ np.linalg.matrix_power(lazy, 1 << 20)
    np.testing.assert_allclose(found.share, longrun.reshape(4, -1).sum(axis=0), atol=1e-9)

    others = np.arange(size) % found.cells.positions != asked.goal
    steps = np.zeros(size)
    inside = np.eye(others.sum()) - walk[np.ix_(others, others)]
    steps[others] = np.linalg.solve(inside, np.ones(others.sum()))
    np.testing.assert_allclose(found.steps, steps.reshape(4, -1).mean(axis=0))
