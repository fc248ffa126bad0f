"""Bouncing robots: straight until a wall, then a turn by the bouncing angle.

A robot with a bump sensor and a clock goes straight, one step at a time, until a step is not
possible; then it turns in place, counter-clockwise by its *bouncing angle*, and goes on. From the
centre of a cell `z` in direction `theta` (Alam 2018, Eq. 2.4), with `E` the free space,

    C(z) = the cell that holds the end of the step, direction theta         if the step stays in E,
    C(z) = the same position, direction theta + bounce                      otherwise.

What depends on the walls alone is in `Moves`; what a bouncing angle adds is a turn. `bounce_map` is
the image of every cell, `bounce_groups` its periodic groups, and `localization_filter` the
automaton that tells a robot where it is from its bumps (section 2.4). The other functions are parts
of these, for use under `jit` and `vmap`.
"""

from .all_plans import AllPlans as AllPlans, all_plans as all_plans
from .coverage import (
    CoveragePolicy as CoveragePolicy,
    coverage_policy as coverage_policy,
    coverage_target as coverage_target,
    noisy_bounce_map as noisy_bounce_map,
    noisy_turns as noisy_turns,
)
from .dynamics import (
    Collision as Collision,
    Moves as Moves,
    bounce_image as bounce_image,
    bounce_map as bounce_map,
    bounce_shift as bounce_shift,
    grid_moves as grid_moves,
    moves as moves,
)
from .filter_size import heading_filter_sizes as heading_filter_sizes
from .grid_groups import (
    GridGroups as GridGroups,
    grid_groups as grid_groups,
    wall_groups as wall_groups,
)
from .groups import (
    bounce_groups as bounce_groups,
    bump_section as bump_section,
    expand_groups as expand_groups,
    group_summary as group_summary,
    runs as runs,
    summarize as summarize,
)
from .joint import (
    JointImage as JointImage,
    joint_image as joint_image,
    joint_orbits as joint_orbits,
    squares_of as squares_of,
)
from .localize import (
    Localization as Localization,
    localization_filter as localization_filter,
    localize as localize,
)
from .navigate import Plan as Plan, plan as plan, replay as replay
from .roadmap import Roadmap as Roadmap
from .team import (
    TeamOutcome as TeamOutcome,
    TeamTrajectory as TeamTrajectory,
    team_trajectories as team_trajectories,
    team_trajectory as team_trajectory,
)
from .walls import Walls as Walls, walls as walls
