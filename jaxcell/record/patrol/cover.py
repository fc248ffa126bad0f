import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...patrol import PatrolledMap
from ..canvas.map import CellMap
from ..canvas.page import log_tab
from ..canvas.palette import FREE, NOT_FREE, PLAIN, Color, PictureClass, robot_color, tint
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
            map.picture(name, _classes(robot), kind, line, at)
            path, counts = f"map/{name}/stops", 1 + every
            send_changing(
                map.stream, path, rr.Points2D, at, counts, line, style=style, positions=so_far
            )
        log_sight(map, patrol, f"map/{name}/outline", stops, color, *timelines)
        log_contacts(map, f"map/{name}/contact", [policy])
        title = f"Robot {robot}: {stops.size} cells"
        views.append(map.view(title, [f"grid/{name}", f"{name}/**", "base/**"]))
    # Without regions, every robot has all cells.
    legend: list[tuple[str, Color]] = [*_classes(0)[1 : 4 + (patrol.regions is not None)]]
    legend.append(("a cell of the cover, and all that is seen from the last", robot_color(0)[1]))
    legend += base_legend(patrol)
    return log_tab(map.stream, "cover", "Cover", views, _text(patrol), legend, rows=(5, 4))


def _classes(robot: int) -> list[PictureClass]:
    color = robot_color(robot)[1]
    return [
        NOT_FREE,
        PictureClass("not seen yet", FREE),
        PictureClass("seen from a cell before", tint(color, 0.75)),
        PictureClass("seen first from the last cell", tint(color, 0.4)),
        PictureClass("not for this robot", tint(PLAIN, 0.5)),
    ]


def _text(patrol: PatrolledMap) -> str:
    if patrol.regions is None:
        how = (
            "Robot 0 takes the cell from which most unseen cells are seen, robot 1 the second best."
        )
    else:
        how = "Each robot takes the cell from which most unseen cells of its region are seen."
    return f"""# Cells from which all cells are seen

{how} Choose the slider `cover` at the bottom left to go through them.{only_some(patrol)}

Within {patrol.reach:g} m, squares count as seen if {SEEN[patrol.sight]}.

{robot_table(patrol, "cover_size", "uncovered")}
"""
