"""Patrolling: random walks on a graph, and what an adversary can make of them (Alam 2018, ch. 4).

A *patroller* walks on an undirected graph whose vertices are places to guard. Its *strategy* is a
Markov chain, here one with *weights* `w` on the edges: from a vertex it takes an edge with a
probability in proportion to the weight. Robots need not talk, start together, or know each other.

- The *hitting time* `h_ij` is the expected number of steps from vertex `i` until the walk is first
    at `j`, and the *commute time* is `h_ij + h_ji`, there and back.
- *MAECT* is the choice of weights with the least average expected commute time over all pairs of
    vertices, [`jaxcell.optimize.minimum_commute`][]; with an *emphasis*, the edges of the shortest
    closed tour through some vertices have at least a given share of the weight.
"""

from ..optimize import Graph as Graph
from .graph import random_walk as random_walk, walk_hitting_times as walk_hitting_times
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
