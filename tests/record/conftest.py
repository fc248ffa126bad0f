import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from seas import drift_of

from jaxcell import bundled, drift
from jaxcell.bounce import BounceGroups, Localized, bounce_map, localization_filter, localize
from jaxcell.space import CellSpace, Motion, Workspace


@dataclasses.dataclass(frozen=True)
class Case:
    """A bounce map with all that is made of it."""

    cells: CellSpace
    bounce: float
    collision: str = "swept"

    def __post_init__(self):
        options = {"motion": Motion(collision=self.collision)}
        map = bounce_map(self.cells, self.bounce, **options)
        values = {
            "map": map,
            "groups": BounceGroups.of(self.cells, self.bounce, **options),
            "filter": localization_filter(map, metadata={"map": "a test"}),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def localize(self, start, filter=None):
        return localize(self.map, filter or self.filter, start)

    def localized(self, start, filter=None):
        """The filter, and the run from a cell, as a result."""
        filter, motion = filter or self.filter, Motion(collision=self.collision)
        return Localized(filter, self.cells, motion, self.bounce, self.localize(start, filter))

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
    return Case(cells, math.radians(45), "endpoint")


@pytest.fixture(scope="session")
def angles(lab):
    """The groups of three bouncing angles in the lab map."""
    return BounceGroups.of(
        lab.cells, np.deg2rad([45, 90, 135]), motion=Motion(collision=lab.collision)
    )


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
