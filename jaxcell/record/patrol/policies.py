import numpy as np
import rerun.blueprint as rrb

from ...patrol import PatrolledMap
from ..canvas.map import CellMap
from ..canvas.marks import log_dots, log_shares
from ..canvas.page import log_tab
from ..canvas.palette import robot_color
from ..canvas.prose import described, numbers
from ..canvas.scale import Scale
from .regions import base_legend, log_contacts
from .sight import MAX_MAPS, only_some, robot_table


def log_policies(map: CellMap, patrol: PatrolledMap) -> rrb.Container:
    """Log a tab that shows the share of the steps of each robot along each edge."""
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


_BY_WEIGHTS = """From a cell it takes each edge with a probability in proportion to its weight. The
shortest closed tour through the cells of the cover has at least a given share of the weight. The
mean number of steps from a cell to another and back is the least possible."""


def _text(patrol: PatrolledMap) -> str:
    how, columns = _BY_WEIGHTS, ["commute_time", "tour_steps"]
    if patrol.search is not None:
        how, columns = numbers(patrol.search), ["entropy_rate"]
    sizes = ""
    if patrol.size_capture is not None:
        sizes = f"""
Robots were added until the least probability of capture reached {patrol.wanted:g}, or to the limit:

{described(patrol, "size", "size_capture")}
"""
    return f"""# How a robot walks

Wide yellow lines are edges that a robot often takes.{only_some(patrol)}

{how}

{robot_table(patrol, *columns)}
{sizes}"""
