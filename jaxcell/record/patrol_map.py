import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..patrol import Policy
from .blueprint import (
    legend_view,
    log_classes,
    log_legend_style,
    log_legends,
    log_map,
    log_pictures,
    log_text,
    map_view,
    recording,
    send_blueprint,
)
from .canvas.palette import (
    CATEGORIES,
    CLEAR,
    FREE,
    PLAIN,
    TEXT,
    Color,
    LegendEntry,
    PictureClass,
    mix,
    ramp,
    robot_color,
)
from .map_patrol import BASE_VIEW, MapPatrol
from .outlines import log_outline_style, log_outlines, outlines
from .patrol_attacks import attacks_layout, log_attacks, simulate_attacks
from .patrol_map_text import cover_text, patrol_text, policies_text, regions_text
from .patrol_target import log_target, log_vulnerability
from .pictures import on_squares


_ONCE = np.zeros(1, np.int64)
# Robots that have maps of their own.
_MOST_MAPS = 6
# Steps of the patrol for each step of the covers.
_STRIDE = 20
_SHADES = 6
_BASE: Color = (0, 0, 0)
_CONTACT = CATEGORIES["yellow"]
# Robots past these have the colours of others.
_COLORS = 8


def log_patrol_map(
    path: str | os.PathLike[str],
    patrol: MapPatrol,
    *,
    seed: int = 0,
    spec: Mapping[str, Any] | None = None,
) -> None:
    """Writes a Rerun recording of robots that patrol a map with limited visibility.

    Over the timeline `step`: the robots with what they see, and an adversary that attacks one cell
    again and again. Over the timeline `cover`, and more slowly over `step`: the cells from which
    each robot sees all that it walks on, one by one. Without time: how often each robot takes a
    way; the base station and the regions around it; how long it takes until a robot sees the cell
    that is attacked, in three ways; and the probability of capture at each cell.

    **Arguments:**

    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `patrol`: the patrol.
    - `seed`: of the walks and the attacks that are shown.
    - `spec`: what was asked for, shown in the text.

    One robot in a corridor of four cells, each of which sees its neighbours:

        >>> import jax, pathlib, tempfile
        >>> from jaxcell import patrol, record, space
        >>> room = space.Workspace([(0, 0), (4, 0), (4, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 1)
        >>> graph, visible = patrol.cell_graph(cells), space.visible_cells(cells, 1.6)
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> problem = graph, visible, policies
        >>> attack = patrol.vulnerability(jax.random.key(0), *problem, 0, [2], runs=5)
        >>> capture = patrol.capture_probabilities(*problem, [2])
        >>> found = record.MapPatrol(cells, 1.6, *problem, attack, capture)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.rrd")
        ...     record.log_patrol_map(path, found)
        ...     path.stat().st_size > 1000
        True
    """
    attacks = simulate_attacks(patrol, seed)
    with recording(path, "patrol_map") as stream:
        log_map(stream, patrol.cells)
        _log_base(stream, patrol)
        log_attacks(stream, patrol, attacks)
        log_text(stream, "text", patrol_text(patrol, attacks, spec or {}))
        tabs = [
            attacks_layout(patrol, attacks),
            _log_covers(stream, patrol),
            _log_policies(stream, patrol),
            log_target(stream, patrol),
            log_vulnerability(stream, patrol),
        ]
        if patrol.regions is not None:
            tabs.insert(1, _log_regions(stream, patrol))
        send_blueprint(stream, rrb.Tabs(*tabs, active_tab=0), "step", speed=4.0)


def _log_base(stream: rr.RecordingStream, patrol: MapPatrol) -> None:
    """Logs the base station, if there is one."""
    if patrol.regions is None:
        return
    xy, cell = patrol.xy, patrol.cells.cell
    base = xy[[patrol.regions.base]]
    half = [[0.4 * cell, 0.4 * cell]]
    mark = rr.Boxes2D(
        centers=base, half_sizes=half, colors=_BASE, radii=rr.Radius.ui_points(3), draw_order=45
    )
    stream.log("map/base/station", mark, static=True)
    _log_labels(stream, "map/base/label", base - [0, 0.7 * cell], ["base"])


def _log_contacts(
    stream: rr.RecordingStream, patrol: MapPatrol, path: str, policies: Sequence[Policy]
) -> None:
    """Logs where robots report, if there is a base station."""
    contact = [policy.contact for policy in policies if policy.contact is not None]
    if not contact:
        return
    radius = 0.25 * patrol.cells.cell
    dots = rr.Points2D(patrol.xy[contact], colors=_CONTACT, radii=radius, draw_order=50)
    stream.log(path, dots, static=True)


def _log_covers(stream: rr.RecordingStream, patrol: MapPatrol) -> rrb.Container:
    """Logs the cells of each cover one by one, with what is seen from them."""
    xy, cell = patrol.xy, patrol.cells.cell
    shown = min(patrol.robots, _MOST_MAPS)
    for robot, policy in enumerate(patrol.policies[:shown]):
        name = f"cover_{robot}"
        color = robot_color(robot)[1]
        stops = policy.cover
        patrolled = np.isin(np.arange(patrol.cells.positions), policy.cells)
        sees = patrol.visible[stops] & patrolled
        before = np.cumsum(sees, axis=0) - sees > 0
        kind = np.ones(sees.shape, np.uint8)
        kind[:, ~patrolled] = 4
        kind[before] = 2
        kind[sees & ~before] = 3
        log_classes(stream, f"map/grid/{name}", _cover_classes(robot))
        rings = outlines(patrol, stops)
        for timeline, times in (
            ("cover", 1 + np.arange(stops.size)),
            ("step", _STRIDE * np.arange(stops.size)),
        ):
            pictures = on_squares(patrol.cells, kind)
            log_pictures(stream, f"map/grid/{name}", timeline, times, pictures)
            log_outlines(stream, f"map/{name}/outline", timeline, times, rings)
            so_far = [xy[stops[: k + 1]] for k in range(stops.size)]
            dots = rr.Points2D.columns(positions=np.concatenate(so_far))
            index = [rr.TimeColumn(timeline, sequence=times)]
            stream.send_columns(
                f"map/{name}/stops", index, dots.partition([len(some) for some in so_far])
            )
        log_outline_style(stream, f"map/{name}/outline", color)
        style = rr.Points2D.from_fields(colors=color, radii=0.25 * cell, draw_order=40)
        stream.log(f"map/{name}/stops", style, static=True)
        _log_contacts(stream, patrol, f"map/{name}/contact", [policy])
    entries = [(one.label, one.color) for one in _cover_classes(0)[1:]]
    if patrol.regions is None:
        del entries[-1]
    entries.append(("a cell of the cover, and all that is seen from the last", robot_color(0)[1]))
    entries += _base_entries(patrol)
    for timeline in ("cover", "step"):
        _log_legend(stream, "cover/legend", entries, timeline)
    log_text(stream, "cover/text", cover_text(patrol, shown))
    views = [
        map_view(
            patrol.cells,
            f"Robot {robot}: {policy.cover.size} cells",
            [f"grid/cover_{robot}", f"cover_{robot}/**", "base/**"],
        )
        for robot, policy in enumerate(patrol.policies[:shown])
    ]
    return _tab("Cover", views, "cover", len(entries))


def _cover_classes(robot: int) -> list[PictureClass]:
    color = robot_color(robot)[1]
    return [
        PictureClass("not free", CLEAR),
        PictureClass("not seen yet", FREE),
        PictureClass("seen from a cell before", mix(color, FREE, 0.75)),
        PictureClass("seen first from the last cell", mix(color, FREE, 0.4)),
        PictureClass("not for this robot", mix(PLAIN, FREE, 0.5)),
    ]


def _log_policies(stream: rr.RecordingStream, patrol: MapPatrol) -> rrb.Container:
    """Logs the ways of each robot, wide and yellow where it often takes them."""
    xy, cell = patrol.xy, patrol.cells.cell
    shown = min(patrol.robots, _MOST_MAPS)
    ends = xy[patrol.graph.edges]
    most = max(float(policy.weights.max()) for policy in patrol.policies[:shown])
    for robot, policy in enumerate(patrol.policies[:shown]):
        some = policy.weights > 0
        level = policy.weights[some] / most
        lines = rr.LineStrips2D(
            ends[some],
            colors=ramp(level),
            radii=cell * (0.015 + 0.13 * level),
            # What is wide lies on top.
            draw_order=15,
        )
        stream.log(f"map/policy_{robot}/ways", lines, static=True)
        dots = rr.Points2D(
            xy[policy.cover], colors=robot_color(robot)[1], radii=0.25 * cell, draw_order=30
        )
        stream.log(f"map/policy_{robot}/cover", dots, static=True)
        _log_contacts(stream, patrol, f"map/policy_{robot}/contact", [policy])
    levels = np.linspace(1, 0, _SHADES)
    entries: list[tuple[str, Color]] = [
        (f"{most * level:.2g} of the steps", (red, green, blue))
        for level, (red, green, blue) in zip(levels.tolist(), ramp(levels).tolist(), strict=True)
    ]
    entries.append(("a cell of the cover", robot_color(0)[1]))
    entries += _base_entries(patrol)
    _log_legend(stream, "policies/legend", entries)
    log_text(stream, "policies/text", policies_text(patrol, shown))
    views = [
        map_view(patrol.cells, f"Robot {robot}", [f"policy_{robot}/**", "base/**"])
        for robot in range(shown)
    ]
    return _tab("Policies", views, "policies", len(entries))


def _log_regions(stream: rr.RecordingStream, patrol: MapPatrol) -> rrb.Container:
    """Logs the regions around the base station, and those after a robot is lost."""
    assert patrol.regions is not None
    after = patrol.reassignment
    robots = list(range(patrol.robots))
    maps = [("Regions", "regions", patrol.regions, robots, patrol.policies)]
    if after is not None:
        (lost,) = set(robots) - set(after.robot.tolist())
        title = f"Without robot {lost}"
        taken = after.robot.tolist()
        maps.append((title, "regions_after", after.regions, taken, after.policies))
    views = []
    colors = [robot_color(robot)[1] for robot in robots[:_COLORS]]
    for title, name, regions, owner, policies in maps:
        classes = [PictureClass("not free", CLEAR), PictureClass("only the base", BASE_VIEW)]
        for robot, color in enumerate(colors):
            classes.append(PictureClass(f"robot {robot} patrols", mix(color, FREE, 0.6)))
            classes.append(PictureClass(f"robot {robot} reports", mix(color, FREE, 0.25)))
        of = np.array([*owner, -1])[regions.region] % len(colors)
        kind = np.where(regions.region < 0, 1, 2 + 2 * of + regions.view).astype(np.uint8)
        log_classes(stream, f"map/grid/{name}", classes)
        picture = rr.SegmentationImage(on_squares(patrol.cells, kind))
        stream.log(f"map/grid/{name}", picture, static=True)
        _log_contacts(stream, patrol, f"map/{name}_contacts", policies)
        shown = [f"grid/{name}", f"{name}_contacts", "base/station", "base/label"]
        views.append(map_view(patrol.cells, title, shown))
    entries: list[tuple[str, Color]] = []
    for robot, color in enumerate(colors):
        entries.append((f"robot {robot} patrols", mix(color, FREE, 0.6)))
        entries.append(("... in view of the base: it can report", mix(color, FREE, 0.25)))
    entries += [*_base_entries(patrol), ("in its view, patrolled by nobody", BASE_VIEW)]
    _log_legend(stream, "regions/legend", entries)
    log_text(stream, "regions/text", regions_text(patrol))
    return _tab("Base and regions", views, "regions", len(entries))


def _base_entries(patrol: MapPatrol) -> list[tuple[str, Color]]:
    if patrol.regions is None:
        return []
    return [
        ("a contact cell, where a robot reports", _CONTACT),
        ("the base station (black frame)", _BASE),
    ]


def _tab(name: str, views: Sequence[rrb.View], path: str, rows: int) -> rrb.Container:
    columns = math.ceil(math.sqrt(len(views)))
    text = rrb.TextDocumentView(origin=f"{path}/text", name="What you see")
    legend = legend_view(f"{path}/legend", rows)
    parts: list[rrb.Container | rrb.View]
    # Where the grid has a hole, the legend fills it.
    if len(views) % columns:
        parts = [rrb.Grid(*views, legend, grid_columns=columns), text]
    else:
        parts = [
            rrb.Grid(*views, grid_columns=columns),
            rrb.Vertical(text, legend, row_shares=[5, 4]),
        ]
    return rrb.Horizontal(*parts, column_shares=[7, 3], name=name)


def _log_legend(
    stream: rr.RecordingStream,
    path: str,
    entries: Sequence[tuple[str, Color]],
    timeline: str = "step",
) -> None:
    log_legend_style(stream, path)
    legend = [LegendEntry(row, *entry) for row, entry in enumerate(entries)]
    log_legends(stream, path, timeline, _ONCE, [legend])


def _log_labels(
    stream: rr.RecordingStream, path: str, where: np.ndarray, labels: Sequence[str]
) -> None:
    text = rr.Points2D(
        where, labels=list(labels), colors=TEXT, radii=0.001, show_labels=True, draw_order=60
    )
    stream.log(path, text, static=True)
