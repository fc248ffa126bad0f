"""Dynamics of any map or vector field on cells: attractors, basins, noise and continuation.

A map or a vector field, written as a single JAX function, is discretised on the cells of a
[`Box`][jaxcell.space.Box] of any number of dimensions: the images of cell centres define a simple
map, and the images of points inside cells, with noise, a generalized map (Hsu 1980, 1981, 1987).
The analyses of bouncing robots and currents then apply to it.

    image of a cell z      the cell of F(centre of z), or a sink: outside of the box, or not finite
    periodic group         a set of cells that form a cycle of the simple map
    attractor              the set on which orbits of F that begin in periodic groups settle
    basin of an attractor  the cells that lead to the groups whose orbits settle on it

**Maps.** `F` is any function `map(x, params)`; `flow`, `strobe` and `section` build a map from a
field with Runge-Kutta steps of fixed length: over a given time, over one period of a forcing, or to
the next crossing of a surface. A flow may follow the centre of each cell until it is several cells
away, because cells with a slow flow would otherwise be their own images, like equilibria.

**Accuracy.** The centre of a cell stands for the whole cell, which is too inaccurate near
attractors and saddles: a limit cycle becomes dozens of periodic groups. So attractors are found by
following orbits of the map itself from the groups. Results report three shares that should be
small: cells that are their own images, images that differ with steps of half the length, and cells
that lead to a saddle. A map that preserves volumes has groups but no attractors: results then
report that orbits had not settled, or that most cells are periodic.

**In a compiled program.** Maps, and parameters and noise in `chain` and `diffusion`, may be traced
by `jit`, `vmap` and `grad`; parameters in `images` and boxes in `enclose` by `jit` and `vmap`. The
other functions run on the host.

`images`, `basins`, `stored_basins`, `foretold`, `continuation` and `chain` map the cells of a box,
and `moved` estimates the errors of a chain. `diffusion` builds the chain of a stochastic
differential equation, and `escape` computes how long a noisy system stays in a region;
`exit_times` computes the mean time for many values of a parameter, with its derivative.
`refined`, `edge_states`, `unstable_set`, `relative_attractor`, `morse_sets` and `enclose` find
boundaries and invariant sets more exactly. `basin_stability`, `basin_entropy`, `wada`, `overlap`,
`uncertainty_exponent` and `minimal_critical_shock` measure basins.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
