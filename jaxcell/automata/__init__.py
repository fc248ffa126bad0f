"""Automata that localize a robot. The package does not import JAX, so that it runs on robots.

The *I-state graph* of a simple map has a vertex for each cell and an edge from each cell to its
image, labelled with the observation, 0 or 1, of a robot on this step. If the first cell of the
robot is unknown, the graph is a nondeterministic automaton. A state of the equivalent deterministic
automaton is a set of cells: the *configurations* that are possible after an observation string.

A *knowledge cycle* is a simple cycle without exits in the deterministic automaton. A *filter*
colours the states: 1 outside the knowledge cycles, and 2, 3, ... in them, one colour per cycle, in
the order of their smallest states. A robot whose filter is in a knowledge cycle is *localized*.
The *uncertainty* of a state is the number of its configurations.

In a *closed-world* filter an impossible observation is an error. In an *open-world* filter it leads
to one more state, the *trap*, with the highest colour: the map is then *refuted*.

**In symbols** (Alam 2018, section 2.4). Let `C` be a simple map of cells `0, ..., N-1`, and `y(z)`
in `{0, 1}` the observation from `z` to `C(z)` (Definition 2.4.1). The states are sets of cells,

    Q_0 = {0, ..., N-1},     delta(Q, a) = { C(z) : z in Q, y(z) = a },

where an empty set is not a state: that observation is impossible (Definitions 2.4.2 and 2.4.3). The
states reachable from `Q_0`, including it, are numbered in breadth-first order, 0 before 1.

**Size.** `|delta(Q, 0)| + |delta(Q, 1)| <= |Q|`, so that sets never grow along a string. Around a
cycle of the automaton they keep their size; hence all configurations of a state give the same
observation, the cycle has no exit, and every cycle is a knowledge cycle. Its configurations can
never be distinguished. There are `O(N^2)` states (Proposition 2.4.4). The time and the memory to
construct them are linear in the total size of the sets.

**Running.** Each observation is one table look-up, for any map, so a microcontroller can run a
filter. For `k` maps, `k` open-world filters run side by side (`Environments`), and the robot is in
one of the maps that are not refuted (section 2.4.4).

`subset_construction` computes the automaton of a simple map, and `minimize` a filter with fewer
states and the same colours. `smallest` finds the smallest machine with the same outputs, and
`fewest_bytes` the machine with the smallest tables, whose size `machine_bytes` computes.
`equivalence` finds equivalent states of a machine with inputs, `homing_sequence` a fixed sequence
of inputs that identifies its state, and `adaptive_choice` inputs that depend on observations.
`credible` and `expected_entropy` evaluate beliefs, and `Evidence` their map. `to_c_header`,
`policy_to_c_header`, `machine_to_c_header`, `to_dot`, `to_json` and `to_jflap` write files.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
