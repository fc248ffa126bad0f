from .attack import (
    Attack as Attack,
    boundary as boundary,
    contested as contested,
    outside as outside,
)
from .attacked_cell import Vulnerability as Vulnerability, vulnerability as vulnerability
from .capture import (
    Capture as Capture,
    capture_by_tours as capture_by_tours,
    capture_probabilities as capture_probabilities,
)
from .capture_search import (
    CaptureSearch as CaptureSearch,
    Frontier as Frontier,
    capture_frontier as capture_frontier,
    capture_policies as capture_policies,
)
from .graph import cell_graph as cell_graph
from .patrolled import PatrolledMap as PatrolledMap
from .policies import (
    Policy as Policy,
    centralized_policies as centralized_policies,
    distributed_policies as distributed_policies,
)
from .reassignment import (
    Reassignment as Reassignment,
    reassign as reassign,
    silence_limit as silence_limit,
)
from .regions import (
    Regions as Regions,
    angular_regions as angular_regions,
    base_station as base_station,
)
