"""Bouncing robots: straight until a wall, then a turn by the bouncing angle.

A robot with a bump sensor and a clock goes straight, one step at a time, until a step is not
possible. Then it turns in place, counter-clockwise by its *bouncing angle*, and goes on. From the
centre of a cell `z` in direction `theta` (Alam 2018, Eq. 2.4), with `E` the free space and `phi`
the bouncing angle,

    C(z) = the cell that holds the end of the step, direction theta         if the step stays in E,
    C(z) = the same position, direction theta + phi                         otherwise.

The robot senses 0 on a step and 1 on a bump. Angles are in radians, and are multiples of the angle
between two directions. `Moves` contains the ends of steps, which depend only on the walls. A
bouncing angle is a turn by `shift` directions. `Motion` has the length of a step and the rule of
collision. Functions: `moves`, `bounce_shift`, `bounce_image`, `bounce_map`.

**Periodic groups** (Alg. 2.1). Between two bumps a robot runs straight, so every orbit passes
through the cells where it bumps. The first-return map to these cells is tens of times smaller. The
groups, steps and periods of all cells follow from it. `bounce_groups` and `group_summary` find the
groups of a map. `grid_groups` computes totals for many grids and angles; it passes the result of
`walls` to `wall_groups`. Studies result in `BounceGroups`, or `RoomGroups` for random rooms.

**Localization** (section 2.4). A robot may start in any cell. Each observation excludes cells,
until the number of possible cells stays the same and the filter repeats its states (a *knowledge
cycle*). `localization_filter` builds the filter, and `localize` runs it; the results are
`LocalizationFilter` and `Localized`. `heading_filter_sizes` counts the states of the filter if the
heading is known. A robot that chooses among several angles at each bump is localized to one cell on
most maps. `localization_policy` finds the choice with the fewest bumps; the results are
`LocalizationPolicy` and `AdaptivelyLocalized`.

**A robot that slips.** Its state is a fine cell (`FineCells`): a square, the direction in which the
robot believes it is heading, and the error of this belief. The map is a hidden Markov
model, `slip_map`.
`slipping_run` drives such a robot until its belief covers few cells. At each bump the robot takes
the angle that leaves the least expected entropy. The result is `Slipped`. `plan_runs` simulates
runs of a plan. `slip_policy` chooses an angle for each fine cell, and `arrival_by` computes the
probability that a robot with this policy has arrived; the result is `SlippedPlan`.

**Navigation** (Eq. 3.6, Alg. 3.1, 3.2). At a bump a robot chooses one of several angles. A step, or
a bump with the same angle as the previous bump, costs `w_1`; a bump with another angle costs `w_2`.
A plan is a cheapest path in the graph of pairs (cell, last angle). Its graph, a `Roadmap`, has only
the cells where robots bump and the cells into which they turn, because all other cells lie on
straight runs. Functions: `plan`, `replay`, `all_plans`.

**Coverage** (Eq. 3.5 to 3.8, Alg. 3.3). A robot that turns imprecisely is a Markov chain: at a wall

    phi with probability r,     each other direction within epsilon of phi with (1 - r) / (2 k),

where `epsilon` is `k` directions. Each angle has a limiting distribution over the positions, a
column of `A`. The mixture `alpha` nearest to a target `b` minimises `|A alpha - b|^2`.
Functions: `noisy_turns`, `noisy_bounce_map`, `coverage_target`, `coverage_policy`.

**Teams** (Eq. 3.9 to 3.11, Alg. 3.4). All robots step at the same time, and a robot bumps if it
would meet a wall or another robot. The joint state of `m` robots is a tuple of cells, one of `N^m`.
A joint trajectory follows the joint map until it repeats a state. Then one of the `m` robots turns
by one direction, left or right, whichever of these `2 m` turns leads to the most new positions.
Functions: `team_trajectory`, `team_trajectories`.

**In a compiled program.** Angles may be traced by `jit` and `vmap` in `bounce_shift`, `bounce_map`,
`bounce_image`, `bounce_groups` and `group_summary`, and angles and probabilities also by `grad` in
`noisy_turns` and `noisy_bounce_map`. A traced angle stands for the nearest whole number of
directions. A cell space and a motion are static: for others a new program is compiled. All other
functions run on the host.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
