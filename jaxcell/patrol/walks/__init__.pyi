from .arrival import (
    blind_capture as blind_capture,
    captures_over_time as captures_over_time,
    walk_capture_probabilities as walk_capture_probabilities,
)
from .game import StrategyGame as StrategyGame, strategy_game as strategy_game
from .graph_patrol import GraphPatrol as GraphPatrol
from .measures import Measures as Measures, measure as measure
from .memory import MemoryPatrol as MemoryPatrol, memory_patrol as memory_patrol
from .optimal.bound import capture_bound as capture_bound
from .optimal.charged_capture import charged_capture as charged_capture
from .optimal.constraints import (
    MetConstraints as MetConstraints,
    load_constraints as load_constraints,
)
from .optimal.descent import OptimizedWalk as OptimizedWalk
from .optimal.entropy import (
    maximum_entropy_rate as maximum_entropy_rate,
    maximum_return_time_entropy as maximum_return_time_entropy,
    return_time_entropy as return_time_entropy,
)
from .optimal.kemeny import minimum_kemeny as minimum_kemeny
from .optimal.maximin import MaximinCapture as MaximinCapture, maximin_capture as maximin_capture
from .paths import toward as toward
from .walk import (
    edge_shares as edge_shares,
    random_walk as random_walk,
)
