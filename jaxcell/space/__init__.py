"""The state space: maps, and their cells.

A robot that can be at any pose of the plane has the state space `X = E x S^1`, where `E` is the
free space: the boundary minus the obstacles, less a margin of the robot's radius. Cell mapping cuts
`X` into cells and follows one representative, the centre, of each (Alam 2018, section 2.3; Hsu
1980).

**The map.** With `W` the polygon of the boundary and `O` the union of the obstacles, the
*environment* `F` is the closure of `W` minus `O`, where a point may be. The centre of a disc robot
of radius `r` may be in

    E = { p in F : no wall is nearer to p than r },

as in Eq. 2.1 and 3.1 but with its edge: a robot may touch a wall. Coordinates are metres, and
angles are radians, counter-clockwise from the x axis (East).

**The cells.** Squares of side `cell` cover the bounding box of `W`, from its lower left corner. A
square is free if its centre lies in `E`; the `N_E` free squares are the *positions*, counted row by
row from the bottom left, x fastest. With `N_S` *directions*, `theta_k = 2 pi k / N_S`, the cells
are

    z = k N_E + position,     0 <= z < N = N_E N_S     (the source counts from 1).

A configuration belongs to the square that holds its point (on an edge, to the upper or right
square) and to the nearest direction. Comparisons are made in units of a cell to 1e-9, so that cells
are the same on every platform.

**A step** of length `s` from a centre `p` ends at `p + s (cos theta_k, sin theta_k)`. It is
possible if its end lies in a free square and in `E`, and, if collisions are *swept*, if the whole
step lies in `E`. On a grid, where walls run along squares, a step is a *stencil* of relative
squares, the same for every start, and directions with the same stencil share a *way*. Otherwise
each wall within reach of a centre is tested. So the moves of all cells cost `O(N_E)` per way, or
`O(N_S)` per pair of a centre and a wall near it.

**Sight.** From a point `p` with reach `l` one sees (Eq. 4.1)

    V(p) = { q in F : the segment from p to q stays in F, |p - q| <= l },

and a cell is *wholly visible* if the free part of its square is in `V(p)` (Alg. 4.3).

`nearest_cell`, `stencil`, `free_steps`, `cell_strides`, `stride_legs`; `visible_cells`,
`visible_centres`, `visibility_polygon`; `free_ahead`, `felt_walls`, `slipping_step`.

No part of this package imports JAX.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
