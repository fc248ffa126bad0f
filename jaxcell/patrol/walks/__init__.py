"""Walks on a graph: their measures, and the walks that optimise them.

With `A` the incidence matrix, `L = A diag(w) A^T` the weighted Laplacian (Alam 2018, Eq. 4.2), and
`0 = k_1 <= k_2 <= ... <= k_n` the eigenvalues of `L`:

    p_ij = w_ij / sum_j w_ij             the walk                                     `random_walk`
    pi_i p_ij + pi_j p_ji                the share of steps along an edge             `edge_shares`
    h_ij = 1 + sum_k p_ik h_kj, h_jj = 0 the hitting time: mean steps from i to j     `measure`
    C_ij = h_ij + h_ji                   the commute time, there and back             `measure`
    C    = 4 / (n - 1) sum_i>1 1 / k_i   its mean over pairs, for sum w = 1

Eq. 4.3 is half of this `C`, the mean hitting time; both have the same best weights.

- `jaxcell.optimize.minimum_commute` finds the weights with the least `C` (Eq. 4.4, 4.5), also under
    the constraints of `load_constraints`; `MetConstraints` reports how they are met.
- `toward` heads for a vertex along its `k` shortest paths (Alg. 4.1). For `k = 1` this reproduces
    all rows of Table 4.2.
- Three other optima are not in the source. `minimum_kemeny` minimises `K = sum_j pi_j h_ij`, with
    `pi` the stationary distribution. `maximum_entropy_rate` maximises `H = -sum_i pi_i sum_j p_ij
    log p_ij`, in nats, and `maximum_return_time_entropy` the `return_time_entropy`, the entropy of
    the time of return to a vertex. Each function returns an `OptimizedWalk`.
- `measure` computes `h`, `C`, `K`, `H` and more of any chain (`Measures`). `GraphPatrol` adds the
    graph, and for independent robots the probability of capturing an attack, by an adversary that
    sees the robots, or at a random time (`blind_capture`); `captures_over_time` has both for
    attacks of all durations.
- `maximin_capture` maximises the least entry of `walk_capture_probabilities` (`MaximinCapture`):
    `F_t[i, j]`, the probability of arriving at `j` from `i` within an attack time `t`. Its
    recursion is `F_t = P + P (F_{t-1} - diag F_{t-1})`. `charged_capture` does so for robots that
    return to a charger. With a *memory*, a state that may change at each move, robots capture more:
    `memory_patrol` compares memories of several sizes and a tour (`MemoryPatrol`), and
    `capture_bound` is an upper bound for any memory.
- In `strategy_game`, a `StrategyGame`, the patroller commits to a mixture of walks and the
    adversary, who knows it, attacks a vertex (Eq. 4.6, 4.7).
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
