import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Integer

from ..automata import Filter
from ..bounce import Localization
from ..mapping import PeriodicGroups
from ..space import CellSpace
from .belief import (
    MOST_ARROWS,
    arrows,
    belief_length,
    log_belief_style,
    log_shades,
    shades,
)
from .blueprint import (
    extent,
    log_map,
    log_pictures,
    log_text,
    map_view,
    recording,
    send_blueprint,
)
from .canvas.palette import (
    BELIEF,
    CURRENT,
    KNOWN,
    PLAIN,
    ROBOT,
    TEXT,
    TRAIL,
    Color,
    cycle_color,
)
from .graph import Drawing, draw_filter
from .groups import groups_layout, log_group_pictures, log_group_style
from .pictures import group_pictures
from .tables import check_filter, group_table, host_groups
from .texts import groups_text, localization_text


# A trail has so many corners at most; a run of n steps would else take n^2 points.
_MOST_CORNERS = 100


def log_localization(
    path: str | os.PathLike[str],
    cells: CellSpace,
    groups: PeriodicGroups,
    filter: Filter,
    localization: Localization,
    *,
    bounce: float,
    spec: Mapping[str, Any] | None = None,
) -> None:
    """Writes a Rerun recording of a robot that is localized by its bumps.

    Over the timeline `step`: the robot and its trail, the cells where it may be, how many they
    are, and the way through the filter, drawn as a graph. The periodic groups are there too, for
    the heading of the robot on `step`, and over the timeline `direction`.

    **Arguments:**

    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `cells`: the cell space.
    - `groups`: the groups of the bounce map.
    - `filter`: the localization filter of that map.
    - `localization`: the run.
    - `bounce`: the bouncing angle, in radians.
    - `spec`: what was asked for, shown in the text.

    **Raises:** `ValueError` if the groups, the filter or the run are not of these cells.

    A corridor of three cells, and a robot that turns left at every bump:

        >>> import math
        >>> import pathlib
        >>> import tempfile
        >>> from jaxcell import bounce, mapping, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> found = bounce.bounce_map(cells, math.pi / 2)
        >>> filter = bounce.localization_filter(found)
        >>> run = bounce.localize(found, filter, start=0)
        >>> groups = mapping.periodic_groups(found.image)
        >>> what = cells, groups, filter, run
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.rrd")
        ...     record.log_localization(path, *what, bounce=math.pi / 2)
        ...     path.stat().st_size > 1000
        True
    """
    check_filter(cells, filter, localization)
    ((angle, host),) = zip(*host_groups(cells, groups, float(bounce)), strict=True)
    spec = spec or {}
    table = group_table(cells, host)
    pictures = group_pictures(cells, host, table)
    drawing = draw_filter(filter, localization.states)
    name = f"bounce_{math.degrees(angle):.6g}"
    text = localization_text(cells, angle, filter, localization, drawing, MOST_ARROWS, spec)

    with recording(path, "localization") as stream:
        log_map(stream, cells)
        _log_belief(stream, cells, filter, localization)
        _log_robot(stream, cells, localization)
        _log_end(stream, cells, localization)
        _log_graph(stream, filter, localization, drawing)
        _log_series(stream, filter, localization)
        log_text(stream, "text", text)

        heading = localization.path // cells.positions
        turns = np.flatnonzero(np.diff(heading, prepend=-1))
        every = np.arange(cells.directions)
        log_group_style(stream, name, pictures)
        log_group_pictures(stream, name, pictures, "direction", every, every)
        log_group_pictures(stream, name, pictures, "step", turns, heading[turns])
        log_text(stream, f"{name}/text", groups_text(cells, angle, table, spec))
        tabs = rrb.Tabs(_layout(cells, drawing), groups_layout(cells, name, "Groups"), active_tab=0)
        send_blueprint(stream, tabs, "step", speed=float(np.clip(heading.size / 20, 2, 30)))


def _log_belief(
    stream: rr.RecordingStream, cells: CellSpace, filter: Filter, run: Localization
) -> None:
    """Logs where the robot may be: arrows, or shaded squares while there are too many."""
    size = filter.uncertainty[run.states]
    shown = np.where(size <= MOST_ARROWS, size, 0)
    beliefs = [filter.cells(state) for state in run.states[shown > 0].tolist()]
    where = np.concatenate([*beliefs, np.empty(0, np.int32)])
    columns = _arrows(cells, where, belief_length(cells))
    stream.send_columns("map/belief", _steps(run), columns.partition(shown))
    log_belief_style(stream, cells)

    crowded = np.flatnonzero(size > MOST_ARROWS)
    if crowded.size:
        log_shades(stream)
        times = np.arange(min(crowded[-1] + 2, size.size))
        states = run.states[times].tolist()
        pictures = np.stack([shades(cells, filter.cells(state)) for state in states])
        log_pictures(stream, "map/grid/belief", "step", times, pictures)


def _log_robot(stream: rr.RecordingStream, cells: CellSpace, run: Localization) -> None:
    """Logs the robot and its trail, which has its corners where it bumped."""
    length = max(0.7 * cells.cell, 0.035 * extent(cells))
    stream.send_columns("map/robot", _steps(run), _arrows(cells, run.path, length))
    # Below the arrows of the belief, one of which lies on it as long as the filter is right.
    style = rr.Arrows2D.from_fields(colors=ROBOT, radii=length / 7, draw_order=18)
    stream.log("map/robot", style, static=True)

    x, y, _ = cells.centre(run.path)
    place = np.stack([x, y], axis=1)
    corner = np.append(0, 1 + np.flatnonzero(run.observations == 1))
    trail = []
    for time in range(run.path.size):
        past = corner[: np.searchsorted(corner, time, side="right")][-_MOST_CORNERS:]
        trail.append(place[np.append(past, time)])
    stream.send_columns("map/trail", _steps(run), rr.LineStrips2D.columns(strips=trail))
    line = rr.LineStrips2D.from_fields(colors=TRAIL, radii=rr.Radius.ui_points(1.5), draw_order=15)
    stream.log("map/trail", line, static=True)


def _log_end(stream: rr.RecordingStream, cells: CellSpace, run: Localization) -> None:
    """Marks, at the last step, the cells that are left, and the truth."""
    end = [rr.TimeColumn("step", sequence=[run.observations.size])]
    x, y, _ = cells.centre(run.candidates[:MOST_ARROWS])
    half = max(0.5 * cells.cell, 0.014 * extent(cells))
    boxes = rr.Boxes2D.columns(
        centers=np.stack([x, y], axis=1), half_sizes=np.full((x.size, 2), half)
    )
    stream.send_columns("map/candidates", end, boxes.partition([x.size]))
    line = rr.Boxes2D.from_fields(colors=KNOWN, radii=rr.Radius.ui_points(2.5), draw_order=30)
    stream.log("map/candidates", line, static=True)

    x, y, _ = cells.centre(run.path[-1:])
    truth = rr.Points2D.columns(positions=np.stack([x, y - half], axis=1), labels=["the truth"])
    stream.send_columns("map/truth", end, truth)
    style = rr.Points2D.from_fields(colors=TEXT, radii=0.001, show_labels=True, draw_order=50)
    stream.log("map/truth", style, static=True)


def _log_graph(
    stream: rr.RecordingStream, filter: Filter, run: Localization, drawing: Drawing
) -> None:
    """Logs the filter as a graph in which the states that were visited light up."""
    size = filter.uncertainty[drawing.state]
    # The name of a node is what hovering shows.
    names = {
        state: f"state {state}: {cells} {'cell' if cells == 1 else 'cells'}"
        for state, cells in zip(drawing.state.tolist(), size.tolist(), strict=True)
    }
    nodes = rr.GraphNodes.from_fields(
        node_ids=list(names.values()), positions=drawing.position, show_labels=False
    )
    stream.log("filter/graph", nodes, static=True)
    pairs = [(names[a], names[b]) for a, b in drawing.edge.tolist()]
    stream.log("filter/graph", rr.GraphEdges(pairs, graph_type="directed"), static=True)

    times = np.arange(run.states.size)[:, None]
    first, where = np.unique(run.states, return_index=True)
    since = np.full(len(filter.transition), times.size)
    since[first] = where
    outside = (filter.color[drawing.state] == 1) | (size == 0)
    plain = [
        PLAIN if grey else cycle_color(color)[1]
        for grey, color in zip(outside, filter.color[drawing.state].tolist(), strict=True)
    ]
    here = run.states[:, None] == drawing.state
    been = (since[drawing.state] <= times) & outside
    colors = np.where(been[..., None], np.array(ROBOT), np.array(plain))
    colors = np.where(here[..., None], np.array(CURRENT), colors).astype(np.uint8)
    radii = 4 + 0.45 * np.log2(1 + size) + 5 * here
    columns = rr.GraphNodes.columns(colors=colors.reshape(-1, 3), radii=radii.ravel())
    stream.send_columns(
        "filter/graph", _steps(run), columns.partition([drawing.state.size] * times.size)
    )


def _log_series(stream: rr.RecordingStream, filter: Filter, run: Localization) -> None:
    """Logs the numbers that change along the run."""
    size = filter.uncertainty[run.states]
    linear = rr.SeriesLines(colors=BELIEF, widths=2)
    series = {
        "filter/uncertainty": (size, linear),
        "filter/bits": (np.log2(np.maximum(size, 1)), linear),
        # A step ends with its observation, so what follows from it is drawn from the step before.
        "filter/color": (filter.color[run.states], _stairs(KNOWN)),
        "robot/bumped": (np.append(0, run.observations), _stairs(ROBOT)),
    }
    for path, (values, line) in series.items():
        stream.send_columns(path, _steps(run), rr.Scalars.columns(scalars=values))
        stream.log(path, line, static=True)


def _stairs(color: Color) -> rr.SeriesLines:
    return rr.SeriesLines(colors=color, widths=2, interpolation_mode="StepBefore")


def _steps(run: Localization) -> list[rr.TimeColumn]:
    return [rr.TimeColumn("step", sequence=np.arange(run.path.size))]


def _arrows(
    cells: CellSpace, where: Integer[np.ndarray, "arrows"], length: float
) -> rr.ComponentColumnList:
    origins, vectors = arrows(cells, where, length)
    return rr.Arrows2D.columns(origins=origins, vectors=vectors)


def _layout(cells: CellSpace, drawing: Drawing) -> rrb.Container:
    shown = ["grid/belief", "belief", "trail", "robot", "candidates", "truth"]
    left, top = drawing.position.min(axis=0) - 40
    right, bottom = drawing.position.max(axis=0) + 40
    graph = rrb.GraphView(
        origin="filter/graph",
        name="The filter",
        visual_bounds=rrb.VisualBounds2D(x_range=[left, right], y_range=[top, bottom]),
    )
    return rrb.Horizontal(
        rrb.Vertical(
            map_view(cells, "Where the robot is, and where it may be", shown),
            rrb.Horizontal(
                _plot("Cells where it may be", "filter/uncertainty"),
                _plot("The same in bits (log2)", "filter/bits"),
                _plot("Bumps (1) and steps (0)", "robot/bumped"),
                _plot("Colour of the filter", "filter/color"),
            ),
            row_shares=[7, 3],
        ),
        rrb.Vertical(
            rrb.TextDocumentView(origin="text", name="What you see"), graph, row_shares=[1, 1]
        ),
        column_shares=[3, 2],
        name="Localization",
    )


def _plot(name: str, origin: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=False))
