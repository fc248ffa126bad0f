"""Optimisation of weights that are not negative and sum to 1.

Each problem is a convex or a mixed-integer program. Except for greedy covers and tours, the dual
program bounds the distance of a result from the optimum; most functions return the bound in a
[`jaxcell.base.certificate.Certificate`][].

**Mixture** (Alam 2018, Eq. 3.7 and 3.8). The mixture of distributions `a_1, ..., a_k`, the columns
of `A`, that is nearest to a target `b` is a point of their convex hull:

    minimise |A x - b|^2     over x >= 0, sum x = 1.

`mixture` finds it exactly with an active-set method.

**Minimum commute** (Eq. 4.2 to 4.5). On a graph with edge weights `w`, a walk leaves a vertex along
edge `e` with probability `w_e` divided by the sum of the weights there. With `b_e = e_i - e_j` for
an edge between `i` and `j`, and `0 = l_1 < l_2 <= ... <= l_n` the eigenvalues of the Laplacian

    L = sum_e w_e b_e b_e',     the mean commute time is C = 4 / (n - 1) sum_{i>=2} 1 / l_i,

where the mean is over pairs of different vertices. Eq. 4.3 is half of `C`, the mean hitting time.
`C` is convex in `w`. The weights with the least `C` are an A-optimal design. `minimum_commute`
computes the weights with an interior-point method in `O(edges^3)` per step; with an *emphasis*, the
weights on the closed tour through given vertices, `shortest_tour`, sum to at least a share `h`.

**Fastest mixing.** Find the symmetric matrix `I - L` on a graph whose eigenvalues are nearest to 0,
except for the eigenvalue 1 of the uniform distribution:

    minimise max(|1 - l_2|, |1 - l_n|)     over w >= 0, if each row of I - L is a distribution.

`fastest_mixing` solves this semidefinite program (Boyd, Diaconis and Xiao 2004), also for a given
stationary distribution.

**Cover** (Eq. 4.8, 4.9, Alg. 4.3). A set cover: sets whose union contains every element. Each step
of `greedy_cover` takes the set that adds most elements; the cover has at most `1 + 1/2 + ... + 1/d`
times the least number of sets, with `d` the size of the largest set. `minimum_cover` finds the
fewest sets with a mixed-integer program, in time that can grow exponentially. `largest_cover`
chooses a given number of sets, which contain elements with some probability, and has a bound.

**Stackelberg** (Eq. 4.6, 4.7, Alg. 4.2). A leader commits to a mixture `x` of strategies. A
follower that knows `x` chooses the target `j` with its largest payoff, and among equal targets the
best target for the leader:

    maximise sum_i x_i P_ij     over x >= 0, sum x = 1 and j in argmax_k sum_i x_i Q_ik,

averaged over the types of the follower. With one type, the problem is one linear program per
target; with more types, one mixed-integer program. `payoffs` computes `P` and `Q` of patrol
strategies from the `Stakes` at each vertex, and `stackelberg` solves for the commitment.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
