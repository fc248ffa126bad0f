"""Labelled graphs and the filters made of them. NumPy and SciPy only: a robot runs them.

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

**In symbols** (Alam 2018, section 2.4). Let `C` be a simple map of cells `0, ..., N-1`, and `y(z)`
in `{0, 1}` the observation from `z` to `C(z)` (Definition 2.4.1). The states are sets of cells,

    Q_0 = {0, ..., N-1},     delta(Q, a) = { C(z) : z in Q, y(z) = a },

where an empty set is no state: that observation is missing there (Definitions 2.4.2 and 2.4.3). The
states reachable from `Q_0`, itself included, are numbered in breadth-first order, 0 before 1.

**Size.** `|delta(Q, 0)| + |delta(Q, 1)| <= |Q|`, so that sets never grow along a string. Around a
cycle of the automaton they keep their size; hence all configurations of each give the same
observation, nothing leaves the cycle, and every cycle is a knowledge cycle. Its configurations can
never be told apart. There are `O(N^2)` states (Proposition 2.4.4), and time and memory are linear
in the total size of the sets.

**Running.** One observation is one look-up, whatever the map, which is why a microcontroller can do
it. For `k` maps as many open-world filters run side by side, and the robot is in one of the maps
not refuted (section 2.4.4).

What gives which:

- `subset_construction`: the deterministic automaton, an `Automaton`.
- `HiddenMap`: a map with several images of a cell, each with a probability and an observation.
    `Belief` follows how probable each cell is, `Bounded` the set of those that are possible; an
    `Estimate` is what either knows, and `credible` the likeliest configurations. A belief that may
    choose among angles turns by the one with the least `expected_entropy` at the next bump.
- `Filter`: its colours, knowledge cycles (`KnowledgeCycle`), uncertainties and configurations;
    `Filter.run` gives a `FilterRun`, `Filter.start` a `FilterState` to observe with.
- `Environments`, `EnvironmentsState`: the filters of several maps.
- `equivalence`: which states of a machine with inputs can be told apart, an `Equivalence`.
- `adaptive_choice`: which inputs find out soonest in which state such a machine is, `Decisions`;
    `homing_sequence`: one sequence of inputs that does whatever is observed, `Homing`.
- `Policy`, `PolicyState`: the choice of angles at bumps as a file, and as a robot follows it;
    `policy_to_c_header`.
- `fastest_localization`: the shortest string that localizes a robot.
- `minimize`: the smallest filter with the same colours.
- `to_c_header`, `to_dot`, `to_jflap`, `to_json`: a filter in other forms;
    `nondeterministic_to_jflap` is the automaton before it is made deterministic.
"""

from .adaptive import Decisions as Decisions, adaptive_choice as adaptive_choice
from .belief import (
    Belief as Belief,
    BeliefState as BeliefState,
    expected_entropy as expected_entropy,
)
from .bounded import Bounded as Bounded
from .cycles import KnowledgeCycle as KnowledgeCycle
from .environments import (
    Environments as Environments,
    EnvironmentsState as EnvironmentsState,
)
from .equivalent import Equivalence as Equivalence, equivalence as equivalence
from .fastest import fastest_localization as fastest_localization
from .filter import Filter as Filter, FilterRun as FilterRun, FilterState as FilterState
from .formats.c_header import to_c_header as to_c_header
from .formats.c_policy import policy_to_c_header as policy_to_c_header
from .formats.export import to_dot as to_dot, to_json as to_json
from .formats.jflap import (
    nondeterministic_to_jflap as nondeterministic_to_jflap,
    to_jflap as to_jflap,
)
from .hidden import Estimate as Estimate, HiddenMap as HiddenMap, credible as credible
from .homing import Homing as Homing, homing_sequence as homing_sequence
from .minimization import minimize as minimize
from .policy import Policy as Policy, PolicyState as PolicyState
from .subset import Automaton as Automaton, subset_construction as subset_construction
