"""Graphs of places to guard, and their files.

Vertices of a `Graph` are numbered from 0, distances are in metres. `load_graph` reads JSON and the
formats of networkx and of patrolling_sim.
`load_ways` reads the same files, also with directed and parallel edges and loops, as `Ways`.
`load_values` reads one number per vertex, and `load_stakes` the stakes of a game.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
