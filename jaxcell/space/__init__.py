"""State spaces: maps of rooms, and their division into cells.

A pose of a robot in the plane is a point of the state space `X = E x S^1`, where `E` is the free
space: the boundary minus the obstacles, shrunk by the radius of the robot. Cell mapping divides
`X` into cells, and follows the centre of each cell (Alam 2018, section 2.3; Hsu 1980).

**The map.** With `W` the polygon of the boundary and `O` the union of the obstacles, the
*environment* `F` is the closure of `W` minus `O`. The centre of a disc robot of radius `r` may be
in

    E = { p in F : no wall is nearer to p than r },

the set of Eq. 2.1 and 3.1 including its edge: a robot may touch a wall. Coordinates are metres, and
angles are radians, counter-clockwise from the x axis (East).

**The cells.** Squares of side `cell` cover the bounding box of `W`, from its lower left corner. A
square is free if its centre lies in `E`; the `N_E` free squares are the *positions*, counted row by
row from the bottom left, x fastest. With `N_S` *directions*, `theta_k = 2 pi k / N_S`, the cells
are

    z = k N_E + position,     0 <= z < N = N_E N_S     (from 1 in the dissertation).

A configuration belongs to the square that contains its point (on an edge, to the upper or right
square) and to the nearest direction. Coordinates are compared with a tolerance of 1e-9 of a cell,
so that cells are the same on every platform.

**A step** of length `s` from a centre `p` ends at `p + s (cos theta_k, sin theta_k)`. It is
possible if its end lies in a free square and in `E`, and, if collisions are *swept*, if the whole
step lies in `E`. If all walls run along edges of squares, the squares that must be free for a step
are the same for every start, relative to the start: they are its *stencil*. Directions with the
same stencil form a class, called a *way*, and the moves of all cells take a time `O(N_E)` per way.
If some wall does not run along edges, each wall within reach of a centre is tested instead, in a
time `O(N_S)` per pair of a centre and a wall near it.

**Sight.** The points that are visible from a point `p` within a range `l` are (Eq. 4.1)

    V(p) = { q in F : the segment from p to q stays in F, |p - q| <= l },

and a cell is *wholly visible* if the free part of its square is in `V(p)` (Alg. 4.3).

`nearest_cell` finds the cells of points off the map. `stencil` and `free_steps` find the ends of
steps. `cell_strides` and `stride_legs` compute the path of a robot to the centre of the next cell.
`visible_cells` and `visibility_polygon` compute sight. `felt_walls`, `free_ahead` and
`slipping_step` simulate a robot that slips and bumps. No part of this package imports JAX.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
