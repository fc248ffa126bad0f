"""Patrolling: random walks on a graph, and attacks by an adversary (Alam 2018, ch. 4).

A *patroller* walks on an undirected graph whose vertices are places to guard. Its *strategy* is a
Markov chain, often given by *weights* `w` of the edges: from a vertex it takes an edge with a
probability in proportion to the weight. Robots need not talk, start together, or know each other.

A graph is a `Graph` with `n` vertices, numbered from 0. `load_graph` and `save_graph` read and
write it; `has_weights` tells whether a file has weights, which are not read; `load_values` reads
one number per vertex, and `load_stakes` the stakes of a game. A time is a number of steps, unless
edges have travel times. Distances are in metres.

**Walks.** With `L = A diag(w) A^T` the weighted Laplacian (Eq. 4.2), `A` the incidence matrix, and
`0 = k_1 <= k_2 <= ... <= k_n` its eigenvalues:

    p_ij = w_ij / sum_j w_ij             the walk                                     `random_walk`
    pi_i p_ij + pi_j p_ji                the share of steps along an edge             `edge_shares`
    h_ij = 1 + sum_k p_ik h_kj, h_jj = 0 the hitting time: steps from i until at j
                                                                               `walk_hitting_times`
    C_ij = h_ij + h_ji                   the commute time, there and back                 `measure`
    C    = 4 / (n - 1) sum_i>1 1 / k_i   its mean over pairs, for sum w = 1

Eq. 4.3 has half of this `C`, which is the mean hitting time; the best weights are the same.

- *MAECT* is the choice of weights with the least `C` (Eq. 4.4), `jaxcell.optimize.minimum_commute`;
    with an *emphasis*, the edges of the shortest closed tour through given vertices have at least a
    given share of the weight (Eq. 4.5). The problem is convex and its solution has a duality gap,
    also under the constraints of `load_constraints`; `MetConstraints` reports how they are met.
- `toward` heads for a vertex along its `k` shortest paths (Alg. 4.1), whose steps count only in
    their own direction, as printed; this reproduces all rows of Table 4.2 for `k = 1`.
- Beyond the source there are `minimum_kemeny`, `K = sum_j pi_j h_ij` with `pi` the stationary
    distribution; `maximum_entropy_rate`, `H = -sum_i pi_i sum_j p_ij log p_ij`, in nats; and
    `maximum_return_time_entropy`, the entropy of the `return_time_law`, which `return_time_entropy`
    computes for any chain. `measure` computes `h`, `C`, `K`, `H` and more of any chain, and
    `GraphPatrol` holds these with the graph, for datasets and recordings; for several independent
    robots also the first arrival at each vertex and the probability of capturing an attack.
- `maximin_capture` maximises the least entry of `walk_capture_probabilities`: `F_t[i, j]`, the
    probability of arriving at `j` from `i` within an attack time `t`, by the recursion
    `F_t = P + P (F_{t-1} - diag F_{t-1})`.

**Teams and time.** Robots walk independently; `long_run` gives the shares of time of their chains.
`divide_graph` gives each robot a part of the graph, `part_of_graph`, in which `walk_in_part` keeps
it; `Division` compares that with sharing. If edges take `whole_times`, `timed` gives hitting times
of a walk in seconds, a semi-Markov process; `minimum_commute` and `maximin_capture` take such times
too. *Idleness* is the time between visits: `steps_between_visits` is exact, `simulate_idleness`
compares walks with a tour, random robots and reactive ones, the baselines of patrolling_sim.
`age_of_news` is the law of the age of the news at a base, to which robots report; a `charged` walk
returns to a charger after a given number of steps, and `charged_capture` maximises its capture.

**Games.** In `strategy_game` the patroller commits to a mixture of walks and the adversary, who
knows it, attacks a vertex (Eq. 4.6, 4.7). The `k`-th closest vertex of a walk is worth `1/2^(k-1)`
as a probability of capture, as in Table 4.2 (Alg. 4.2 prints another exponent).

**Maps.** The vertices are free cells, `cell_graph`. From each cell a robot sees others (Eq. 4.1,
`jaxcell.space.visible_cells`). A *cover* is a set of cells from which all cells are seen: robot `i`
takes the `i`-th best cell each time (Alg. 4.3). `distributed_policies` emphasise the cover (section
4.4.4). Around a `base_station` each robot has a region, `angular_regions`, with a *contact cell*
where it reports: `centralized_policies` (4.4.5). When a robot falls silent for longer than
`silence_limit`, `reassign` divides the map among the others.

**Attacks.** An attack on a cell begins with each robot anywhere out of view of the cell
(`outside`), and fails if a robot comes into view, which is at the `boundary`, within the attack
time `t_a`. With `S_r(t)` the probability that robot `r` has not come by `t`, the probability of
capture is `p_d = 1 - prod_r S_r(t_a)`. `capture_probabilities` computes it exactly for all cells,
in time `O(robots * cells * edges * t_a)`. For one cell `vulnerability` adds the method of the
source (4.4.6): simulated times, and the generalized lambda distribution `Gld` (Eq. 4.10) that
`fit_gld` fits to them. An adversary attacks the most vulnerable of the `contested` cells, where an
attack may succeed or fail: `capture_policies` maximise the least probability of capture, to a local
optimum, and `capture_frontier` is its trade-off with the unpredictability of the steps.

**Perimeters.** The baselines BMP, DCP and DNCP of Table 4.1 (Agmon, Kraus and Kaminka 2008) are
robots on a cycle that toss one coin: `Perimeter`. The probability of detection is a polynomial in
the probability of heads, `detection_polynomials`; `maximin` finds the best one, with a bound.
`hitting_law` and `mean_hitting_times` give the time until a robot is in a segment, and `simulate`
draws it.

Most functions need 64-bit numbers, and so do the examples: set `JAX_ENABLE_X64=1`.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
