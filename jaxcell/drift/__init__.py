"""Drifters: where the water of an ocean current carries what floats in it (Alam 2018, chapter 5).

The sea is cut into cells, in one or more layers. A *drifter* in a layer moves with the current; it
chooses at most its depth.

- The *flow map* sends a point to where the current has carried it after a time `dt`. The *image* of
    a cell is the water cell that is nearest to the end of the flow line from its centre.
- The current is not known exactly. With probability `rho` the image is right; what is left goes to
    the other cells of a bounded *disturbance set* `A(z)`. So the sea becomes a finite Markov chain
    over cells, a generalized cell map; what leaves the domain goes to an explicit sink.
- A *persistent group* is a closed communicating class of that chain: drifters that enter it stay.
    Every other cell is *transient*. The *domicile* of a transient cell is the set of the persistent
    groups that it can reach: one (single-domicile) or several (multiple-domicile).
- The *absorption time* of a transient cell is the expected number of steps until its drifter is in
    a persistent group, and its *absorption probabilities* say in which.
- A *deployment* is a set of cells to release drifters in, so that in the long term they reach every
    cell that any drifter can: one in each persistent group, and more that cover the transient ones.
- A *voyage* is a drifter's way to a goal by going up, going down, or drifting, chosen in each cell
    by the *policy* of a Markov decision process.

`open_currents` reads the currents: velocities towards the East (`u`) and North (`v`) in metres per
second, the mask of the water, and the sides of the cells in metres.
"""

from .behaviour import (
    LongTermBehaviour as LongTermBehaviour,
    long_term_behaviour as long_term_behaviour,
)
from .coherent import (
    Agreement as Agreement,
    agreement as agreement,
    ftle as ftle,
    ridges as ridges,
)
from .deploy import (
    CoverageCurve as CoverageCurve,
    Deployment as Deployment,
    VisibleDeployment as VisibleDeployment,
    coverage_curve as coverage_curve,
    deployment_cells as deployment_cells,
    minimum_deployment as minimum_deployment,
    visible_deployment as visible_deployment,
)
from .diagnosis import (
    Diagnosis as Diagnosis,
    diagnose as diagnose,
    group_counts as group_counts,
)
from .drift_map import drift_map as drift_map, periodic_drift_map as periodic_drift_map
from .flow import (
    Flow as Flow,
    advect as advect,
    crossing_time as crossing_time,
    flow_map as flow_map,
)
from .ocean import open_currents as open_currents
from .reach import (
    reachable as reachable,
    reachable_at_depth as reachable_at_depth,
    reachable_by_layer as reachable_by_layer,
)
from .replay import (
    Comparison as Comparison,
    Replay as Replay,
    compare as compare,
    replay as replay,
)
from .sea import Sea as Sea
from .voyage import (
    Tracks as Tracks,
    Voyage as Voyage,
    discounted_voyage as discounted_voyage,
    simulate_voyages as simulate_voyages,
    surest_voyage as surest_voyage,
    voyage_model as voyage_model,
)
from .water import Water as Water
