from .files.graph_files import (
    Graph as Graph,
    has_weights as has_weights,
    load_graph as load_graph,
)
from .files.graph_saving import save_graph as save_graph
from .files.values import load_stakes as load_stakes, load_values as load_values
from .law.distribution import Gld as Gld
from .law.fit import GldFit as GldFit, fit_gld as fit_gld
from .map.attack import (
    boundary as boundary,
    capture_probabilities as capture_probabilities,
    contested as contested,
    outside as outside,
)
from .map.capture import (
    CaptureSearch as CaptureSearch,
    Frontier as Frontier,
    capture_frontier as capture_frontier,
    capture_policies as capture_policies,
)
from .map.graph import cell_graph as cell_graph
from .map.patrolled import PatrolledMap as PatrolledMap
from .map.policies import (
    Policy as Policy,
    centralized_policies as centralized_policies,
    distributed_policies as distributed_policies,
)
from .map.reassignment import (
    Reassignment as Reassignment,
    reassign as reassign,
    silence_limit as silence_limit,
)
from .map.regions import (
    Regions as Regions,
    angular_regions as angular_regions,
    base_station as base_station,
)
from .map.vulnerability import (
    Vulnerability as Vulnerability,
    vulnerability as vulnerability,
)
from .perimeter import (
    Maximin as Maximin,
    Movement as Movement,
    Perimeter as Perimeter,
    detection_polynomials as detection_polynomials,
    hitting_law as hitting_law,
    maximin as maximin,
    mean_hitting_times as mean_hitting_times,
    simulate as simulate,
)
from .team.charging import Charged as Charged, charged as charged
from .team.division import (
    Division as Division,
    divide_graph as divide_graph,
    part_of_graph as part_of_graph,
    walk_in_part as walk_in_part,
)
from .team.durations import Timed as Timed, timed as timed
from .team.idleness import (
    Idleness as Idleness,
    long_run as long_run,
    simulate_idleness as simulate_idleness,
    steps_between_visits as steps_between_visits,
)
from .team.news import News as News, age_of_news as age_of_news
from .team.times import whole_times as whole_times
from .walks.arrival import walk_capture_probabilities as walk_capture_probabilities
from .walks.game import StrategyGame as StrategyGame, strategy_game as strategy_game
from .walks.graph_patrol import GraphPatrol as GraphPatrol
from .walks.measures import Measures as Measures, measure as measure
from .walks.optimal.capture import (
    MaximinCapture as MaximinCapture,
    maximin_capture as maximin_capture,
)
from .walks.optimal.charged_capture import charged_capture as charged_capture
from .walks.optimal.constraints import (
    MetConstraints as MetConstraints,
    load_constraints as load_constraints,
)
from .walks.optimal.descent import OptimizedWalk as OptimizedWalk
from .walks.optimal.entropy import (
    maximum_entropy_rate as maximum_entropy_rate,
    maximum_return_time_entropy as maximum_return_time_entropy,
    return_time_entropy as return_time_entropy,
    return_time_law as return_time_law,
)
from .walks.optimal.kemeny import minimum_kemeny as minimum_kemeny
from .walks.paths import toward as toward
from .walks.walk import (
    edge_shares as edge_shares,
    random_walk as random_walk,
    walk_hitting_times as walk_hitting_times,
)
