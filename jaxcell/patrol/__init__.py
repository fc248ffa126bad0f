"""Patrolling: random walks on a graph, and what an adversary can make of them (Alam 2018, ch. 4).

A *patroller* walks on an undirected graph whose vertices are places to guard. Its *strategy* is a
Markov chain, often one with *weights* `w` on the edges: from a vertex it takes an edge with a
probability in proportion to the weight. Robots need not talk, start together, or know each other.

- The *hitting time* `h_ij` is the expected number of steps from vertex `i` until the walk is first
    at `j`, and the *commute time* is `h_ij + h_ji`, there and back.
- *MAECT* is the choice of weights with the least average expected commute time over all pairs of
    vertices, [`jaxcell.optimize.minimum_commute`][]; with an *emphasis*, the edges of the shortest
    closed tour through some vertices have at least a given share of the weight.
- Other walks head *toward* a vertex, have the least *Kemeny constant*, the greatest *entropy*, of
    steps or of return times, or the greatest probability of *capture*: of coming to the worst
    vertex from the worst place within the time that an attack takes.
- On a map the vertices are free cells. A robot sees some of them from each, a *cover* is a set of
    cells from which all are seen, and its *policy* emphasises that. Around a *base station* each
    robot has a *region*, with a *contact cell* where it reports.
- The *vulnerability* of a cell is how likely an attack on it succeeds before the first robot sees
    it. That is known exactly, and beside it stands the generalized lambda distribution ([`Gld`][])
    that fits simulated times, as in the source.
"""

from ..optimize import Graph as Graph
from .attack import (
    Vulnerability as Vulnerability,
    boundary as boundary,
    capture_probabilities as capture_probabilities,
    outside as outside,
    vulnerability as vulnerability,
)
from .capture import (
    MaximinCapture as MaximinCapture,
    maximin_capture as maximin_capture,
    walk_capture_probabilities as walk_capture_probabilities,
)
from .cell_graph import cell_graph as cell_graph
from .descent import Strategy as Strategy
from .graph import random_walk as random_walk, walk_hitting_times as walk_hitting_times
from .graph_files import load_graph as load_graph, save_graph as save_graph
from .lambda_distribution import Gld as Gld
from .lambda_fit import GldFit as GldFit, fit_gld as fit_gld
from .measures import Measures as Measures, measure as measure
from .perimeter import (
    Maximin as Maximin,
    Movement as Movement,
    Perimeter as Perimeter,
    detection_polynomials as detection_polynomials,
    hitting_law as hitting_law,
    maximin as maximin,
    mean_hitting_times as mean_hitting_times,
    simulate as simulate,
)
from .policy import (
    Policy as Policy,
    centralized_policies as centralized_policies,
    distributed_policies as distributed_policies,
)
from .reassign import (
    Reassignment as Reassignment,
    reassign as reassign,
    silence_limit as silence_limit,
)
from .region import (
    Regions as Regions,
    angular_regions as angular_regions,
    base_station as base_station,
)
from .share_game import (
    ShareGame as ShareGame,
    contested as contested,
    share_game as share_game,
)
from .speed import minimum_kemeny as minimum_kemeny
from .strategy_game import StrategyGame as StrategyGame, strategy_game as strategy_game
from .toward import toward as toward
from .unpredictable import (
    maximum_entropy_rate as maximum_entropy_rate,
    maximum_return_time_entropy as maximum_return_time_entropy,
    return_time_entropy as return_time_entropy,
    return_time_law as return_time_law,
)
