from . import estimates as estimates
from .box import Box as Box
from .cells import CellSpace as CellSpace, nearest_cell as nearest_cell
from .extent import Extent as Extent
from .motion import CELL_BY_CELL as CELL_BY_CELL, ENDPOINT as ENDPOINT, Motion as Motion
from .sight import visible_cells as visible_cells
from .slip import (
    Slip as Slip,
    felt_walls as felt_walls,
    free_ahead as free_ahead,
    slipping_step as slipping_step,
)
from .stencils import Stencil as Stencil, stencil as stencil
from .steps import free_steps as free_steps
from .strides import cell_strides as cell_strides, stride_legs as stride_legs
from .view import visibility_polygon as visibility_polygon
from .workspace import RoomLike as RoomLike, Workspace as Workspace
