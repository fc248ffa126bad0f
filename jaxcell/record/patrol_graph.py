import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int

from ..optimize import Graph
from ..patrol.walks.game import StrategyGame
from ..patrol.walks.measures import Measures
from .blueprint import (
    legend_view,
    log_legend_style,
    log_legends,
    log_text,
    recording,
    send_blueprint,
)
from .canvas.matrix import log_matrix, matrix_view
from .canvas.page import log_legend
from .canvas.palette import (
    FREE,
    OBSTACLE,
    PLAIN,
    ROBOT,
    ROBOTS,
    TEXT,
    Color,
    LegendEntry,
    ramp,
    robot_color,
)
from .patrol_dataset import check_measures, edge_shares, vertex_names
from .patrol_game import log_game
from .patrol_text import patrol_text


_STEPS = 1000
# So many colours of vertices, over all steps, are a few MB.
_MOST_COLORS = 1_000_000
_SHADES = 6
_MOST_NAMES = 80
_MOST_CHANCES = 60
# What a solver leaves of a probability that is 0.
_NOTHING = 1e-9
_ONCE = np.zeros(1, np.int64)
# Where a patroller has been in its last steps.
_TRAIL = 4


def log_patrol_graph(
    path: str | os.PathLike[str],
    graph: Graph,
    measures: Measures,
    *,
    names: Sequence[str] | None = None,
    game: StrategyGame | None = None,
    robots: int = 1,
    seed: int = 0,
    spec: Mapping[str, Any] | None = None,
) -> None:
    """Writes a Rerun recording of a patroller's random walk on a graph.

    Over the timeline `step`: patrollers that walk, from places drawn from the stationary
    distribution, and how long ago each vertex was visited. Without time: how often each edge is
    walked, where a patroller goes next from each vertex, a heat map of the hitting times, and the
    payoffs and the mixture of a game.

    **Arguments:**

    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `graph`: a graph whose vertices have positions.
    - `measures`: those of the patroller's chain, of [`jaxcell.patrol.measure`][].
    - `names`: the name of each vertex; by default its number.
    - `game`: the game between strategies, if there is one.
    - `robots`: how many patrollers walk, each by itself.
    - `seed`: of their walks.
    - `spec`: what was asked for, shown in the text.

    **Raises:** `ValueError` if the graph has no positions, the measures or the game are not of its
    vertices, the chain takes other ways than its edges, or there are no robots.

    A random walk on a line of three vertices:

        >>> import pathlib, tempfile
        >>> from jaxcell import patrol, record
        >>> graph = patrol.Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [2, 0]])
        >>> measures = patrol.measure(patrol.random_walk(graph, [1, 1]))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.rrd")
        ...     record.log_patrol_graph(path, graph, measures)
        ...     path.stat().st_size > 1000
        True
    """
    check_measures(graph, measures, game)
    if graph.xy is None:
        raise ValueError("graph: its vertices have no positions; expected xy")
    if robots < 1:
        raise ValueError(f"robots: expected at least 1, got {robots}")
    names = vertex_names(graph, names)
    drawing = _Drawing(graph, graph.xy)
    walks = _walks(measures, robots, seed)
    with recording(path, "patrol_graph") as stream:
        stream.log("graph", rr.Transform3D(scale=[1, -1, 1]), static=True)
        _log_graph(stream, drawing, names)
        _log_shares(stream, drawing, measures, robots)
        _log_next(stream, drawing, measures)
        _log_walks(stream, drawing, walks)
        _log_idle(stream, drawing, walks)
        log_text(stream, "text", patrol_text(graph, measures, names, robots, spec or {}))
        tabs = [
            _walk_layout(drawing, walks),
            _next_layout(drawing),
            _log_times(stream, measures, names),
        ]
        if game is not None:
            tabs.append(log_game(stream, game, names))
        send_blueprint(stream, rrb.Tabs(*tabs, active_tab=0), "step", speed=4.0)


class _Drawing:
    """Where the graph is, and how large marks are on it."""

    def __init__(self, graph: Graph, xy: Float[np.ndarray, "vertices 2"]) -> None:
        self.graph = graph
        self.xy = xy
        self.low, self.high = xy.min(axis=0), xy.max(axis=0)
        # Vertices may all be in one place.
        self.extent = float((self.high - self.low).max()) or 1.0
        lengths = graph.lengths
        typical = float(np.median(lengths[lengths > 0])) if lengths.any() else self.extent
        self.mark = min(0.035 * self.extent, 0.16 * typical)
        "The radius of a large vertex."

    def view(self, name: str, contents: Sequence[str]) -> rrb.Spatial2DView:
        margin = 0.06 * self.extent + 2 * self.mark
        (left, bottom), (right, top) = self.low - margin, self.high + margin
        return rrb.Spatial2DView(
            origin="/",
            name=name,
            contents=[f"+ /graph/{one}" for one in contents],
            background=OBSTACLE,
            visual_bounds=rrb.VisualBounds2D(
                x_range=[float(left), float(right)], y_range=[float(-top), float(-bottom)]
            ),
        )


def _log_graph(stream: rr.RecordingStream, drawing: _Drawing, names: Sequence[str]) -> None:
    """Logs the names of the vertices, and thin edges."""
    labels = rr.Points2D(
        drawing.xy - [0, drawing.mark],
        labels=list(names),
        colors=TEXT,
        radii=0.001,
        show_labels=len(names) <= _MOST_NAMES,
        draw_order=60,
    )
    stream.log("graph/names", labels, static=True)
    ends = drawing.xy[drawing.graph.edges]
    line = rr.LineStrips2D(ends, colors=PLAIN, radii=rr.Radius.ui_points(1), draw_order=1)
    stream.log("graph/edges", line, static=True)


def _log_shares(
    stream: rr.RecordingStream, drawing: _Drawing, measures: Measures, robots: int
) -> None:
    """Logs the edges by the share of steps along them, and the vertices by that of time."""
    shares = edge_shares(drawing.graph, measures)
    ends = drawing.xy[drawing.graph.edges]
    _log_lines(stream, drawing, "graph/shares", ends, shares / shares.max())
    size = np.sqrt(measures.stationary / measures.stationary.max())
    discs = rr.Points2D(
        drawing.xy,
        colors=FREE,
        radii=drawing.mark * np.maximum(size, 0.1),
        labels=[f"{100 * share:.3g} % of the time" for share in measures.stationary.tolist()],
        show_labels=False,
        draw_order=20,
    )
    stream.log("graph/vertices", discs, static=True)
    marks = [("a vertex, larger with more time there", FREE)]
    marks += _legend_of_patrollers(robots)
    _log_legend(stream, "walk/legend", float(shares.max()), "of the steps", marks)


def _legend_of_patrollers(robots: int) -> list[tuple[str, Color]]:
    """The colours of the first patrollers; further ones have the same again."""
    if robots == 1:
        return [("the patroller", ROBOT)]
    return [(f"patroller {i}", color) for i, (_, color) in enumerate(ROBOTS[:robots])]


def _log_next(stream: rr.RecordingStream, drawing: _Drawing, measures: Measures) -> None:
    """Logs the half of each edge that is next to a vertex by the probability of leaving by it."""
    tail, head = np.concatenate([drawing.graph.edges, drawing.graph.edges[:, ::-1]]).T
    here, there = drawing.xy[tail], drawing.xy[head]
    chance, stay = measures.transition[tail, head], np.diag(measures.transition)
    most = float(measures.transition.max())
    # A gap in the middle keeps the halves apart.
    halves = np.stack([here, here + 0.48 * (there - here)], axis=1)
    _log_lines(stream, drawing, "graph/next", halves, chance / most)
    labels = rr.Points2D(
        halves.mean(axis=1),
        labels=[f"{one:.3f}" for one in chance.tolist()],
        colors=TEXT,
        radii=0.001,
        show_labels=chance.size <= _MOST_CHANCES,
        draw_order=60,
    )
    stream.log("graph/chances", labels, static=True)
    discs = rr.Points2D(
        drawing.xy,
        colors=np.where(stay[:, None] > _NOTHING, ramp(stay / most), FREE[:3]).astype(np.uint8),
        radii=0.6 * drawing.mark,
        labels=[f"stays with probability {one:.3g}" for one in stay.tolist()],
        show_labels=False,
        draw_order=20,
    )
    stream.log("graph/stay", discs, static=True)
    marks: list[tuple[str, Color]] = [("a vertex where it never waits", FREE)]
    _log_legend(stream, "next/legend", most, "chance to leave by it, or to wait", marks)


def _log_lines(
    stream: rr.RecordingStream,
    drawing: _Drawing,
    path: str,
    ends: Float[np.ndarray, "lines 2 2"],
    level: Float[np.ndarray, "lines"],
) -> None:
    """Logs lines that are wide and yellow where a number is near 1."""
    lines = rr.LineStrips2D(
        ends,
        colors=np.where(level[:, None] > _NOTHING, ramp(level), PLAIN).astype(np.uint8),
        radii=drawing.mark * (0.04 + 0.41 * level),
        draw_order=10,
    )
    stream.log(path, lines, static=True)


def _log_legend(
    stream: rr.RecordingStream,
    path: str,
    most: float,
    what: str,
    marks: Sequence[tuple[str, Color]],
) -> None:
    """Logs what the colours of lines mean, and some marks."""
    levels = np.linspace(1, 0, _SHADES)
    entries = [
        LegendEntry(row, f"{most * level:.3f} {what}", (red, green, blue))
        for row, (level, (red, green, blue)) in enumerate(
            zip(levels.tolist(), ramp(levels).tolist(), strict=True)
        )
    ]
    entries += [LegendEntry(_SHADES + i, *mark) for i, mark in enumerate(marks)]
    log_legend_style(stream, path)
    log_legends(stream, path, "step", _ONCE, [entries])


def _walks(measures: Measures, robots: int, seed: int) -> Int[np.ndarray, "times robots"]:
    """The vertices at which patrollers are, from starts in the stationary distribution."""
    vertices = measures.stationary.size
    steps = max(1, min(_STEPS, _MOST_COLORS // vertices))
    draw = np.random.default_rng(seed).random((steps + 1, robots))
    now = _drawn(np.tile(measures.stationary, (robots, 1)), draw[0])
    walks = [now]
    for chance in draw[1:]:
        now = _drawn(measures.transition[now], chance)
        walks.append(now)
    return np.stack(walks)


def _drawn(
    law: Float[np.ndarray, "robots vertices"], chance: Float[np.ndarray, "robots"]
) -> Int[np.ndarray, "robots"]:
    """A vertex from each law, by a number from 0 to 1."""
    up_to = np.cumsum(law, axis=1)
    # Sums of probabilities are 1 only to rounding.
    return (up_to <= chance[:, None] * up_to[:, -1:]).sum(axis=1)


def _log_walks(
    stream: rr.RecordingStream, drawing: _Drawing, walks: Int[np.ndarray, "times robots"]
) -> None:
    """Logs the patrollers with their last steps."""
    times, robots = walks.shape
    index = [rr.TimeColumn("step", sequence=np.arange(times))]
    for robot in range(robots):
        place = drawing.xy[walks[:, robot]]
        trail = [place[max(0, time - _TRAIL) : time + 1] for time in range(times)]
        # A strip of one point is none.
        trail[0] = place[[0, 0]]
        strips = rr.LineStrips2D.columns(strips=trail)
        color = robot_color(robot)[1]
        # A light rim, for an edge may have the colour of the patroller.
        for name, shown, wide, order in ("rim", TEXT, 3.5, 29.0), ("trail", color, 2.0, 30.0):
            path = f"graph/patrollers/{robot}/{name}"
            stream.send_columns(path, index, strips)
            line = rr.LineStrips2D.from_fields(
                colors=shown, radii=rr.Radius.ui_points(wide), draw_order=order
            )
            stream.log(path, line, static=True)
        here = rr.Points2D.columns(positions=place)
        stream.send_columns(f"graph/patrollers/{robot}/here", index, here)
        dot = rr.Points2D.from_fields(colors=color, radii=0.9 * drawing.mark, draw_order=40)
        stream.log(f"graph/patrollers/{robot}/here", dot, static=True)


def _log_idle(
    stream: rr.RecordingStream, drawing: _Drawing, walks: Int[np.ndarray, "times robots"]
) -> None:
    """Logs the steps since each vertex was visited, as colours, and the most as a curve."""
    times, vertices = len(walks), drawing.graph.vertices
    idle = np.empty((times, vertices), np.int64)
    # Before the first visit, the time since the beginning counts.
    now = np.zeros(vertices, np.int64)
    for time, here in enumerate(walks):
        now += 1
        now[here] = 0
        idle[time] = now
    longest = int(idle.max())
    level = 1 - np.log1p(idle.ravel()) / np.log1p(max(longest, 1))
    index = [rr.TimeColumn("step", sequence=np.arange(times))]
    colors = rr.Points2D.columns(colors=ramp(level))
    stream.send_columns("graph/idle", index, colors.partition(np.full(times, vertices)))
    discs = rr.Points2D.from_fields(
        positions=drawing.xy, radii=drawing.mark, draw_order=20, show_labels=False
    )
    stream.log("graph/idle", discs, static=True)
    series = rr.Scalars.columns(scalars=idle.max(axis=1))
    stream.send_columns("walk/longest", index, series)
    line = rr.SeriesLines(colors=ROBOT, widths=2, interpolation_mode="StepAfter")
    stream.log("walk/longest", line, static=True)


def _log_times(
    stream: rr.RecordingStream, measures: Measures, names: Sequence[str]
) -> rrb.Container:
    """Logs the hitting times as a heat map, with their means in the last row."""
    times = measures.hitting_times.copy()
    np.fill_diagonal(times, np.nan)
    table = np.concatenate([times, np.nanmean(times, axis=0, keepdims=True)])
    legend = log_matrix(stream, "times/matrix", table, [*names, "mean"], names, "steps")
    log_legend(stream, "times/legend", legend, "step")
    return rrb.Horizontal(
        matrix_view("times/matrix", "Expected steps from a row to a column", table.shape),
        legend_view("times/legend", len(legend)),
        column_shares=[3, 1],
        name="Hitting times",
    )


def _walk_layout(drawing: _Drawing, walks: Int[np.ndarray, "times robots"]) -> rrb.Container:
    times, robots = walks.shape
    boundary = rrb.TimeRangeBoundary.absolute
    # From the start to the end, not what is near the time that is shown.
    whole = rrb.TimeRange(start=boundary(seq=0), end=boundary(seq=times - 1))
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Horizontal(
                drawing.view("The walk", ["shares", "vertices", "names", "patrollers/**"]),
                drawing.view("Time since a visit", ["edges", "idle", "names"]),
            ),
            rrb.TimeSeriesView(
                origin="walk/longest",
                name="The longest time since a visit (steps)",
                axis_x=rrb.TimeAxis(view_range=whole),
                plot_legend=rrb.PlotLegend(visible=False),
            ),
            row_shares=[3, 1],
        ),
        rrb.Vertical(
            rrb.TextDocumentView(origin="text", name="What you see"),
            legend_view("walk/legend", _SHADES + 1 + len(_legend_of_patrollers(robots))),
            row_shares=[2, 1],
        ),
        column_shares=[3, 2],
        name="The walk",
    )


def _next_layout(drawing: _Drawing) -> rrb.Container:
    return rrb.Horizontal(
        drawing.view("Where a patroller goes next", ["next", "chances", "stay", "names"]),
        legend_view("next/legend", _SHADES + 1),
        column_shares=[3, 1],
        name="Where to next",
    )
