"""Small parts of results, computed again by another route.

Each function takes a result and what it was made from, and computes a sample of it as plainly as
can be: one cell at a time, by exact geometry, dense algebra or a general-purpose solver, and by
none of the functions that made the result. It returns [`jaxcell.verify.Comparison`][]s, which say
how many numbers were compared, how far they differ, and how much rounding may explain.

Samples are of fixed size and the same each time.
"""

from .bounce import (
    compare_filter as compare_filter,
    compare_groups as compare_groups,
    compare_images as compare_images,
)
from .comparison import Comparison as Comparison
from .coverage import compare_coverage as compare_coverage
from .drift import compare_drift as compare_drift
from .navigation import compare_plan as compare_plan
from .patrolled_map import compare_patrolled_map as compare_patrolled_map
from .policy import compare_policy as compare_policy
from .slipped import compare_slip as compare_slip
from .team import compare_team as compare_team
from .walk import (
    compare_commute as compare_commute,
    compare_game as compare_game,
    compare_walk as compare_walk,
)
