from .advection import advect as advect
from .beaches import Stranded as Stranded, beaching as beaching, coast as coast
from .closed_sets import (
    ClosedSets as ClosedSets,
    closed_sets_seconds as closed_sets_seconds,
    coherent_sets as coherent_sets,
    nearly_closed_sets as nearly_closed_sets,
)
from .currents import open_currents as open_currents
from .deployment import (
    CoverageCurve as CoverageCurve,
    Deployment as Deployment,
    VisibleDeployment as VisibleDeployment,
    coverage_curve as coverage_curve,
    coverage_seconds as coverage_seconds,
    deployment_cells as deployment_cells,
    minimum_deployment as minimum_deployment,
    visible_deployment as visible_deployment,
)
from .drift_step import METHODS as METHODS, DriftStep as DriftStep
from .flow import Flow as Flow, crossing_time as crossing_time
from .layered_cells import Sea as Sea
from .long_term import (
    LongTermBehaviour as LongTermBehaviour,
    long_term_behaviour as long_term_behaviour,
)
from .maps import (
    drift_map as drift_map,
    drift_maps as drift_maps,
    exit_shares as exit_shares,
    flow_map as flow_map,
)
from .observed.cell_counts import CellCounts as CellCounts, open_counts as open_counts
from .observed.counted_drift import CountedDrift as CountedDrift
from .observed.moves import (
    CountedMoves as CountedMoves,
    Spread as Spread,
    bootstrap as bootstrap,
    boxes as boxes,
    count_moves as count_moves,
)
from .observed.observed_drift import ObservedDrift as ObservedDrift
from .observed.trajectories import (
    Trajectories as Trajectories,
    open_trajectories as open_trajectories,
    save_trajectories as save_trajectories,
)
from .reachability import (
    reachable as reachable,
    reachable_at_depth as reachable_at_depth,
    reachable_by_layer as reachable_by_layer,
)
from .regions import Exchange as Exchange, read_regions as read_regions
from .results.current_layer import Layer as Layer
from .results.dropped import Dropped as Dropped
from .results.released import Released as Released
from .results.sea_drift import SeaDrift as SeaDrift
from .validation.coherent import (
    Agreement as Agreement,
    agreement as agreement,
    ftle as ftle,
    ridges as ridges,
)
from .validation.diagnosis import (
    Diagnosis as Diagnosis,
    diagnose as diagnose,
    group_counts as group_counts,
)
from .validation.distance import (
    Distance as Distance,
    asked_hours as asked_hours,
    distances as distances,
    distances_by_cell as distances_by_cell,
    nearest_step as nearest_step,
)
from .validation.markov_test import MarkovTest as MarkovTest
from .validation.release import (
    ReleaseDistance as ReleaseDistance,
    release_distance as release_distance,
    typical_cells as typical_cells,
)
from .validation.replay import Replay as Replay, Sampling as Sampling
from .validation.simulated_drifters import (
    Comparison as Comparison,
    Drifters as Drifters,
    compare as compare,
    simulate_drifters as simulate_drifters,
)
from .voyage_policies import (
    SeaVoyage as SeaVoyage,
    Tracks as Tracks,
    Voyage as Voyage,
    discounted_voyage as discounted_voyage,
    simulate_voyages as simulate_voyages,
    surest_voyage as surest_voyage,
    voyage_model as voyage_model,
)
from .water import Water as Water
