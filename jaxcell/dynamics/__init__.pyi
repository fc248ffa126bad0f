from .basin import Basins as Basins, basins as basins
from .boundary.edge_states import EdgeStates as EdgeStates
from .boundary.edges import edge_states as edge_states
from .boundary.refinement import (
    Refined as Refined,
    refined as refined,
    relative_attractor as relative_attractor,
)
from .continued import Continuation as Continuation, continuation as continuation
from .imaging import images as images
from .large.stored import Foretold as Foretold, foretold as foretold, stored_basins as stored_basins
from .maps import Flow as Flow, Map as Map, flow as flow, section as section, strobe as strobe
from .noise.chains import chain as chain, moved as moved
from .noise.diffusion import Diffusion as Diffusion, diffusion as diffusion
from .noise.escape import Escape as Escape, escape as escape
from .noise.exit_times import ExitTimes as ExitTimes, exit_times as exit_times
from .outer.images import (
    Corners as Corners,
    Intervals as Intervals,
    OuterMap as OuterMap,
    Samples as Samples,
)
from .outer.morse import (
    MorseCertificate as MorseCertificate,
    MorseSets as MorseSets,
    morse_sets as morse_sets,
)
from .outer.transform import enclose as enclose
from .quantify import (
    basin_entropy as basin_entropy,
    basin_stability as basin_stability,
    minimal_critical_shock as minimal_critical_shock,
    overlap as overlap,
    uncertainty_exponent as uncertainty_exponent,
    wada as wada,
)
from .recurrent import unstable_set as unstable_set
from .system import System as System
