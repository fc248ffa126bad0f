"""Labelled graphs and the filters made of them. NumPy only: a robot runs them.

The *I-state graph* of a simple map has a vertex for each cell and an edge from each to its image,
labelled with what the robot senses on the way: observation 0 or 1. A robot that may be in any cell
and hears only the observations is a nondeterministic automaton; made deterministic, its states are
the sets of cells, *configurations*, that an observation string leaves possible.

A *knowledge cycle* is a simple cycle of the deterministic automaton that nothing leaves. A *filter*
colours the automaton: 1 outside the knowledge cycles, and 2, 3, ... in them, one colour a cycle, in
the order of their smallest states. A robot whose filter is in a knowledge cycle is *localized*: it
is in one of the configurations of the state, whose number is the *uncertainty*.

A *closed-world* filter trusts the map, so that an observation which cannot occur is an error. An
*open-world* filter has one more state for it, the *trap*, with the last colour: there the map is
*refuted*.
"""

from .c_header import to_c_header as to_c_header
from .cycles import KnowledgeCycle as KnowledgeCycle
from .environments import (
    Environments as Environments,
    EnvironmentsState as EnvironmentsState,
)
from .export import to_dot as to_dot, to_json as to_json
from .fastest import fastest_localization as fastest_localization
from .filter import Filter as Filter, FilterRun as FilterRun, FilterState as FilterState
from .jflap import nondeterministic_to_jflap as nondeterministic_to_jflap, to_jflap as to_jflap
from .minimize import minimize as minimize
from .subset import Automaton as Automaton, subset_construction as subset_construction
