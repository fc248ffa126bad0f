from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from ...patrol import PatrolledMap
from ...patrol.map import Policy, Regions
from ..canvas import palette
from ..canvas.map import CellMap
from ..canvas.marks import log_dots, log_labels
from ..canvas.page import log_tab
from ..canvas.palette import Color, PictureClass
from ..canvas.prose import numbers
from .sight import BASE_VIEW, robot_table


_BASE: Color = (0, 0, 0)
_CONTACT = palette.CATEGORIES["yellow"]


def log_base(map: CellMap, regions: Regions) -> None:
    side, base = map.cells.cell, np.array([regions.base])
    map.frames("base/station", base, _BASE, half=0.4 * side, width=3.0, order=45.0)
    at, ground = map.below(map.xy(base)[0], 0.7 * side)
    log_labels(map.stream, "map/base/label", [("base", *at.tolist())], [ground])


def log_contacts(map: CellMap, path: str, policies: Sequence[Policy]) -> None:
    """Log the cells where robots report to a base station, if there is one."""
    contacts = [policy.contact for policy in policies if policy.contact is not None]
    if contacts:
        xy = map.xy(np.array(contacts))
        log_dots(map.stream, path, xy, 0.25 * map.cells.cell, _CONTACT, 50.0)


def base_legend(patrol: PatrolledMap) -> list[tuple[str, Color]]:
    """Return the legend of the marks of a base station, if any."""
    if patrol.regions is None:
        return []
    return [
        ("a contact cell, where a robot reports", _CONTACT),
        ("the base station (black frame)", _BASE),
    ]


def log_regions(map: CellMap, patrol: PatrolledMap, regions: Regions) -> rrb.Container:
    """Log a tab that shows the regions around a base station, before and after a robot is lost."""
    after, robots = patrol.reassignment, list(range(patrol.robots))
    maps = [("Regions", "regions", regions, robots, patrol.policies)]
    if after is not None:
        owners = after.robot.tolist()
        (lost,) = set(robots) - set(owners)
        title = f"Without robot {lost}"
        maps.append((title, "regions_after", after.regions, owners, after.policies))
    # With more robots than colours, several robots share a colour.
    colors = palette.robots_by_color(patrol.robots)
    classes = [palette.NOT_FREE, PictureClass("only the base", BASE_VIEW)]
    legend: list[tuple[str, Color]] = []
    for alike, _, color in colors:
        patrols = PictureClass(f"robot {alike} patrols", palette.tint(color, 0.6))
        reports = PictureClass(f"robot {alike} reports", palette.tint(color, 0.25))
        classes += [patrols, reports]
        legend += [patrols, ("... in view of the base: it can report", reports.color)]
    legend += [*base_legend(patrol), ("in its view, patrolled by no robot", BASE_VIEW)]
    views = []
    for title, name, divided, owner, policies in maps:
        of = np.array([*owner, -1])[divided.region] % len(colors)
        kind = np.where(divided.region < 0, 1, 2 + 2 * of + divided.view)
        picture = map.picture(name, classes, kind)
        log_contacts(map, f"map/{name}_contacts", policies)
        views.append(map.view(title, [picture, f"{name}_contacts", "base/station", "base/label"]))
    text = f"""# A base station, and regions around it

Cells in view of the base station need no patrol, except those on the rim, where robots report. The
other cells are divided by the angle around the base.

{numbers(regions, patrol.cells)}

{robot_table(patrol, "cells_patrolled", "contact")}
"""
    if after is not None:
        text += f"""
## When robot {lost} is lost

A working robot is silent for **{after.silence_limit:,}** steps with a probability of at most 1 %; a
robot that is silent for longer counts as lost. The others divide the map as the second map shows,
each keeping most of its cells.
"""
    return log_tab(map.stream, "regions", "Base and regions", views, text, legend, rows=(5, 4))
