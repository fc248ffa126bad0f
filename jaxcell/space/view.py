import math
import numbers
from collections.abc import Sequence

import numpy as np
import shapely
from jaxtyping import Float

from ..base.wide import traced
from .cells import TOLERANCE
from .segments import cross
from .workspace import Workspace, coordinate_rounding, edges


def visibility_polygon(
    workspace: Workspace,
    point: Sequence[float | int] | Float[np.ndarray, "xy"],
    reach: float | int = math.inf,
) -> shapely.Polygon | shapely.MultiPolygon:
    """Compute the polygon that is visible from a point (Alam 2018, Eq. 4.1).

    It runs on the host, because shapely cuts the polygon.

    The rules of sight are the same as in [`visible_cells`][]: the radius of the robot is ignored.

    **Arguments:** a map, and a point and the range of sight in metres. The circle of the range is
    replaced by a polygon of 64 chords, whose area is 0.16 percent smaller.

    **Returns:** a polygon, with several pieces only if obstacles meet in the point.

    A part of an L-shaped room is hidden by its corner:

        >>> from jaxcell import space
        >>> room = space.Workspace([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)])
        >>> round(space.visibility_polygon(room, (1.5, 0.5)).area, 9)
        2.5
    """
    reach = check_reach(reach)
    here = np.array(point, float)
    if here.shape != (2,) or not np.isfinite(here).all():
        raise ValueError(f"point: expected two finite numbers (x, y), got {point!r}")
    size = float(np.hypot(*np.ptp(workspace.boundary, axis=0)))
    if workspace.environment.distance(shapely.Point(here)) > TOLERANCE * size:
        raise ValueError(
            f"point: ({here[0]:g}, {here[1]:g}) lies in an obstacle or outside the boundary"
        )
    # The circle holds the whole segment to each of its points, so it replaces the range.
    circle = shapely.Point(0, 0).buffer(min(reach, 2 * size), quad_segs=16)
    around = shapely.transform(workspace.environment, lambda xy: xy - here)
    walls = edges(shapely.intersection(around, circle))
    if not len(walls):
        return shapely.Polygon()
    ring = _star(walls, TOLERANCE * size)
    polygon = shapely.make_valid(
        shapely.Polygon(ring + here), method="structure", keep_collapsed=False
    )
    # Spikes as thin as a rounding error would make the polygon invalid again.
    rounding = coordinate_rounding(workspace.boundary, workspace.obstacles)
    return shapely.set_precision(polygon, rounding)


def _star(
    walls: Float[np.ndarray, "walls 3 2"], tolerance: float
) -> Float[np.ndarray, "corners 2"]:
    """Trace the outline of the area that is visible from the origin.

    Between the directions of two successive corners of walls, all rays end on a single wall.
    """
    a, b = walls[:, 1], walls[:, 2]
    angle = np.unique(np.arctan2(a[:, 1], a[:, 0]))
    opens, closes = angle, np.append(angle[1:], angle[0] + 2 * np.pi)
    opens, closes = (x[closes - opens > 1e-12] for x in (opens, closes))
    middle, *ends = (
        np.stack([np.cos(x), np.sin(x)], axis=1) for x in ((opens + closes) / 2, opens, closes)
    )
    side = cross(a, b)
    side[np.abs(side) <= tolerance * np.hypot(*(b - a).T)] = 0
    across = cross(middle[:, None], a) * cross(middle[:, None], b) <= 0
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = side / cross(middle[:, None], b - a)
    distance[~(across & (distance > 0))] = np.inf
    nearest = distance.argmin(axis=1)
    # Sight starts in an obstacle if it meets no wall, or comes from behind the first wall.
    seen = np.isfinite(distance.min(axis=1)) & (side[nearest] > 0)
    a, b = a[nearest], b[nearest]
    ring = np.zeros((len(middle), 2, 2))
    for corner, end in zip(ring.swapaxes(0, 1), ends, strict=True):
        from_a, to_b = cross(a, end), cross(end, b)
        share = np.clip(from_a / np.where(seen, from_a + to_b, 1.0), 0, 1)[:, None]
        corner[seen] = (a + share * (b - a))[seen]
    return ring.reshape(-1, 2)


def check_reach(reach: float | int) -> float:
    if not (traced(reach) or (isinstance(reach, numbers.Real) and reach > 0)):
        raise ValueError(f"reach: expected more than 0 m, got {reach!r}")
    return float(reach)
