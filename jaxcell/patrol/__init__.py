"""Patrolling: random walks on a graph, and attacks by an adversary (Alam 2018, ch. 4).

A *patroller* walks on an undirected graph whose vertices are places to guard. Its *strategy* is a
Markov chain, often defined by *weights* `w` of the edges: from a vertex it takes each edge with a
probability in proportion to the weight of the edge. Robots need not communicate or start together.
A time is a number of steps, unless edges have travel times.

The main names are in this package; the packages below contain all names, and define the terms:

- `patrol.files`: a `Graph`, `load_graph`, and files with a number per vertex.
- `patrol.walks`: walks on a graph, such as the `random_walk` with given weights and the walk
    `toward` a vertex; walks that optimise a measure, such as `maximin_capture`; the
    `strategy_game` against an adversary; and `GraphPatrol`, the result for datasets and recordings.
- `patrol.team`: parts of a graph, travel times, idleness, the age of news at a base, and charging.
- `patrol.rounds`: robots that keep a shared clock: `best_rounds` in a `Game`, which may have
    directed ways and few targets, their evaluation, bounds, and timetables.
- `patrol.map`: robots with a limited view on the cells of a map. `cell_graph` joins the cells;
    `distributed_policies` and `capture_policies` compute walks; `capture_probabilities` computes
    the probability of capturing attacks; `vulnerability` also fits a law to simulated times.
- `patrol.law`: the generalized lambda distribution `Gld` and its fit, `fit_gld`.
- `patrol.perimeter`: robots on a closed perimeter that all move by the tosses of one coin.

The probability of capturing an attack that takes `t` steps follows from the probability `S_r(t)`
that robot `r` does not visit the attacked place in these steps:

    p_d = 1 - prod_r S_r(t).
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
