"""Any dynamics on the same cells: attractors, basins, noise and continuation.

A map or a vector field, written as one function of JAX, is taken to the cells of a
[`Box`][jaxcell.space.Box] of any number of dimensions: the image of the centre of each cell makes a
simple map, and images of points inside it, with noise, a generalized one (Hsu 1980, 1981, 1987).
What bouncing robots and currents are asked is then asked of it.

    image of a cell z      the cell of F(centre of z), or one of two sinks
    attractor              what orbits from the periodic groups settle on
    basin of an attractor  the cells that lead to groups from which orbits settle on it

**Maps.** `F` is any function `map(x, params)`; `flow`, `strobe`, `section` and `impacts` make one
of a field by Runge-Kutta steps of fixed length: over a time, over a period of a force, to the next
crossing of a surface, and with resets. A flow may have a time of its own in each cell, until its
image is some cells away, since a cell that moves by less than its own size becomes an equilibrium.

**What to trust.** Centres of cells stand for all of a cell, which is wrong near attractors and
saddles: a limit cycle makes dozens of periodic groups. So attractors are found by following the map
itself from the groups, and results say which share of cells are their own images, which images
differ with steps of half the length, and which cells lead to a saddle. A map that keeps volumes has
groups and no attractors: results then say that orbits had not settled, or that most cells are
periodic.

What gives which:

- `flow`, `strobe`, `section`, `impacts`: a `Map`; any function of JAX is one.
- `images`: the image of every cell, in chunks.
- `basins`: attractors, basins and steps, a `Basins`. `continuation`: the same along parameters,
    matched, a `Continuation`.
- `chain`: a [`jaxcell.mapping.Chain`][], by samples and noise.
- `basin_stability`, `convergence_pace`, `minimal_critical_shock`, `noncritical_shocks`,
    `basin_entropy`, `uncertainty_exponent`, `wada`, `overlap`: numbers about basins.
- `refined`: basins whose boundaries are in finer cells; `relative_attractor`: a cover of what is in
    a box for ever, by finer and finer cells.
- `unstable_set`, `morse_sets`: what cells reach, and what recurs, by images of points of each cell.
- `System`, `systems`: a map with its box, and six to start from.
"""

import lazy_loader


__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
