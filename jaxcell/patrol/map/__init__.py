"""Patrols of a map by robots with a limited range of sight (Alam 2018, section 4.4).

`cell_graph` builds the graph whose vertices are the free cells. From each cell a robot sees other
cells (Eq. 4.1, `jaxcell.space.visible_cells`). A *cover* is a set of cells from which all cells are
seen. It is built cell by cell: the cover of robot 0 gets the cell that sees most additional cells,
the cover of robot 1 the second best cell, and so on (Alg. 4.3).

**Policies.** Each robot has a `Policy`. `distributed_policies` are walks on the whole map that
often visit the cover (section 4.4.4). `centralized_policies` (4.4.5) divide the map around a
`base_station` into `Regions`, one per robot, by `angular_regions`; each has a *contact cell* where
the robot reports. If a robot is silent for longer than `silence_limit`, `reassign` divides the map
among the others (`Reassignment`).

**Attacks.** When an attack on a cell begins, all robots are out of view of the cell (`outside`),
distributed as in the long run. The attack fails if a robot comes into view, at the `boundary`,
within the attack time `t_a`. In all functions, a robot in cell `i` sees cell `j` if `visible[i, j]`
is true. With `S_r(t)` the probability that robot `r` has no view of the cell in `t` steps, the
probability of capture is

    p_d = 1 - prod_r S_r(t_a).

`capture_probabilities` computes it exactly for all cells, in time `O(robots * cells * edges *
t_a)`, for the times and the start of an `Attack`. In the `contested` cells an attack may succeed or
fail; a `Capture` also gives the weakest of them, which an adversary attacks. For one cell
`vulnerability` adds the method of the source (4.4.6): simulated times, and a generalized lambda
distribution fitted to these times (`Vulnerability`). `capture_policies` finds walks that locally
maximise the probability at the weakest cell (`CaptureSearch`), `capture_frontier` computes its
trade-off with the unpredictability of steps (`Frontier`), and `capture_by_tours` its value for
closed tours through covers. `PatrolledMap` contains all results, for datasets and recordings.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
