"""Teams on a graph: rounds, parts of the graph, travel times, idleness, news, and charging.

With a shared clock, robots follow closed tours at equal intervals, an `evenly_spaced_round`
(`Round`; `round_on_map` for robots with sight, and `walk_around` for their files). Other robots
walk independently; `long_run` computes the shares of time of their chains. `divide_graph` assigns a
part of the graph to each robot, `part_of_graph` returns its subgraph, and `walk_in_part` a walk
that stays in it; `Division` compares such walks with walks on the whole graph. `timed` computes
hitting times in seconds from travel times, for a semi-Markov process (`Timed`), `whole_times`
rounds travel times to units, and `time_unit_of` chooses the unit. *Idleness* is the time between
visits: `steps_between_visits` is exact, and `simulate_idleness` compares walks with the baselines
of patrolling_sim, a tour, random robots and reactive robots (`Idleness`).
`age_of_news` computes the age of the news at a base, to which robots report (`News`). A `charged`
walk returns to a charger in time (`Charged`).
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
