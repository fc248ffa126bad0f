"""Drifters: objects that float in the water of an ocean current (Alam 2018, chapter 5).

The sea is cut into cells, in one or more layers. A drifter moves with the current of its layer, and
chooses at most its depth. `open_currents` reads currents: velocities towards the East (`u`) and
North (`v`) in metres per second, the mask of the water, and the sides of the cells in metres.
`Water` numbers the cells of a layer from 0, row by row, and `Flow` has its velocities in cells per
second. If the columns go round the Earth, the last column is beside the first. Squares without a
velocity are land or sea without data, an open edge; at the coast drifters are held, slip or strand.

**The map.** The *flow map* sends a point to its position after a time `dt`. By one step of Euler's
method (Eq. 5.3), with `F` the flow,

    z(dt) = z(0) + dt F(z(0))                         `advect`, and `flow_map` for all centres

or by the Runge-Kutta method. The *image* of a cell is the water cell nearest to the end of its
centre; by default `dt` is the `crossing_time`. In the source the current is not known exactly: with
probability `rho` the drifter goes to the image, and else to one of the other cells of a bounded
*disturbance set* `A(z)`,

    p(z, z') = rho for the image, (1 - rho) / (|A(z)| - 1) for the others     (Eq. 5.4, `drift_map`)

so that the sea is a finite Markov chain over cells, a generalized cell map `p(n + 1) = P p(n)` (Eq.
5.5). A `DriftStep` has the duration and the rules. The rules of the source spread drifters much
more than water does, and close the edges of the grid. `METHODS` has them, and rules that agree with
drifters: many points of each cell drift by the Runge-Kutta method over open edges, to an explicit
sink. `exit_shares` divides it among the ways out. `distances` compares a map with drifters in the
current as it changes with time, and `nearest_step` chooses `dt` for the least distance.
`drift_maps` maps each phase of a periodic current (`Flow.repeated`).

**Long-term behaviour** (Alg. 5.1), `long_term_behaviour`, apart from the solves in time
proportional to the number of edges:

- A *persistent group* is a closed communicating class of the chain: drifters that enter it stay.
    Every other cell is *transient* (Eq. 5.6). The *domicile* of a transient cell is the set of the
    persistent groups that it can reach: one (single-domicile) or several (multiple-domicile,
    Definition 5.4.2).
- The *absorption time* of a transient cell is the expected number of steps until its drifter is
    in a persistent group, `(I - Q) a = 1` with `Q` the part of `P` among transient cells (Eq. 5.7).
    Its *absorption probabilities* are those of ending in each group.

`beaching` adds a beach to each cell of a `coast`, on which drifters strand. A persistent group may
depend on a single drifter that leaves; `nearly_closed_sets` finds sets of cells that drifters
hardly leave in a day, with their leakage and its time scale.

`diagnose` and `group_counts` show whether groups can be trusted. `simulate_drifters` moves drifters
without cells, and `compare` compares the chain with them. `ftle` (the finite-time Lyapunov
exponent), `ridges` and `agreement` compare the borders of groups with coherent structures.

**Observed drifters.** `open_trajectories` reads positions of drifters or of the particles of a
model, and `count_moves` counts their moves in a time between cells: `boxes` of longitude and
latitude, or those of a model. The shares of moves are a chain, with the same questions; `bootstrap`
gives the sampling errors of the answers. `save_trajectories` writes positions for other programs.

**Deployment.** A *deployment* is a set of cells to release drifters in, so that in the long term
they reach every cell that any drifter can: one in each persistent group, and more that cover the
transient cells, `deployment_cells` (Alg. 5.2). `minimum_deployment` has the fewest cells from which
all may be visited, and `coverage_curve` the cells that fewer drifters visit. `visible_deployment`
is for cameras that see a disc of the sea bed (Eq. 5.1, 5.8, 5.9, Alg. 5.3).

**Regions.** `read_regions` finds the cells in polygons of a GeoJSON file, and an `Exchange` has the
shares of drifters that go between regions, and their residence times.

**Depth.** `Sea` combines layers. `reachable_by_layer` has the cells that drifters visit that go
down once (Alg. 5.4), `reachable_at_depth` those of drifters that go up and down at will, and
`reachable` those of any chain. A *voyage* brings a drifter to a goal by going up (-1), going down
(1), or drifting (0), chosen in each cell by the *policy* of a Markov decision process,
`voyage_model`, with

    r = 100 for a step that leads to the goal, else -1                               (Eq. 5.10)
    V(z) = max over u of the mean of r + g V(z'), with g the discount        (value iteration)

`discounted_voyage` solves it (Alg. 5.5) to a tolerance. `surest_voyage` has no discount: it most
likely arrives, and among such policies is the quickest. `simulate_voyages` follows drifters.

A `SeaDrift` has all results for the currents of a file, with a `Layer` for each depth and a
`SeaVoyage` for each policy; `jaxcell.study.Drift` computes it.

Most functions need 64-bit numbers, and so do the examples: set `JAX_ENABLE_X64=1`.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
