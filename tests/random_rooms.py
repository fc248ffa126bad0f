"""Random obstacles and rooms for property tests of maps."""

import math

import numpy as np
import shapely
from hypothesis import reject, strategies as st

from jaxcell.space import CellSpace, Workspace


def grids(free, shape):
    """Grids of a shape with a number of free squares, on which compiled programs depend."""
    squares = [True] * free + [False] * (math.prod(shape) - free)
    return st.permutations(squares).map(lambda drawn: np.reshape(drawn, shape))


# Numbers with which an obstacle hides nothing, or no sliver.
HUNDREDTHS = st.integers(0, 600).map(lambda n: n / 100)


@st.composite
def slanted_rooms(draw, number=HUNDREDTHS, radii=(0.0,)):
    """A boundary, up to four obstacles, which may overlap or cross the boundary, and a radius."""
    obstacles = []
    for _ in range(draw(st.integers(0, 4))):
        corners = draw(st.lists(st.tuples(number, number), min_size=3, max_size=5))
        hull = shapely.MultiPoint(corners).convex_hull
        if hull.geom_type == "Polygon" and hull.area > 0.01:
            obstacles.append(shapely.get_coordinates(hull)[:-1])
    return [(0, 0), (6, 0), (5.5, 4), (0.2, 5)], obstacles, draw(st.sampled_from(radii))


def cells_of(room, cell, directions=1):
    """The cells of a drawn room; a room without free cells is rejected."""
    try:
        return CellSpace.of(Workspace(*room), cell, directions)
    except ValueError:
        reject()
