"""What one asks of a finite Markov chain on cells.

Let `P` be the transition matrix of a [`jaxcell.mapping.Chain`][], whose rows may sum to less than
1: the rest of the mass leaves the space for a sink. Every cell is *transient* or belongs to a
*persistent group*, a closed communicating class (Alam 2018, Definitions 3.3.1 to 3.3.3), and with
probability 1 the chain ends in one of the groups or in the sink.

- The *limiting distribution* is the time average of the chain, `lim (p + p P + ... + p P^(n-1)) /
    n`. On each group it is the one distribution with `x P = x`, weighed by the probability of
    ending there.
- With `Q` the part of `P` among the transient cells and `R` that into the groups, *absorption
    probabilities* are `B = R + Q B`, and *absorption times* `t = 1 + Q t`.
- *Hitting times* are the same for any set of cells, and `inf` where the chain may never arrive.
    Their *law* is that of the *first passage*. Of several robots that move independently, none has
    arrived with the product of the probabilities that each has not.
- An irreducible chain, one with a single group and no transient cells, has a hitting time for every
    pair of cells, there and back a *commute time*; *Kemeny's constant*, the hitting time of a cell
    drawn from the stationary distribution; an *entropy rate*; and a *mixing time*.

In a *decision process* one chooses among several chains in every cell. Its *value* is the most that
can be expected of rewards, each discounted by the time until it is paid; without a discount, the
*stochastic shortest path* is first the surest way to a goal, and among those the quickest.

Every answer comes with a [`jaxcell.certificate.Certificate`][]: a residual that is computed from
the answer and the full matrix, and says how good the answer is. All solves need 64-bit numbers.
"""

from . import dense as dense
from .arrival import (
    Distinct as Distinct,
    MeanArrival as MeanArrival,
    first_arrival as first_arrival,
    mean_first_arrival as mean_first_arrival,
)
from .conditional import (
    arrival_probabilities as arrival_probabilities,
    conditional_hitting_times as conditional_hitting_times,
)
from .decision import (
    DecisionModel as DecisionModel,
    Optimum as Optimum,
    policy_chain as policy_chain,
    value_iteration as value_iteration,
)
from .hitting import (
    Absorption as Absorption,
    absorption_probabilities as absorption_probabilities,
    absorption_times as absorption_times,
    hitting_times as hitting_times,
)
from .limiting import (
    LimitingDistribution as LimitingDistribution,
    limiting_distribution as limiting_distribution,
)
from .passage import first_passage as first_passage, survival as survival
from .quantities import (
    PairTimes as PairTimes,
    commute_times as commute_times,
    entropy_rate as entropy_rate,
    hitting_matrix as hitting_matrix,
    kemeny_constant as kemeny_constant,
    mixing_time as mixing_time,
    slem as slem,
)
from .shortest_path import (
    ShortestPath as ShortestPath,
    stochastic_shortest_path as stochastic_shortest_path,
)
from .simulation import Arrivals as Arrivals, simulate_arrival as simulate_arrival
