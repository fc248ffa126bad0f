"""Optimisation of weights that are not negative and sum to 1.

- A *mixture* of distributions `a_1, ..., a_k` nearest to a target is a point of the convex hull of
    the `a_i`, found exactly by an active set.
- The walk on a graph with the *minimum commute* time has edge weights that are an A-optimal design,
    found by an interior-point method.
- The *fastest mixing* chain has the least second largest eigenvalue modulus; *fastest averaging*
    may use negative weights. Both are semidefinite programs.
- A *cover* is a choice of sets that together hold every element, greedily or with the fewest sets.
- A *Stackelberg* leader mixes its strategies, knowing that the follower answers best.

Every answer comes with a [`jaxcell.certificate.Certificate`][] of how far from the optimum it can
be.
"""

from .commute_sweep import (
    CommuteSweep as CommuteSweep,
    commute_weights as commute_weights,
    minimum_commute_sweep as minimum_commute_sweep,
)
from .conductance import MinimumCommute as MinimumCommute, minimum_commute as minimum_commute
from .cover import (
    Cover as Cover,
    MinimumCover as MinimumCover,
    greedy_cover as greedy_cover,
    minimum_cover as minimum_cover,
)
from .game import Commitment as Commitment, payoffs as payoffs, stackelberg as stackelberg
from .graph import Graph as Graph
from .mixing import (
    FastestAveraging as FastestAveraging,
    FastestMixing as FastestMixing,
    fastest_averaging as fastest_averaging,
    fastest_mixing as fastest_mixing,
)
from .mixture import Mixture as Mixture, mixture as mixture
from .tour import shortest_tour as shortest_tour
