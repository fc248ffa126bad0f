"""Random obstacles for property tests of maps."""

import shapely
from hypothesis import strategies as st


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
