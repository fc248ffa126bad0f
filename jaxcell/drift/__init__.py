"""Drifters: objects that float in the water of an ocean current (Alam 2018, chapter 5).

The sea is divided into cells, in one or more layers. A drifter moves with the current of its layer;
it controls only its depth. `open_currents` reads currents: velocities towards the East (`u`) and
North (`v`) in metres per second, the mask of the water, and the sides of the cells in metres.
`Water` numbers the cells of a layer from 0, row by row, and `Flow` has the velocities in cells per
second. If the grid goes round the Earth, the last column is beside the first. Grid squares without
a velocity are land, or sea without data, which is an open edge. At coasts drifters stay or strand.

**The map.** The *flow map* sends a point to its position after a time `dt`. With one step of
Euler's method (Eq. 5.3), and `F` the flow,

    z(dt) = z(0) + dt F(z(0))                         `advect`, and `flow_map` for all centres

or with the Runge-Kutta method. The *image* of a cell is the water cell nearest to the position of
its centre after `dt`; the default of `dt` is the `crossing_time`. In the dissertation the current
is uncertain: with probability `rho` the drifter goes to the image, and otherwise to one of the
other cells of a bounded *disturbance set* `A(z)`,

    p(z, z') = rho for the image, (1 - rho) / (|A(z)| - 1) for the others     (Eq. 5.4, `drift_map`)

which makes the sea a finite Markov chain over cells, a generalized cell map `p(n + 1) = P p(n)`
(Eq. 5.5). A `DriftStep` has the duration and the rules of a step; `METHODS` has the rules of the
dissertation, and rules that agree better with simulated drifters. `exit_shares` computes the
probability of leaving the map by each exit. `drift_maps` computes a map for each phase of a
periodic current (`Flow.repeated`). The phase is the point in the period at which a step begins.

**Accuracy.** A `Replay` simulates drifters in the current as it changes with time. `distances`
compares a map with these drifters, and `distances_by_cell` shows for which cells the map is wrong.
Drifters that are released everywhere stay nearly uniform whatever the map does;
`release_distance` compares the map with drifters that are released in one cell, such as one of the
`typical_cells`.
A `MarkovTest` is the Chapman-Kolmogorov test on sets of cells. `nearest_step` chooses the `dt`
whose map agrees best with the drifters up to a time of interest, by default `asked_hours`.

**Long-term behaviour** (Alg. 5.1). `long_term_behaviour` finds, in time proportional to the number
of edges plus the time of linear solves:

- A *persistent group* is a closed communicating class of the chain: drifters that enter it stay.
    Every other cell is *transient* (Eq. 5.6). The *domicile* of a transient cell is the set of the
    persistent groups that it can reach: one (single-domicile) or several (multiple-domicile,
    Definition 5.4.2).
- The *absorption time* of a transient cell is the expected number of steps until its drifter is
    in a persistent group, `(I - Q) a = 1` with `Q` the part of `P` among transient cells (Eq. 5.7).
    Its *absorption probabilities* are the probabilities of ending in each group.

`beaching` adds to each cell of a `coast` a beach on which drifters strand. A set of cells is not a
persistent group if even one drifter can leave it. `nearly_closed_sets` therefore finds sets that
few drifters leave in a time; `closed_sets_seconds` foretells how long the search takes.
`coherent_sets` finds water that moves together, such as vortices.

`diagnose` and `group_counts` show whether groups can be trusted. `simulate_drifters` moves drifters
without cells, and `compare` compares the chain with them. `ftle` (the finite-time Lyapunov
exponent), `ridges` and `agreement` compare the borders of groups with coherent structures.

**A release.** `Released` has the drifters of one release, simulated in the current as it changes:
probabilities with exact intervals, arrivals and beaching, beside what the chain gives for them.
`Dropped` has the places from which a number of such drifters visit the most cells in a time.

**Observed drifters.** `open_trajectories` reads positions of drifters or of the particles of a
model. `count_moves` counts moves between cells in a fixed time; the cells are `boxes` of longitude
and latitude, or the cells of a model. The shares of moves are the probabilities of a chain.
`bootstrap` estimates sampling errors. `save_trajectories` writes positions to a file. Where only
`CellCounts` of moves are known, between cells of any shape that `open_counts` reads, a
`CountedDrift` has the patches in which drifters gather, and the most likely route between places.

**Deployment.** A *deployment* is a set of cells from which drifters can together ever reach every
cell: with any positive probability, after any time. `deployment_cells` (Alg. 5.2) chooses one cell
in each persistent group, and more cells to cover the transient groups. `minimum_deployment` finds
the fewest cells from which all cells can ever be reached, and `coverage_curve` counts the cells
that fewer drifters can reach, in the time that `coverage_seconds` foretells. `visible_deployment`
is for cameras that see a disc of the sea bed (Eq. 5.1, 5.8, 5.9, Alg. 5.3).

**Regions.** `read_regions` finds the cells in polygons of a GeoJSON file, and an `Exchange` has the
shares of drifters that go between regions, and their residence times.

**Depth.** `Sea` combines layers. `reachable` finds the cells that a chain can ever reach,
`reachable_by_layer` the cells that drifters can reach if they go down once (Alg. 5.4), and
`reachable_at_depth` the cells that they can reach if they go up and down at any time. A *voyage*
brings a drifter to a goal: in each step the drifter goes up (-1), goes down (1), or drifts (0). The
*policy* of a Markov decision process, `voyage_model`, chooses the action in each cell, with

    r = 100 for a step that leads to the goal, else -1                               (Eq. 5.10)
    V(z) = max over u of the mean of r + g V(z'), with g the discount        (value iteration)

`discounted_voyage` finds this policy (Alg. 5.5). `surest_voyage` uses no discount: its policy is
the quickest of those with the largest probability of arrival. `simulate_voyages` simulates
drifters.

**In a compiled program.** The rate of the flow and the times may be traced by `jit`, `vmap` and
`grad` in `advect`, `flow_map`, `drift_map`, `ftle` and `crossing_time`, and the chain by `jit` and
`vmap` in `reachable`. The other functions run on the host.

A `SeaDrift` has all results for the currents of a file, with a `Layer` for each depth and a
`SeaVoyage` for each policy; `jaxcell.study.Drift` computes it.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
