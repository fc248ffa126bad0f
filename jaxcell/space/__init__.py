"""The state space: maps, and the cells that they are cut into.

A robot that can be at any pose of the plane has the state space `X = E x S^1`, where `E` is the
free space: the boundary minus the obstacles, less a margin of the robot's radius. Cell mapping cuts
`X` into cells and follows one representative, the centre, of each (Alam 2018, section 2.3; Hsu
1980).

`Workspace` is the map, in metres. `CellSpace` is its cells, which of them a step leads to, and
which are in sight of which. No part of this package imports JAX.
"""

from .cells import CellSpace as CellSpace
from .segments import free_steps as free_steps
from .sight import visible_cells as visible_cells, visible_centres as visible_centres
from .stencil import Stencil as Stencil, line_orders as line_orders, stencil as stencil
from .view import visibility_polygon as visibility_polygon
from .workspace import Workspace as Workspace
