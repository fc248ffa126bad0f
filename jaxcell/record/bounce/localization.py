from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int

from ...automata import Filter
from ...bounce import Localization, Localized
from ..canvas.belief import MAX_ARROWS, log_beliefs
from ..canvas.curves import curve_view, log_curve
from ..canvas.map import CellMap
from ..canvas.marks import log_robot, points
from ..canvas.page import log_text
from ..canvas.palette import CURRENT, KNOWN, PLAIN, ROBOT, TEXT, TRAIL, cycle_color
from ..canvas.prose import bouncing, counted, degrees, made_with, table
from ..canvas.stream import send_blueprint
from .filter_drawing import Drawing, draw_filter
from .groups import log_group_tab


# A trail has so many corners at most; a run of n steps would else take n^2 points.
_MAX_CORNERS = 100
_MAX_OBSERVATIONS = 240
_MAX_ROWS = 12


def log_localization(stream: rr.RecordingStream, found: Localized, spec: Mapping[str, Any]) -> None:
    """Log a robot that is localized by its bumps.

    Over the timeline `step`: the robot and its trail, the cells where it may be, how many they
    are, and the path through the filter, drawn as a graph. The periodic groups are there too, for
    the heading of the robot on `step`, and over the timeline `direction`.
    """
    cells = found.cells
    drawing = draw_filter(found.filter, found.run.states)
    heading = found.run.path // cells.positions
    turns = np.flatnonzero(np.diff(heading, prepend=-1))
    every = np.arange(cells.directions)
    shown = {"direction": (every, every), "step": (turns, heading[turns])}
    map = CellMap(stream, cells)
    log_beliefs(stream, cells, found.beliefs)
    length = max(0.7 * cells.cell, 0.035 * map.extent)
    # Below the arrows of the belief, one of which lies on it as long as the filter is right.
    log_robot(
        stream,
        "map/robot",
        (found.robot_x, found.robot_y, found.robot_theta),
        length,
        ROBOT,
        trail="map/trail",
        trail_color=TRAIL,
        corners=_MAX_CORNERS,
        middle=0.0,
        order=18.0,
    )
    log_end(map, found.run)
    marks = ["grid/belief", "belief", "trail", "robot", "candidates", "truth"]
    maps = rrb.Vertical(
        map.view("Where the robot is, and where it may be", marks),
        _log_numbers(stream, found),
        row_shares=[7, 3],
    )
    text = log_text(stream, "text", _text(found, drawing, spec))
    graph = _log_graph(stream, found, drawing)
    beside = rrb.Vertical(text, graph, row_shares=[1, 1])
    tabs = [
        rrb.Horizontal(maps, beside, column_shares=[3, 2], name="Localization"),
        log_group_tab(map, found.groups, 0, "Groups", shown, spec),
    ]
    send_blueprint(stream, tabs, "step", float(np.clip(heading.size / 20, 2, 30)))


def log_end(map: CellMap, run: Localization) -> None:
    """Mark, at the last step, the cells that are left, and the truth."""
    stream, cells = map.stream, map.cells
    end = [rr.TimeColumn("step", sequence=[run.observations.size])]
    squares = map.xy(run.candidates[:MAX_ARROWS])
    half = max(0.5 * cells.cell, 0.014 * map.extent)
    boxes = rr.Boxes2D.columns(centers=squares, half_sizes=np.full(squares.shape, half))
    stream.send_columns("map/candidates", end, boxes.partition([len(squares)]))
    line = rr.Boxes2D.from_fields(colors=KNOWN, radii=points(2.5), draw_order=30)
    stream.log("map/candidates", line, static=True)

    below = map.xy(run.path[-1:]) - np.array([0, half])
    truth = rr.Points2D.columns(positions=below, labels=["the truth"])
    stream.send_columns("map/truth", end, truth)
    style = rr.Points2D.from_fields(colors=TEXT, radii=0.001, show_labels=True, draw_order=50)
    stream.log("map/truth", style, static=True)


def log_turns(
    map: CellMap,
    xy: Float[np.ndarray, "times 2"],
    turned_by: Int[np.ndarray, "times"],
    bounces: Float[np.ndarray, "angles"],
) -> None:
    """Log by which of its angles the robot turns at a bump, when it is there."""
    bumps = np.flatnonzero(turned_by >= 0)
    labels = [
        f"bump {i}: turn by {degrees(bounces[turn])}"
        for i, turn in enumerate(turned_by[bumps].tolist(), 1)
    ]
    text = rr.Points2D.columns(positions=xy[bumps], labels=labels)
    index = [rr.TimeColumn("step", sequence=np.arange(turned_by.size))]
    map.stream.send_columns("map/turn", index, text.partition((turned_by >= 0).astype(int)))
    style = rr.Points2D.from_fields(colors=TEXT, radii=0.001, show_labels=True, draw_order=60.0)
    map.stream.log("map/turn", style, static=True)


def _log_graph(stream: rr.RecordingStream, found: Localized, drawing: Drawing) -> rrb.View:
    """Log the filter as a graph in which the states that were visited light up."""
    filter, run = found.filter, found.run
    size = filter.uncertainty[drawing.state]
    # The name of a node is what hovering shows.
    names = {
        state: f"state {state}: {counted(cells, 'cell').replace(',', '')}"
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
    lengths = [drawing.state.size] * times.size
    stream.send_columns("filter/graph", _steps(found), columns.partition(lengths))
    left, top = drawing.position.min(axis=0) - 40
    right, bottom = drawing.position.max(axis=0) + 40
    return rrb.GraphView(
        origin="filter/graph",
        name="The filter",
        visual_bounds=rrb.VisualBounds2D(x_range=[left, right], y_range=[top, bottom]),
    )


def _log_numbers(stream: rr.RecordingStream, found: Localized) -> rrb.Container:
    """Log the numbers that change along the run."""
    size, last = found.belief_size, found.run.observations.size
    log_curve(stream, "filter/uncertainty", size, shape="Linear")
    log_curve(stream, "filter/bits", np.log2(np.maximum(size, 1)), shape="Linear")
    # A step ends with its observation, so what follows from it is drawn from the step before.
    bumps = np.append(0, np.cumsum(found.run.observations))
    log_curve(stream, "robot/bumps", bumps, color=ROBOT, shape="StepBefore")
    log_curve(stream, "filter/color", found.belief_color, color=KNOWN, shape="StepBefore")
    return rrb.Horizontal(
        curve_view("filter/uncertainty", "Cells left", last, int(size.max())),
        curve_view("filter/bits", "The same, log2", last),
        curve_view("robot/bumps", "Bumps so far", last, int(bumps[-1])),
        curve_view("filter/color", "Filter's colour", last, int(found.belief_color.max())),
    )


def _steps(found: Localized) -> list[rr.TimeColumn]:
    return [rr.TimeColumn("step", sequence=np.arange(found.run.path.size))]


def _text(found: Localized, drawing: Drawing, spec: Mapping[str, Any]) -> str:
    """What the recording of a localization shows."""
    run = found.run
    word = run.word[:_MAX_OBSERVATIONS] + "..." * (len(run.word) > _MAX_OBSERVATIONS)
    return f"""# Where is the robot?

{bouncing(found.bounce)} It has a map, a bump sensor and a clock. This run
makes {len(run.word):,} observations (0: it moved, 1: it bumped):

`{word or "none"}`

{_outcome(found)}

## How to look

Press play, or drag `step` at the bottom.

- **vermilion arrow**: the robot, unseen by the filter, and its trail.
- **blue arrows**: the cells where it may be; blue squares, while these are more than
  {MAX_ARROWS:,}.
- **green squares**, at the end: the cells that are left.

The tab **Groups** shows where all cells lead in the end, over the slider `direction`.

## {counted(len(found.filter.cycles), "knowledge cycle")}

A dot is a set of cells, violet where the filter is, vermilion where it was.
{_drawn(found.filter, drawing)} A coloured loop is a *knowledge cycle*, which nothing leaves:

{_cycles(found)}

{made_with(spec, found.cells)}"""


def _outcome(found: Localized) -> str:
    state, filter = int(found.run.states[-1]), found.filter
    if state == filter.trap:
        return "The last of them cannot occur on this map: the robot is **somewhere else**."
    count = int(filter.uncertainty[state])
    if filter.color[state] == 1:
        return f"In the end it may be in {count:,} cells: it is **not localized** yet."
    where = "it is in **one** cell" if count == 1 else f"it is in one of **{count:,}** cells"
    truth = "" if found.run.truth_is_a_candidate else ", but the truth is **not** among them"
    return f"Then it is **localized**: {where}{truth}."


def _drawn(filter: Filter, drawing: Drawing) -> str:
    if drawing.whole:
        return "Each column is one observation farther from the start."
    left_out = f"; {drawing.cycles_left_out:,} cycles are left out" * bool(drawing.cycles_left_out)
    return (
        f"There are {len(filter.transition):,}, too many to draw: these are the last of this run, "
        f"in the rows at the top, and knowledge cycles{left_out}."
    )


def _cycles(found: Localized) -> str:
    cycles = found.filter.cycles
    rows: list[tuple[object, ...]] = [
        (f"{one.color} ({cycle_color(one.color)[0]})", one.uncertainty, len(one.states))
        for one in cycles[:_MAX_ROWS]
    ]
    doubt = found.cycle_uncertainty[_MAX_ROWS:]
    if doubt.size:
        rows.append((f"{doubt.size:,} more", f"{doubt.min()} to {doubt.max()}", ""))
    return table(("colour", "uncertainty (cells)", "length"), rows)
