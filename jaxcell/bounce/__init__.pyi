from .anywhere import Anywhere as Anywhere, HomeFromAnywhere as HomeFromAnywhere
from .coverage import (
    coverage_policy as coverage_policy,
    coverage_target as coverage_target,
)
from .covered import CoveragePolicy as CoveragePolicy
from .dynamics import (
    CELL_BY_CELL as CELL_BY_CELL,
    ENDPOINT as ENDPOINT,
    Motion as Motion,
    Moves as Moves,
    bounce_image as bounce_image,
    bounce_map as bounce_map,
    bounce_shift as bounce_shift,
    grid_moves as grid_moves,
    moves as moves,
)
from .gridded import grid_groups as grid_groups, wall_groups as wall_groups
from .groups import bounce_groups as bounce_groups, group_summary as group_summary
from .imprecise import noisy_bounce_map as noisy_bounce_map, noisy_turns as noisy_turns
from .localization.choice import (
    AdaptivelyLocalized as AdaptivelyLocalized,
    LocalizationPolicy as LocalizationPolicy,
    localization_policy as localization_policy,
)
from .localization.filter_size import heading_filter_sizes as heading_filter_sizes
from .localization.offsets import OffsetLocalized as OffsetLocalized, Offsets as Offsets
from .localization.result import LocalizationFilter as LocalizationFilter, Localized as Localized
from .localization.run import (
    Localization as Localization,
    localization_filter as localization_filter,
    localize as localize,
)
from .periodic import BounceGroups as BounceGroups, RoomGroups as RoomGroups
from .plans.all_pairs import (
    AllPlans as AllPlans,
    CostSummary as CostSummary,
    all_plans as all_plans,
)
from .plans.navigate import Plan as Plan, plan as plan, replay as replay
from .plans.roadmap import Roadmap as Roadmap
from .slip.bounds import bounded_map as bounded_map
from .slip.fine_cells import (
    FineCells as FineCells,
    slip_map as slip_map,
)
from .slip.particles import particle_run as particle_run
from .slip.plan import SlippedPlan as SlippedPlan
from .slip.plan_runs import plan_runs as plan_runs
from .slip.policy import (
    SlipPolicy as SlipPolicy,
    arrival_by as arrival_by,
    plan_probability as plan_probability,
    slip_policy as slip_policy,
)
from .slip.run import Slipped as Slipped, slipping_run as slipping_run
from .team import (
    team_trajectories as team_trajectories,
    team_trajectory as team_trajectory,
)
from .trajectory import TeamOutcome as TeamOutcome, TeamTrajectory as TeamTrajectory
from .wall_map import Walls as Walls, cell_walls as cell_walls, walls as walls
