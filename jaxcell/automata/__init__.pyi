from .adaptive import Decisions as Decisions, adaptive_choice as adaptive_choice
from .belief import (
    Belief as Belief,
    BeliefState as BeliefState,
    expected_entropy as expected_entropy,
)
from .cycles import KnowledgeCycle as KnowledgeCycle
from .environments import Environments as Environments, EnvironmentsState as EnvironmentsState
from .equivalent import equivalence as equivalence
from .evidence import Evidence as Evidence
from .filter import Filter as Filter, FilterRun as FilterRun, FilterState as FilterState
from .formats.c_header import to_c_header as to_c_header
from .formats.c_machine import (
    fewest_bytes as fewest_bytes,
    machine_bytes as machine_bytes,
    machine_to_c_header as machine_to_c_header,
)
from .formats.c_policy import policy_to_c_header as policy_to_c_header
from .formats.export import to_dot as to_dot, to_json as to_json
from .formats.jflap import to_jflap as to_jflap
from .hidden import Estimate as Estimate, HiddenMap as HiddenMap, credible as credible
from .homing import Homing as Homing, homing_sequence as homing_sequence
from .machine import MooreMachine as MooreMachine
from .minimization import minimize as minimize
from .policy import Policy as Policy, PolicyState as PolicyState
from .reduction.smallest import Smallest as Smallest, smallest as smallest
from .subset import Automaton as Automaton, subset_construction as subset_construction
