"""Patrols of a map by robots that see only so far (Alam 2018, section 4.4).

The vertices are free cells, `cell_graph`. From each cell a robot sees others (Eq. 4.1,
`jaxcell.space.visible_cells`). A *cover* is a set of cells from which all cells are seen: robot `i`
takes the `i`-th best cell each time (Alg. 4.3).

**Policies.** Each robot has a `Policy`. `distributed_policies` emphasise the cover (section 4.4.4).
Around a `base_station` each robot has a region, `angular_regions`, with a *contact cell* where it
reports (`Regions`): `centralized_policies` (4.4.5). When a robot falls silent for longer than
`silence_limit`, `reassign` divides the map among the others (`Reassignment`).

**Attacks.** An attack on a cell begins with each robot out of view of the cell (`outside`), where
it is in the long run, and fails if a robot comes into view, which is at the `boundary`, within the
attack time `t_a`. A robot in cell `i` sees cell `j` if `visible[i, j]` is true, in all functions.
With `S_r(t)` the probability that robot `r` has not come by `t`, the probability of capture is

    p_d = 1 - prod_r S_r(t_a).

`capture_probabilities` computes it exactly for all cells, in time `O(robots * cells * edges *
t_a)`, for the times and the start of an `Attack`; a `Capture` adds the weakest cell, which an
adversary attacks. That is among the `contested` cells, where an attack may succeed or fail. For one
cell `vulnerability` adds the method of the source (4.4.6): simulated times, and the generalized
lambda distribution that is fitted to them (`Vulnerability`). `capture_policies` maximise the least
probability of capture, to a local optimum (`CaptureSearch`), and `capture_frontier` is its
trade-off with the unpredictability of the steps (`Frontier`). `capture_by_tours` is the least
capture by robots on closed tours through covers. `PatrolledMap` holds all of it, for datasets and
recordings.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
