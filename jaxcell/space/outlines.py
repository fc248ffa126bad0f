"""Cut polygons whose edges are parallel to the axes out of each other, on a grid."""

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..base.memory import check


# Steps to the East, North, West and South as (row, column), and the corner (row, column) of a
# square at which the edge that runs in this direction around it ends.
_STEPS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])
_ENDS = np.array([(0, 1), (1, 1), (1, 0), (0, 0)])
# Most squares of the grid for each vertex. For more, general polygons are faster.
_MOST_SQUARES = 256
# Bytes for each square and each vertex, measured.
_SQUARE, _VERTEX = 30, 320


def cut_along_axes(
    polygons: np.ndarray, rounding: float
) -> shapely.Polygon | shapely.MultiPolygon | None:
    """Compute the first polygon minus the others, if all edges are parallel to the axes.

    The polygons have no holes. Vertices are rounded to multiples of `rounding`.

    **Returns:** `None` if an edge is oblique, or if general polygons are faster because vertices
    have many different coordinates.

    **Raises:** `MemoryError` if the outlines do not fit in the free memory.
    """
    points, polygon = shapely.get_coordinates(shapely.orient_polygons(polygons), return_index=True)
    scale = np.rint(1 / rounding)
    points = np.rint(points * scale) / scale
    edge = np.flatnonzero(polygon[1:] == polygon[:-1])
    upright, level = (points[edge] == points[edge + 1]).T
    if not (upright | level).all():
        return None
    (xs, x), (ys, y) = (np.unique(axis, return_inverse=True) for axis in points.T)
    squares = xs.size * ys.size
    if squares > _MOST_SQUARES * len(points):
        return None
    check(
        _SQUARE * squares + _VERTEX * len(points),
        f"obstacles: the outline of {len(polygons) - 1:,} obstacles",
        "expected fewer obstacles",
    )
    # Upward edges begin to add, downward edges end it: sums count the polygons over each square.
    edge = edge[upright]
    weight = np.where(polygon[edge] == 0, 1, -1)
    count = np.zeros((ys.size, xs.size), np.int32)
    np.add.at(count, (y[edge + 1], x[edge]), weight)
    np.add.at(count, (y[edge], x[edge]), -weight)
    for axis in (0, 1):
        np.cumsum(count, axis=axis, out=count)
    return free_polygons(count[:-1, :-1] == 1, xs, ys)


def free_polygons(
    free: Bool[np.ndarray, "rows columns"],
    xs: Float[np.ndarray, "_"],
    ys: Float[np.ndarray, "_"],
) -> shapely.Polygon | shapely.MultiPolygon:
    """Trace the outlines of the free squares of a grid, given the coordinates of its lines.

    Squares that meet only in a corner are not connected. No vertex lies between collinear edges.
    """
    columns = free.shape[1] + 2
    part = np.pad(_parts(free), 1).ravel()
    steps = _STEPS @ (columns, 1)
    inside = np.flatnonzero(part)
    # An edge is given by its direction and by the square to its left.
    at_edge = np.stack([part[inside + step] != part[inside] for step in np.roll(steps, 1)])
    way, at = np.nonzero(at_edge)
    square = inside[at]
    left = square + steps[way]
    right = left + steps[way - 1]
    # Squares of one part that meet in a corner are connected around it, so their outline turns
    # right there: no outline meets itself.
    turn = np.where(part[left] == part[square], 0, 1)
    turn[part[right] == part[square]] = -1
    goal = np.choose(turn + 1, (right, left, square))
    keys = way * part.size + square
    following = np.searchsorted(keys, (way + turn) % 4 * part.size + goal).tolist()
    # An outline may have 10^6 edges: a loop is faster than pointer doubling. Its first edge runs to
    # the East, and that of a part's outer outline is found before those of holes.
    walk: list[int] = []
    starts: list[int] = []
    for start in range(np.count_nonzero(way == 0)):
        edge = start
        if following[edge] >= 0:
            starts.append(len(walk))
        while following[edge] >= 0:
            walk.append(edge)
            following[edge], edge = -1, following[edge]
    order = np.array(walk, int)
    outline = np.repeat(np.arange(len(starts)), np.diff([*starts, len(walk)]))
    corner = turn[order] != 0
    along = order[corner]
    row, column = np.stack(np.divmod(square[along], columns)) - 1 + _ENDS[way[along]].T
    rings = shapely.linearrings(xs[column], ys[row], indices=outline[corner])
    of = part[square[order[starts]]] - 1
    by_part = np.argsort(of, kind="stable")
    parts = shapely.polygons(rings[by_part], indices=of[by_part])
    return shapely.normalize(parts[0] if len(parts) == 1 else shapely.multipolygons(parts))


def _parts(free: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, "rows columns"]:
    """Number the connected parts of the free squares from 1, in the order of their first squares.

    Other squares have 0. Robots need this without SciPy.
    """
    number = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)
    sides = (number[:, :-1], number[:, 1:]), (number[:-1], number[1:])
    one, other = np.concatenate([np.stack([a.ravel(), b.ravel()]) for a, b in sides], axis=1)
    both = (one >= 0) & (other >= 0)
    one, other = one[both], other[both]
    # Each square leads to the first square that is known to be in its part.
    first = np.arange(np.count_nonzero(free))
    while one.size:
        np.minimum.at(first, np.maximum(one, other), np.minimum(one, other))
        while (first[first] != first).any():
            first = first[first]
        one, other = first[one], first[other]
        one, other = one[one != other], other[one != other]
    part = np.zeros(free.shape, int)
    part[free] = np.unique(first, return_inverse=True)[1] + 1
    return part
