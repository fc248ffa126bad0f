import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import binomtest

from ...bounce import FineCells, Plan, SlippedPlan, arrival_by, plan_runs, slip_map, slip_policy
from ...bounce.slip.policy import PolicyRobot
from ...robot import Walker
from ...robot.emulation.body import Body, bumper_give
from ...robot.emulation.direct import DirectBody
from ...robot.plan import run_plan
from ...space import Slip, cell_strides, nearest_cell
from ..study import Say


# Numbers of runs of the emulated robot, and of simulations of the plan in continuous space.
_RUNS, _PLAN_RUNS = 50, 20_000
_CONFIDENCE = 0.99
# A run of a policy has at most `_PLANS` lengths of the plan, or `_MEANS` of its mean times.
_PLANS, _MEANS, _MOST = 4, 4, 4000


def slipped_plan(
    plan: Plan, error: float, bounce_deg: Sequence[float], step: float | None, say: Say
) -> SlippedPlan:
    """Find the probability that a slipping robot reaches its goal with a plan and with a policy.

    `error` is the parameter `slip` of the study, and `step` the length of a step in metres.
    """
    cells, bounces = plan.cells, np.radians(bounce_deg).tolist()
    slip = Slip.of(error, give=bumper_give(cells.cell))
    fine = FineCells.within(cells, slip)
    say(f"mapping {fine.size:,} fine cells")
    hidden = slip_map(fine, bounces, slip, step=step)
    start, goal = fine.at(plan.start), fine.coarse == plan.goal
    foretold, there, interval = 0, 0, (0.0, 0.0)
    if plan.found:
        say("simulating the plan")
        ends = plan_runs(cells, plan.start, plan.actions.tolist(), slip, runs=_PLAN_RUNS, step=step)
        foretold = len(ends)
        there = int(np.count_nonzero(nearest_cell(cells, *ends.T) == plan.goal))
        interval = binomtest(there, _PLAN_RUNS).proportion_ci(_CONFIDENCE)
    say("improving the policy")
    policy = slip_policy(hidden, goal, start)
    mean = float(start @ np.where(start > 0, policy.time, 0.0)) if policy.sure else math.inf
    limit = max(_PLANS * plan.actions.size, math.ceil(_MEANS * mean) if policy.sure else 0)
    limit = min(limit, _MOST)
    say("driving the emulated robot")
    plans, arrived = [], []
    for seed in range(_RUNS):
        if plan.found:
            walker, body = _robot(plan, error, step, seed)
            outcome = run_plan(walker, plan.actions.tolist())
            at_goal = int(nearest_cell(cells, *body.pose)) == plan.goal
            plans.append(outcome.result == "arrived" and at_goal)
        walker, body = _robot(plan, error, step, _RUNS + seed)
        robot = PolicyRobot(hidden, policy, start)
        for count in range(1, limit + 1):
            choice = robot.turn(int(walker.step()))
            if choice is not None:
                walker.rotate(bounces[choice])
            if int(nearest_cell(cells, *body.pose)) == plan.goal:
                arrived.append(count)
                break
    return SlippedPlan(
        **{one.name: getattr(plan, one.name) for one in dataclasses.fields(plan)},
        fine_cells=fine.size,
        plan_runs=_PLAN_RUNS if plan.found else 0,
        plan_as_foretold=foretold / _PLAN_RUNS,
        plan_arrives=there / _PLAN_RUNS,
        plan_arrives_from=float(interval[0]),
        plan_arrives_to=float(interval[1]),
        policy_surely_arrives=policy.sure,
        policy_mean_steps=mean,
        policy_arrival=arrival_by(hidden, policy.choice, goal, start, limit),
        simulated_runs=_RUNS,
        simulated_plan_arrives=float(np.mean(plans)) if plans else 0.0,
        simulated_policy_arrives=len(arrived) / _RUNS,
        simulated_policy_steps=float(np.mean(arrived)) if arrived else math.inf,
    )


def _robot(plan: Plan, error: float, step: float | None, seed: int) -> tuple[Walker, Body]:
    cells, length = plan.cells, plan.cells.cell if step is None else step
    body = Body.in_cell(cells, plan.start, error, np.random.default_rng([0, seed]))
    strides = cell_strides(cells.directions, cells.cell, length)
    direction = plan.start // cells.positions
    return Walker(DirectBody(body), length, strides=strides, direction=direction), body
