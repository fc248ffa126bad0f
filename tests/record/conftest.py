import math
from types import SimpleNamespace

import numpy as np
import pytest
from seas import drift_of

from jaxcell import bundled, drift
from jaxcell.bounce import BounceGroups, Localized, bounce_map, localization_filter, localize
from jaxcell.bounce.coverage import coverage_policy
from jaxcell.space import CELL_BY_CELL, ENDPOINT, CellSpace, Workspace


class Case:
    """A bounce map, with its groups and its filter."""

    def __init__(self, cells, bounce, motion=CELL_BY_CELL):
        self.cells, self.bounce, self.motion = cells, bounce, motion
        self.map = bounce_map(cells, bounce, motion=motion)
        self.groups = BounceGroups.of(cells, bounce, motion=motion)
        self.filter = localization_filter(self.map, metadata={"map": "a test"})

    def localize(self, start):
        return localize(self.map, self.filter, start)

    def localized(self, start):
        """The filter, and the run from a cell, as a result."""
        run = self.localize(start)
        return Localized(self.filter, self.cells, self.motion, self.bounce, run)

    def host(self):
        """The groups and the images of all cells in a row."""
        arrays = {name: getattr(self.groups, name).ravel() for name in ("group", "step", "period")}
        return SimpleNamespace(**arrays, image=np.asarray(self.map.image))


LAB = np.array(["........", ".##.###.", ".##.###.", "....###."])
FREE = np.array([[square == "." for square in row] for row in LAB[::-1]])


@pytest.fixture(scope="session")
def lab():
    """The lab map of Alam 2018, Figure 2.8(a), as a grid that is not at the origin."""
    cells = CellSpace.of_grid(FREE, 8, cell=0.5, origin=(-1.0, 2.0))
    return Case(cells, math.radians(45), ENDPOINT)


@pytest.fixture(scope="session")
def angles(lab):
    """The groups of three bouncing angles in the lab map."""
    return BounceGroups.of(lab.cells, np.deg2rad([45, 90, 135]), motion=lab.motion)


@pytest.fixture(scope="session")
def policy(lab):
    """The mixture of three imprecise bouncing policies that covers the lab."""
    bounces = np.radians([45, 90, 135])
    return coverage_policy(lab.cells, bounces, math.pi / 4, 0.6, motion=ENDPOINT)


@pytest.fixture(scope="session")
def hall():
    """A hall for a disc robot with more cells than are drawn as arrows, and a large filter."""
    boundary = [[0, 0], [6, 0], [6, 4], [0, 4]]
    obstacles = [[[1, 1], [2, 1], [2, 2.2]], [[4, 0], [5, 0], [5, 1.5], [4, 1.5]]]
    workspace = Workspace(boundary, obstacles, robot_radius=0.15, name="hall")
    return Case(CellSpace.of(workspace, 0.25, 24), math.radians(90))


@pytest.fixture(scope="module")
def gyres(few_drifters):
    """The drift in the bundled sea, with a goal at 5 m in the western basin."""
    step, goal = drift.DriftStep(3400), 538 + 167
    currents = drift.open_currents(bundled("gyres"))
    return drift_of(currents, step, start=317, goal=goal, reach=6000.0)
