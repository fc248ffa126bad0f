"""Tabs about each robot of a patrol: the cells from which it sees all cells, and its walk."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...patrol import PatrolledMap
from ..canvas.map import CellMap
from ..canvas.marks import log_dots, log_shares
from ..canvas.page import log_tab
from ..canvas.palette import FREE, NOT_FREE, PLAIN, Color, PictureClass, robot_color, tint
from ..canvas.prose import described, numbers
from ..canvas.scale import Scale
from ..canvas.stream import send_changing
from .regions import base_legend, log_contacts
from .sight import MAX_MAPS, SEEN, log_sight, only_some, robot_table


# Number of steps of the patrol for each step of the covers.
_STRIDE = 20


def log_covers(map: CellMap, patrol: PatrolledMap) -> rrb.Container:
    """Log a tab that shows each robot's cover: cells from which it sees every cell it patrols."""
    views = []
    for robot, policy in enumerate(patrol.policies[:MAX_MAPS]):
        name, color, stops = f"cover_{robot}", robot_color(robot)[1], policy.cover
        patrolled = np.isin(np.arange(patrol.cells.positions), policy.cells)
        sees = patrol.visible[stops] & patrolled
        before = np.cumsum(sees, axis=0) - sees > 0
        kind = np.select([~patrolled & ~sees, before, sees], [4, 2, 3], 1)
        every, places = np.arange(stops.size), map.xy(stops)
        so_far = np.concatenate([places[: k + 1] for k in every])
        style = {"colors": color, "radii": 0.25 * patrol.cells.cell, "draw_order": 40}
        timelines = (("cover", 1 + every), ("step", _STRIDE * every))
        for line, at in timelines:
            map.picture(name, _cover_classes(robot), kind, line, at)
            to, counts = (map.stream, f"map/{name}/stops", rr.Points2D), 1 + every
            send_changing(*to, at, counts, line, style=style, positions=so_far)
        log_sight(map, patrol, f"map/{name}/outline", stops, color, *timelines)
        log_contacts(map, f"map/{name}/contact", [policy])
        title = f"Robot {robot}: {stops.size} cells"
        views.append(map.view(title, [f"grid/{name}", f"{name}/**", "base/**"]))
    # Without regions, every robot has all cells.
    legend: list[tuple[str, Color]] = [*_cover_classes(0)[1 : 4 + (patrol.regions is not None)]]
    legend.append(("a cell of the cover, and all that is seen from the last", robot_color(0)[1]))
    legend += base_legend(patrol)
    how = "Robot 0 takes the cell from which most unseen cells are seen, robot 1 the second best."
    if patrol.regions is not None:
        how = "Each robot takes the cell from which most unseen cells of its region are seen."
    text = f"""# Cells from which all cells are seen

{how} Choose the slider `cover` at the bottom left to go through them.{only_some(patrol)}

Within {patrol.reach:g} m, squares count as seen if {SEEN[patrol.sight]}.

{robot_table(patrol, "cover_size", "uncovered")}
"""
    return log_tab(map.stream, "cover", "Cover", views, text, legend, rows=(5, 4))


def _cover_classes(robot: int) -> list[PictureClass]:
    color = robot_color(robot)[1]
    return [
        NOT_FREE,
        PictureClass("not seen yet", FREE),
        PictureClass("seen from a cell before", tint(color, 0.75)),
        PictureClass("seen first from the last cell", tint(color, 0.4)),
        PictureClass("not for this robot", tint(PLAIN, 0.5)),
    ]


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
    text = _policy_text(patrol)
    return log_tab(map.stream, "policies", "Policies", views, text, legend, rows=(5, 4))


_BY_WEIGHTS = """From a cell it takes each edge with a probability in proportion to its weight. The
shortest closed tour through the cells of the cover has at least a given share of the weight. The
mean number of steps from a cell to another and back is the least possible."""


def _policy_text(patrol: PatrolledMap) -> str:
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
