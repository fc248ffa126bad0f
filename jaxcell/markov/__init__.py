"""What one asks of a finite Markov chain on cells.

Let `P` be the transition matrix of a [`jaxcell.mapping.Chain`][], whose rows may sum to less than
1: the rest of the mass leaves the space for a sink. Every cell is *transient* or belongs to a
*persistent group*, a closed communicating class (Alam 2018, Definitions 3.3.1 to 3.3.3), and with
probability 1 the chain ends in one of the groups or in the sink.

**In the long run.** With `p` the start (Eq. 3.5), the *limiting distribution* is the time average

    pi = lim (p + p P + ... + p P^(n-1)) / n,     pi P = pi,

which exists also where the chain is periodic. On each group it is the one distribution with
`x P = x`, weighed by the probability of ending there. `limiting_distribution`.

**Until the end.** With `Q` the part of `P` among the transient cells and `R` that into the groups,
*absorption probabilities* and *absorption times* are (Eq. 5.7: `t` is the row sums of
`(I - Q)^-1`)

    B = R + Q B,     t = 1 + Q t.

`absorption_probabilities`, `absorption_times`.

**Until a target** `T`. The probability `h` of ever arriving and the expected number of steps `k`
are the least solutions, not negative, of

    h = 1 on T, h = P h elsewhere;     k = 0 on T, k = 1 + P k elsewhere;

but `k` is `inf` where `h < 1`. There one asks for the mean over the ways that arrive, which is the
`k` of Doob's transform `p_ij h_j / h_i`. The law of the *first passage* is what arrives at time `n`
when what has arrived before is taken away. Of several robots that move independently, none has
arrived with the product of the probabilities that each has not (section 4.4.6).
`arrival_probabilities`, `hitting_times`, `conditional_hitting_times`; `first_passage`, `survival`;
`first_arrival`, `mean_first_arrival`, and `simulate_arrival` by runs (`Distinct` for robots that
start in different cells); `sample_walks` draws a few walks step by step.

**Nearly closed.** Sets that the chain seldom leaves show in eigenvalues near 1. `leading_modes` has
eigenvalues and eigenvectors from both sides; `almost_invariant_sets` are hardly left nor
entered in some steps, `coherent_sets` move meanwhile, and `attracting_regions` gather what is in
their basins: `NearlyClosedSets`, with what they leak and how fast.

**Between all pairs.** An irreducible chain, one with a single group and no transient cells, has a
hitting time `H_ij` for every pair of cells, and there and back a *commute time* `H_ij + H_ji` (Eq.
4.3); *Kemeny's constant* `sum_j pi_j H_ij`, the same for every `i`; the *entropy rate*
`-sum_ij pi_i p_ij log p_ij`; the second largest eigenvalue modulus; and the *mixing time*, after
which no start is farther than a given distance from `pi` in total variation.
`hitting_matrix`, `commute_times`, `kemeny_constant`, `entropy_rate`, `slem`, `mixing_time`; `dense`
has `pi`, `H`, Kemeny's constant and the entropy rate as differentiable functions of the matrix.

**Observed.** Where a robot senses `o` on the way, `P = P_0 + P_1`, and the distribution after the
observations `o_1, ..., o_n` is `p P_{o_1} ... P_{o_n}` to a factor, which is their probability.
`filtered`, `smoothed` for earlier times given all of them, and `possible` for sets of cells.

**Choosing.** In a *decision process* one chooses an action `u` in every cell, each a chain `P_u`
with a reward `r_u`. With a discount `g` its *value* solves (Alg. 5.5)

    V = g max_u (r_u + P_u V).

Without one, the *stochastic shortest path* is first the surest way to a goal, and among those the
quickest. `DecisionModel`, `value_iteration`, `policy_chain`, `stochastic_shortest_path`.

**How.** Solves are sparse: products with `P` where they converge soon, a factorisation where they
do not, after runs of certain steps have been taken out. What needs all pairs is dense: memory
`O(N^2)` and time `O(N^3)`. Every solve comes with a [`jaxcell.base.certificate.Certificate`][]: a
residual that is computed from the answer and the full matrix, and says how good the answer is. All
solves need 64-bit numbers: `jax.config.update("jax_enable_x64", True)`. Sparse ones run on the
host, with NumPy and scipy; `push` and `pull`, first passages, decisions, what is observed and
`dense` run wherever JAX does.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
