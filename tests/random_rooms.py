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


@st.composite
def slanted_obstacles(draw, number):
    """Up to four convex polygons with coordinates of the given strategy, which may overlap."""
    obstacles = []
    for _ in range(draw(st.integers(0, 4))):
        corners = draw(st.lists(st.tuples(number, number), min_size=3, max_size=5))
        hull = shapely.MultiPoint(corners).convex_hull
        if hull.geom_type == "Polygon" and hull.area > 0.01:
            obstacles.append(shapely.get_coordinates(hull)[:-1])
    return obstacles


# Numbers with which an obstacle hides nothing, or no sliver.
HUNDREDTHS = st.integers(0, 600).map(lambda n: n / 100)


@st.composite
def slanted_rooms(draw, number=HUNDREDTHS, radii=(0.0,)):
    """A boundary, obstacles and a radius; slanted obstacles may overlap, or cross the boundary."""
    obstacles = draw(slanted_obstacles(number))
    return [(0, 0), (6, 0), (5.5, 4), (0.2, 5)], obstacles, draw(st.sampled_from(radii))


def cells_of(room, cell, directions=1):
    """The cells of a drawn room; a room without free cells is rejected."""
    try:
        return CellSpace.of(Workspace(*room), cell, directions)
    except ValueError:
        reject()


def slanted_room(seed: int) -> Workspace:
    """A room in one piece, some 8 m wide, with a slanted boundary and up to four obstacles."""
    rng = np.random.default_rng(seed)
    while True:
        angles = (np.arange(7) + rng.uniform(0, 0.8, 7)) * math.tau / 7
        boundary = rng.uniform(2, 5, (7, 1)) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        obstacles = []
        for centre in rng.uniform(-3, 3, (rng.integers(5), 2)):
            corners = centre + rng.uniform(-0.8, 0.8, (5, 2))
            obstacles.append(shapely.get_coordinates(shapely.MultiPoint(corners).convex_hull)[:-1])
        try:
            room = Workspace(boundary, obstacles)
        except ValueError:  # an obstacle wholly outside
            continue
        if room.pieces == 1:
            return room
