from .boundary import (
    Boundary as Boundary,
    bump_gains as bump_gains,
    places_anywhere as places_anywhere,
    run_to_wall as run_to_wall,
)
from .choice import Aim as Aim, choose_angles as choose_angles, draw_places as draw_places
from .chords import Chords as Chords
from .filter import Errors as Errors, WallFilter as WallFilter
from .homing import Homing as Homing
from .sets import WallSet as WallSet, contains as contains
from .symmetry import alike_places as alike_places
from .trial import Trial as Trial, drive_anywhere as drive_anywhere
