from .bounce import compare_groups as compare_groups, compare_images as compare_images
from .comparison import Comparison as Comparison
from .coverage import compare_coverage as compare_coverage
from .drift import (
    compare_counted_drift as compare_counted_drift,
    compare_drift as compare_drift,
)
from .localization import (
    compare_filter as compare_filter,
    compare_policy as compare_policy,
    compare_slip as compare_slip,
)
from .navigation import compare_plan as compare_plan
from .patrolled_map import compare_patrolled_map as compare_patrolled_map
from .rounds import compare_rounds as compare_rounds
from .walk import (
    compare_commute as compare_commute,
    compare_game as compare_game,
    compare_walk as compare_walk,
)
