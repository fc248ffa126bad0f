"""How often each robot takes each edge."""

import numpy as np
import rerun.blueprint as rrb

from ...patrol import CaptureSearch, PatrolledMap
from ..canvas.map import CellMap
from ..canvas.marks import log_dots, log_shares
from ..canvas.page import log_tab
from ..canvas.palette import robot_color
from ..canvas.prose import described
from ..canvas.scale import Scale
from .regions import base_legend, log_contacts
from .sight import MAX_MAPS, only_some, robot_table


def log_policies(map: CellMap, patrol: PatrolledMap) -> rrb.Container:
    """Log the tab of the policies: edges are wide and yellow where a robot often takes them."""
    side = patrol.cells.cell
    shown = patrol.policies[:MAX_MAPS]
    most = max(float(policy.weights.max()) for policy in shown)
    views = []
    for robot, policy in enumerate(shown):
        used = policy.weights > 0
        level, ends = policy.weights[used] / most, map.xy(patrol.graph.edges[used])
        path = f"map/policy_{robot}"
        log_shares(map.stream, f"{path}/edges", ends, level, 0.145 * side)
        color = robot_color(robot)[1]
        log_dots(map.stream, f"{path}/cover", map.xy(policy.cover), 0.25 * side, color, 30.0)
        log_contacts(map, f"{path}/contact", [policy])
        views.append(map.view(f"Robot {robot}", [f"policy_{robot}/**", "base/**"]))
    scale = Scale.over(np.array([0.0, most]), "{} of the steps".format)
    legend = [*scale.legend(), ("a cell of the cover", robot_color(0)[1]), *base_legend(patrol)]
    return log_tab(map.stream, "policies", "Policies", views, _text(patrol), legend, rows=(5, 4))


def _text(patrol: PatrolledMap) -> str:
    if patrol.search is not None:
        return _searched(patrol, patrol.search)
    return f"""# How a robot walks

From a cell it takes each edge with a probability in proportion to its weight. Wide yellow lines
have large weights.{only_some(patrol)}

The shortest closed tour through the cells of the cover has at least a given share of the weight;
from one of them to another and back it takes the fewest steps, on average.

{robot_table(patrol, "commute_time", "tour_steps")}
{_sizes(patrol)}"""


def _searched(patrol: PatrolledMap, search: CaptureSearch) -> str:
    return f"""# How a robot walks

Wide yellow lines are edges that a robot often takes, in either direction.{only_some(patrol)}

An attack of {search.attack_time:,} steps is caught with probability {search.value:.4f} or more at
every cell: a local optimum, the best from {search.tried.size} starts. At least
{search.randomness:.0%} of the steps go to any neighbour alike.

{robot_table(patrol, "entropy_rate")}
{_sizes(patrol)}"""


def _sizes(patrol: PatrolledMap) -> str:
    """What smaller teams reach, if the size of the team was sought."""
    if patrol.size_capture is None:
        return ""
    return f"""
A least probability of capture of {patrol.wanted:g} is wanted, for which teams grew robot by robot:

{described(patrol, "size", "size_capture")}
"""
