from .anywhere import Anywhere as Anywhere, HomeFromAnywhere as HomeFromAnywhere
from .coverage import (
    CoveragePolicy as CoveragePolicy,
    coverage_policy as coverage_policy,
    coverage_target as coverage_target,
)
from .dynamics import (
    CELL_BY_CELL as CELL_BY_CELL,
    ENDPOINT as ENDPOINT,
    Motion as Motion,
    Moves as Moves,
    bounce_image as bounce_image,
    bounce_map as bounce_map,
    bounce_shift as bounce_shift,
    moves as moves,
)
from .group_results import BounceGroups as BounceGroups, RoomGroups as RoomGroups
from .groups import bounce_groups as bounce_groups, group_summary as group_summary
from .groups_on_grids import grid_groups as grid_groups, wall_groups as wall_groups
from .localization.filter_size import heading_filter_sizes as heading_filter_sizes
from .localization.localize import (
    Localization as Localization,
    localization_filter as localization_filter,
    localize as localize,
)
from .localization.offsets import OffsetLocalized as OffsetLocalized, Offsets as Offsets
from .localization.policy import (
    AdaptivelyLocalized as AdaptivelyLocalized,
    LocalizationPolicy as LocalizationPolicy,
    localization_policy as localization_policy,
)
from .localization.result import LocalizationFilter as LocalizationFilter, Localized as Localized
from .noisy_map import noisy_bounce_map as noisy_bounce_map, noisy_turns as noisy_turns
from .plans.all_plans import (
    AllPlans as AllPlans,
    CostSummary as CostSummary,
    all_plans as all_plans,
)
from .plans.plan import Plan as Plan, plan as plan, replay as replay
from .plans.roadmap import Roadmap as Roadmap
from .proposed import ProposedAngles as ProposedAngles
from .slip.fine_cells import FineCells as FineCells, slip_map as slip_map
from .slip.plan_runs import plan_runs as plan_runs
from .slip.policy import (
    SlipPolicy as SlipPolicy,
    arrival_by as arrival_by,
    slip_policy as slip_policy,
)
from .slip.slipped_plan import SlippedPlan as SlippedPlan
from .slip.slipping_run import Slipped as Slipped, slipping_run as slipping_run
from .team import team_trajectories as team_trajectories, team_trajectory as team_trajectory
from .trajectory import TeamOutcome as TeamOutcome, TeamTrajectory as TeamTrajectory
from .wall_tables import Walls as Walls, walls as walls
