"""Teams on a graph: parts of it, travel times, idleness, news at a base, and charging.

Robots walk independently; `long_run` gives the shares of time of their chains. `divide_graph` gives
each robot a part of the graph, `part_of_graph`, in which `walk_in_part` keeps it; `Division`
compares that with sharing. If edges take `whole_times`, `timed` gives hitting times of a walk in
seconds, `Timed`, a semi-Markov process. *Idleness* is the time between visits:
`steps_between_visits` is exact, `simulate_idleness` compares walks with a tour, random robots and
reactive ones, the baselines of patrolling_sim (`Idleness`). `age_of_news` is the law of the age of
the news at a base, to which robots report (`News`). A `charged` walk returns to a charger after a
given number of steps (`Charged`).
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
