"""Count the places of a symmetric room that a robot without a compass cannot distinguish."""

import numpy as np
import shapely
from shapely import affinity

from ..space import Workspace


# The largest order of the rotations that are tried if the heading is not known.
_LARGEST_ORDER = 24
# The largest share of the area by which two equal shapes may differ.
_DIFFERENT = 1e-6


def alike_places(workspace: Workspace, headings: int | None = None) -> int:
    """Count the poses in a room that look the same to a robot, whatever turns it makes.

    A rotation of the free space onto itself, or of a connected part of it onto another part, maps
    each run of a robot to a run of the same length. If `headings` is the number of headings that
    robots may start with, only rotations between these headings count. The count of a room without
    a symmetry is 1.

    A square room looks the same in four poses, or in two if the heading is East or West:

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
    """Check whether a polygon, rotated about its centroid and moved, equals another one."""
    if not np.isclose([piece.area, piece.length], [other.area, other.length]).all():
        return False
    to = np.subtract(other.centroid.coords[0], piece.centroid.coords[0])
    moved = affinity.translate(affinity.rotate(piece, degrees, "centroid"), *to)
    return bool(shapely.symmetric_difference(moved, other).area <= _DIFFERENT * piece.area)
