import math
import time

import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st

from jaxcell import bundled
from jaxcell.space import CellSpace, Workspace
from jaxcell.space.occupancy import rasterise


# Coordinates of few values, so that walls often run through centres and along edges of squares.
POINTS = st.tuples(*[st.integers(0, 40).map(lambda n: n / 8)] * 2)
DISCS = st.tuples(POINTS, st.sampled_from([0.3, 0.5, 1.0])).map(
    lambda disc: shapely.Point(disc[0]).buffer(disc[1], quad_segs=3)
)
SHAPES = DISCS | st.lists(POINTS, min_size=4, max_size=9).map(shapely.MultiPoint).map(
    shapely.convex_hull
)


@given(st.lists(SHAPES, min_size=1, max_size=3), st.lists(SHAPES, max_size=3))
@pytest.mark.parametrize("cell", [0.25, 0.3])
def test_squares_are_free_whose_centres_are(cell, parts, holes):
    environment = shapely.difference(shapely.union_all(parts), shapely.union_all(holes))
    # On a grid spikes without width are gone, which differences leave and no map has.
    environment = shapely.set_precision(shapely.set_precision(environment, 1e-6), 0)
    environment = shapely.union_all(
        [part for part in shapely.get_parts(environment) if part.area > 1e-6]
    )
    blocked = rasterise(environment, (0.0, 0.0, 5.0, 4.0), cell)
    x, y = ((np.arange(math.ceil(size / cell - 1e-9)) + 0.5) * cell for size in (5, 4))
    centres = shapely.points(*np.meshgrid(x, y))
    distance = shapely.distance(environment, centres)
    # Cases that rounding decides are left open.
    sure = (distance == 0) | (distance > 1e-6)
    np.testing.assert_array_equal(blocked[sure], distance[sure] > 0)


def test_small_squares_cost_what_their_walls_cost():
    lab = Workspace.load(bundled("maps/lab_a.json"))
    began = time.process_time()
    cells = CellSpace.of(lab, 0.002, 8)
    # Asked square by square, it takes some 10 s.
    assert time.process_time() - began < 2
    assert cells.positions == 19 * 500**2
