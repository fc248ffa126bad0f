from . import (
    files as files,
    law as law,
    map as map,
    perimeter as perimeter,
    rounds as rounds,
    team as team,
    walks as walks,
)
from .files import Graph as Graph, load_graph as load_graph
from .law import Gld as Gld, fit_gld as fit_gld
from .map import (
    Attack as Attack,
    Capture as Capture,
    PatrolledMap as PatrolledMap,
    capture_policies as capture_policies,
    capture_probabilities as capture_probabilities,
    cell_graph as cell_graph,
    distributed_policies as distributed_policies,
    vulnerability as vulnerability,
)
from .walks import (
    GraphPatrol as GraphPatrol,
    maximin_capture as maximin_capture,
    random_walk as random_walk,
    strategy_game as strategy_game,
    toward as toward,
)
