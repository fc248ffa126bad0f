"""The symmetries of a room, whose places no robot without a compass can tell apart."""

import numpy as np
import shapely
from shapely import affinity

from ..space import Workspace


# Turns up to this order are looked for where the heading is not known.
_LARGEST_ORDER = 24
# Two shapes are the same if less than this share of their area differs.
_DIFFERENT = 1e-6


def alike_places(workspace: Workspace, headings: int | None = None) -> int:
    """Count the places, with headings, that a robot cannot tell apart whichever way it turns.

    A motion of the plane that carries the free space onto itself, or one piece of it onto another,
    carries each run of a robot onto a run of the same lengths. If robots start with one of a
    number of headings, turns must respect them. The count is 1 without a symmetry.

    A square room looks the same from four sides, unless the heading is known to be East or West:

        >>> from jaxcell import space, walls
        >>> square = space.Workspace([(0, 0), (3, 0), (3, 3), (0, 3)])
        >>> walls.alike_places(square), walls.alike_places(square, headings=2)
        (4, 2)
    """
    pieces = shapely.get_parts(workspace.free_space).tolist()
    if headings is None:
        turns = {k / order for order in range(1, _LARGEST_ORDER + 1) for k in range(order)}
    else:
        turns = {k / headings for k in range(headings)}
    return max(
        sum(_same(piece, other, 360 * turn) for other in pieces for turn in sorted(turns))
        for piece in pieces
    )


def _same(piece: shapely.Polygon, other: shapely.Polygon, degrees: float) -> bool:
    """Check whether a piece, turned about its centroid and moved, equals another piece."""
    if not np.isclose([piece.area, piece.length], [other.area, other.length]).all():
        return False
    to = np.subtract(other.centroid.coords[0], piece.centroid.coords[0])
    moved = affinity.translate(affinity.rotate(piece, degrees, "centroid"), *to)
    return bool(shapely.symmetric_difference(moved, other).area <= _DIFFERENT * piece.area)
