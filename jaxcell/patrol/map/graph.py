import math

import numpy as np

from ...optimize import Graph
from ...space import CellSpace, Motion, free_steps


def cell_graph(cells: CellSpace) -> Graph:
    """Build the graph of the free cells, whose edges are straight free paths to neighbours.

    The vertices are the positions of the cell space (Alam 2018, section 4.3.2), at their centres.
    An edge joins a cell to one of its eight neighbours if the segment between the centres stays in
    the closed free space: the segment may touch the corner of an obstacle, but not pass between two
    obstacles that meet at a point.

    **Arguments:** the cell space of a map; its number of directions has no effect. **Returns:**
    [`jaxcell.optimize.Graph`][], which need not be connected.

    A room of 2 x 2 cells, in which robots may also move diagonally:

        >>> from jaxcell import patrol, space
        >>> room = space.Workspace([(0, 0), (2, 0), (2, 2), (0, 2)])
        >>> cells = space.CellSpace.of(room, 1.0, 1)
        >>> len(patrol.cell_graph(cells).edges)
        6
    """
    plane = CellSpace(cells.workspace, cells.cell, 8, cells.origin, cells.free)
    # Each edge is listed at one end: edges to the East, North, North East and North West.
    diagonal = Motion(math.sqrt(2) * plane.cell)
    there = np.concatenate([free_steps(plane)[[0, 2]], free_steps(plane, diagonal)[[1, 3]]])
    here = np.broadcast_to(np.arange(cells.positions), there.shape)
    edges = np.stack([here, there], axis=-1)[here != there]
    if edges.size == 0:
        raise ValueError(
            f"cells: none of the {cells.positions} free cells can be reached from another"
        )
    x, y, _ = cells.centre(np.arange(cells.positions))
    return Graph(edges, xy=np.stack([x, y], axis=1))
