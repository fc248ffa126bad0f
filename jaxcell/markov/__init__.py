"""Quantities of a finite Markov chain on cells.

Let `P` be the transition matrix of a [`jaxcell.mapping.Chain`][], whose rows may sum to less than
1: with the remaining probability the chain leaves the space and enters a *sink*. Every cell is
*transient* or belongs to a *persistent group*, a closed communicating class (Alam 2018, Definitions
3.3.1 to 3.3.3), and with probability 1 the chain ends in one of the groups or in the sink.

**In the long run.** For a start with distribution `p` (Eq. 3.5), the *limiting distribution* is

    pi = lim (p + p P + ... + p P^(n-1)) / n,     pi P = pi,

the time average. It exists even if the chain is periodic. On a group it is the only distribution
with `x P = x`, weighted by the probability of ending there. See `limiting_distribution`.

**Until the end.** Let `Q` be the part of `P` among the transient cells, and `R` the part into the
groups. *Absorption probabilities* `B` and *absorption times* `t` solve

    B = R + Q B,     t = 1 + Q t

(Eq. 5.7: `t` is the row sums of `(I - Q)^-1`). See `absorption_probabilities` and
`absorption_times`.

**Until a target** `T`. The probability `h` of ever arriving and the expected number of steps `k`
are the least nonnegative solutions of

    h = 1 on T, h = P h elsewhere;     k = 0 on T, k = 1 + P k elsewhere;

except that `k` is `inf` where `h < 1`. For such a start, the mean over the paths that arrive is the
`k` of the chain `p_ij h_j / h_i` (Doob's transform). The law of the *first passage* is the
probability of arriving first at time `n`. The probability that none of several independent robots
has arrived is a product of one probability per robot (section 4.4.6). See `arrival_probabilities`,
`hitting_times`, `conditional_hitting_times` and `first_passage` for one robot, and `first_arrival`,
`mean_first_arrival` and `simulate_arrival` for several. `sample_walks` draws walks step by step.

The number of *visits* to each cell before the chain leaves a set is a row of `(I - Q)^-1`, where
`Q` is now the part of `P` in this set; `visits` and `exit_distribution` compute it, and the cells
by which the chain leaves. `passage_time_variance` solves
`v = sum_j p_ij (1 + k_j - k_i)^2 + P v`, `passage_quantiles` inverts the law of the first passage,
and `most_probable_path` finds the path with the largest product of probabilities.

**Between two sets.** For a source `A` and a target `B`, the forward *committor* `f` is the
probability of reaching `B` before `A`, and the backward committor `b` that of having been last in
`A`, of a chain in the long run:

    f = 0 on A, 1 on B, P f elsewhere;     pi b = pi on A, 0 on B, (pi b) P elsewhere.

Transitions from `A` to `B` have the *reactive flux* `pi_i b_i p_ij f_j` from `i` to `j`. See
`committor` and `reactive_flux`. The *quasi-stationary distribution* in a set, `v Q = (1 - l) v`, is
that of a chain that has not left the set for a long time. In each step it leaves with probability
`l`. See `quasi_stationary`.

**Nearly closed.** A chain with sets that it seldom leaves has eigenvalues near 1. `leading_modes`
computes these eigenvalues with their left and right eigenvectors. `almost_invariant_sets` finds
sets that are hardly left or entered, `coherent_sets` finds sets that move and hardly mix with their
surroundings, and `attracting_regions` finds regions that gather the mass of their basins. The
results, `NearlyClosedSets`, contain the share of the mass that leaves each set.

**Between all pairs.** An irreducible chain, one with a single group and no transient cells, has a
hitting time `H_ij` for every pair of cells, and a *commute time* `H_ij + H_ji` (Eq. 4.3); *Kemeny's
constant* `sum_j pi_j H_ij`, the same for every `i`; the *entropy rate*
`-sum_ij pi_i p_ij log p_ij`; the second largest eigenvalue modulus; and the *mixing time*, after
which the total variation from `pi` is at most a given distance, for every start. See
`hitting_matrix`, `commute_times`, `kemeny_constant`, `entropy_rate`, `slem` and `mixing_time`.
`dense` has `pi`, `H`, Kemeny's constant and the entropy rate, differentiable in the matrix.

**Decisions.** In a *decision process* an action `u` is chosen in every cell; it has a chain `P_u`
and a reward `r_u`. With a discount `g` the *value* solves (Alg. 5.5)

    V = g max_u (r_u + P_u V).

Without a discount, the *stochastic shortest path* is the policy with the largest probability of
reaching a goal and, of the policies with this probability, the one with the least time. See
`DecisionModel`, `value_iteration`, `policy_chain` and `stochastic_shortest_path`. For a number of
steps, or for the average reward `a` with `a + h = max_u (r_u + P_u h)`, see `finite_horizon` and
`average_reward`.

**From data.** `maximum_likelihood` estimates a chain from numbers of observed steps, also a
reversible one. `posterior` gives the interval of any quantity of it, and `chapman_kolmogorov`
compares its powers with later observations. The implied time scales of a lag are
`-lag / log |x|`, with the eigenvalues `x` of `leading_modes`.

**Method.** First, cells whose next cell is certain are eliminated. If at most 200 cells are left,
these are eliminated too, without subtractions, which gives nearly all digits even of times of 1e60
steps. A larger system is solved by repeated products with `P` if they converge soon, otherwise by a
factorisation, and by elimination if the factorisation is too inaccurate. Probabilities that are too
small for 64 bits, such as those of winning against a bank, are eliminated in numbers of any size.
Quantities of all pairs are dense, with memory `O(N^2)` and time `O(N^3)`. Every solve returns a
[`jaxcell.base.certificate.Certificate`][], whose residual bounds the error: from the residuals of
the full matrix and the expected number of steps, or, after an elimination, from the number of
eliminated cells. If the bound is too large, the solve raises an error, or with `throw=False`
returns the answer. Sparse solves run on the CPU, with NumPy and SciPy; `push` and `pull`, first
passages and `dense` run on any device of JAX.

**In compiled programs.** Most quantities can be used under `jit`, `vmap` and `grad`. The program
calls the same solvers, so values and certificates are the same. In a batch, chains with the same
possible steps are solved together: groups and the order of elimination are found once, and limiting
distributions, hitting times and derivatives by elimination without subtractions, so that values
differ from those of a single call by rounding, and certificates are a little larger. An error would
stop the program, so values that cannot be computed are NaN, and `certificate.converged` is `False`.
The derivative of a solution is the solution of the same equations with another right-hand side, or
of the transposed equations (Schweitzer 1968). It loses as many digits as the longest expected time
has: of 10^9 steps, 7 digits are left, and of more than 10^15 steps, none. The structure of the
chain and the best policy count as constant, and so do the times of `simulate_arrival`. A step with
probability 0 is no step of the chain, so a derivative there lacks it. `entropy_rate`, `slem`,
`leading_modes` and `maximum_entropy_rate` have no second derivatives.
`almost_invariant_sets`, `coherent_sets`, `attracting_regions` and `sample_walks` run on the host
only.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
