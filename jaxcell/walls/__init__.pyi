from .boundary import (
    Boundary as Boundary,
    bump_gains as bump_gains,
    places_anywhere as places_anywhere,
    run_to_wall as run_to_wall,
)
from .choice import Aim as Aim, choose_angles as choose_angles, draw_places as draw_places
from .chords import Chords as Chords
from .filter import (
    Errors as Errors,
    WallFilter as WallFilter,
    bumps_until_localized as bumps_until_localized,
    is_localized as is_localized,
)
from .homing import Homing as Homing
from .proposal import propose_angles as propose_angles
from .relaxed import (
    RelaxedFilter as RelaxedFilter,
    RelaxedSet as RelaxedSet,
    likeliest as likeliest,
)
from .sets import WallSet as WallSet, contains as contains
from .start import StartRegion as StartRegion
from .symmetry import (
    Alike as Alike,
    alike_places as alike_places,
    alike_poses as alike_poses,
)
from .trial import (
    Trial as Trial,
    draw_starts as draw_starts,
    drive_anywhere as drive_anywhere,
)
