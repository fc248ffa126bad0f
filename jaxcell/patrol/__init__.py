"""Patrolling: random walks on a graph, and what an adversary can make of them (Alam 2018, ch. 4).

A *patroller* walks on an undirected graph whose vertices are places to guard. Its *strategy* is a
Markov chain, often one with *weights* `w` on the edges: from a vertex it takes an edge with a
probability in proportion to the weight. Robots need not talk, start together, or know each other.

Graphs are `Graph` (read and written by `load_graph` and `save_graph`; `has_weights` says whether a
file has weights, which are not read, `load_values` reads a number for each vertex, and
`load_stakes` those of a game), with `n` vertices, numbered from 0. A time is a number of steps,
unless an edge has a travel time. Distances are in metres.

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
    with an *emphasis*, the edges of the shortest closed tour through some vertices have at least a
    given share of the weight (Eq. 4.5). It is convex and comes with a duality gap, also under
    constraints such as those that `load_constraints` reads; `MetConstraints` says how they are met.
- `toward` heads for a vertex along its `k` shortest paths (Alg. 4.1), whose steps count in their
    own direction alone, as printed; then all rows of Table 4.2 come out for `k = 1`.
- Beyond the source there are `minimum_kemeny`, `K = sum_j pi_j h_ij` with `pi` the stationary
    distribution; `maximum_entropy_rate`, `H = -sum_i pi_i sum_j p_ij log p_ij`, in nats; and
    `maximum_return_time_entropy`, the entropy of the `return_time_law`, which `return_time_entropy`
    gives of any chain. `measure` gives `h`, `C`, `K`, `H` and more of any chain, and
    `GraphPatrol` has these with the graph, for datasets and recordings; for several robots, each by
    itself, also when the first of them comes to a vertex, and how likely one captures an attack.
- `maximin_capture` makes the least entry of `walk_capture_probabilities` great: `F_t[i, j]`, the
    probability to come from `i` to `j` within an attack time `t`, by the recursion
    `F_t = P + P (F_{t-1} - diag F_{t-1})`.

**Teams and time.** Robots walk each by itself, by the `long_run` shares of time of their chains.
`divide_graph` gives each a part of the graph, `part_of_graph`, where it stays, `walk_in_part`;
`Division` puts that beside sharing. Where edges take `whole_times`, `timed` gives the hitting times
of a walk in seconds, a semi-Markov process; `minimum_commute` and `maximin_capture` take such times
too. *Idleness* is the time between visits: `steps_between_visits` exactly, and `simulate_idleness`
beside a tour, random robots and reactive ones, the baselines of patrolling_sim. `age_of_news` is
the law of the age of what a base knows, which robots tell as they pass; `charged` are walks
that are led back to a charger every so many steps, `charged_capture` those that capture most.

**Games.** In `strategy_game` the patroller commits to a mixture of walks and the adversary, who
knows it, attacks a vertex (Eq. 4.6, 4.7). The `k`-th closest vertex of a walk is worth `1/2^(k-1)`
as a probability of capture, as in Table 4.2 (Alg. 4.2 prints another exponent).

**Maps.** The vertices are free cells, `cell_graph`. A robot sees some of them from each (Eq. 4.1,
`jaxcell.space.visible_cells`), and a *cover* is a set of cells from which all are seen: robot `i`
takes the `i`-th best cell each time (Alg. 4.3). `distributed_policies` emphasise the cover (section
4.4.4). Around a `base_station` each robot has a region, `angular_regions`, with a *contact cell*
where it reports: `centralized_policies` (4.4.5). When a robot falls silent for longer than
`silence_limit`, `reassign` divides the map among the others.

**Attacks.** An attack on a cell begins with each robot anywhere out of view of the cell
(`outside`), and fails if a robot comes into view, which is at the `boundary`, within the attack
time `t_a`. With `S_r(t)` the probability that robot `r` has not come by `t`, the probability of
capture is `p_d = 1 - prod_r S_r(t_a)`. `capture_probabilities` has it exactly for all cells, in
time `O(robots * cells * edges * t_a)`. For one cell `vulnerability` puts the source's way beside it
(4.4.6): simulated times, and the generalized lambda distribution `Gld` (Eq. 4.10) that `fit_gld`
fits to them. An adversary attacks the most vulnerable cell of the `contested` ones, where luck
decides: `capture_policies` make the least probability of capture great, a local optimum, and
`capture_frontier` says what of it is left where steps must be hard to predict.

**Perimeters.** The baselines BMP, DCP and DNCP of Table 4.1 (Agmon, Kraus and Kaminka 2008) are
robots on a cycle that toss one coin: `Perimeter`. The probability of detection is a polynomial in
the probability of heads, `detection_polynomials`; `maximin` finds the best one, with a bound. When
a robot comes to a segment say `hitting_law`, `mean_hitting_times` and, by trial, `simulate`.

Most functions need 64-bit numbers, and so do the examples: set `JAX_ENABLE_X64=1`.
"""

import lazy_loader


__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
