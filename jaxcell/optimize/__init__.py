"""Optimisation of weights that are not negative and sum to 1.

Each of these is a convex or a mixed-integer program with a bound from its dual. Except for greedy
covers and tours, an answer comes with a bound, mostly as a
[`jaxcell.base.certificate.Certificate`][], of how far from the optimum it can be.

**Mixture** (Alam 2018, Eq. 3.7 and 3.8). The mixture of distributions `a_1, ..., a_k`, the columns
of `A`, that is nearest to a target `b` is a point of their convex hull:

    minimise |A x - b|^2     over x >= 0, sum x = 1.

An active set finds it exactly. `mixture`.

**Minimum commute** (Eq. 4.2 to 4.5). On a graph with edge weights `w` a walk takes edge `e` out of
a vertex with probability `w_e` over the sum of the weights there. With `b_e = e_i - e_j` for an
edge between `i` and `j`, and `0 = l_1 < l_2 <= ... <= l_n` the eigenvalues of the Laplacian

    L = sum_e w_e b_e b_e',     the mean commute time is C = 4 / (n - 1) sum_{i>=2} 1 / l_i,

over pairs of different vertices; Eq. 4.3 has half of it, the mean hitting time. `C` is convex in
`w`. The weights with the least `C` are an A-optimal design, found by an interior-point method in
`O(edges^3)` a step; with an *emphasis* the weights on the shortest closed tour through some
vertices sum to at least a share `h`. `minimum_commute`; `minimum_commute_sweep` and
`commute_weights` for many problems at once; `shortest_tour`.

**Fastest mixing.** Of the symmetric matrices `I - L` on a graph, the one whose other eigenvalues
than the 1 of the uniform distribution are nearest to 0:

    minimise max(|1 - l_2|, |1 - l_n|)     over w >= 0 with rows that are distributions,

or, for averaging, over weights of any sign. Both are semidefinite programs (Boyd, Diaconis and Xiao
2004; Xiao and Boyd 2004). `fastest_mixing` (also for a given stationary distribution),
`fastest_averaging`.

**Cover** (Eq. 4.8, 4.9, Alg. 4.3). A choice of sets that together hold every element: one after the
other the set that gains most, at most `1 + 1/2 + ... + 1/d` times too many with `d` the size of the
largest set; or the fewest, by a mixed-integer program, in time that can grow exponentially.
`greedy_cover`, `minimum_cover`.

**Stackelberg** (Eq. 4.6, 4.7, Alg. 4.2). A leader commits to a mixture `x` of strategies; a
follower that knows it chooses the target `j` that pays it most, and among equals the one best for
the leader:

    maximise sum_i x_i P_ij     over x >= 0, sum x = 1 and j in argmax_k sum_i x_i Q_ik,

averaged over the types of the follower. For one type a linear program for each target; for more
types one mixed-integer program. `payoffs` gives `P` and `Q` of patrol strategies, from the `Stakes`
at each vertex, and `stackelberg` the commitment.

`Graph` is the graph of all of these, and `MinimumCommute`, `CommuteSweep`, `FastestMixing`,
`FastestAveraging`, `Cover`, `MinimumCover`, `Mixture` and `Commitment` are the answers.
"""

import lazy_loader


__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
