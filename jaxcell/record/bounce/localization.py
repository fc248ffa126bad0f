import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...automata import Filter
from ...bounce import Localized
from ..canvas.curves import curve
from ..canvas.map import CellMap, directions_shown
from ..canvas.page import log_tab, log_text
from ..canvas.palette import CURRENT, KNOWN, PLAIN, ROBOT, Color, cycle_color
from ..canvas.prose import Spec, bouncing, counted, described, made_with
from ..canvas.stream import pace, send_blueprint
from .filter_drawing import Drawing, draw_filter
from .groups import log_group_tab
from .run import SEEN, log_localized, log_states, observed, run_legend


_MAX_ROWS = 12


def log_localization(stream: rr.RecordingStream, localized: Localized, spec: Spec) -> None:
    """Record a robot that is localized from its bumps."""
    drawing = draw_filter(localized.filter, localized.run.states)
    map, colors = CellMap(stream, localized.cells), localized.belief_color
    path, title, most = "filter/color", "Filter's colour", int(colors.max())
    color = curve(stream, path, title, colors, most, color=KNOWN, shape="StepBefore")
    maps = log_localized(map, localized, "filter", curves=[color])
    shown = directions_shown(localized.cells, localized.run.path)
    text = log_text(stream, "text", _text(localized, drawing, spec))
    graph = _log_graph(stream, localized, drawing)
    side = log_tab(stream, "filter", "Filter", graph, "", _legend(map, localized), shares=(1, 1))
    beside = rrb.Vertical(text, side, row_shares=[1, 1])
    tabs = [
        rrb.Horizontal(maps, beside, column_shares=[3, 2], name="Localization"),
        log_group_tab(map, localized.groups, 0, "Groups", shown, spec),
    ]
    send_blueprint(stream, tabs, "step", pace(localized.run.path.size))


def _log_graph(stream: rr.RecordingStream, localized: Localized, drawing: Drawing) -> rrb.View:
    """Log the filter as a graph, in which the states that the run visits are highlighted."""
    filter, run, drawn = localized.filter, localized.run, drawing.state
    size = filter.uncertainty[drawn]
    names = {
        state: f"state {state}: {counted(cells, 'cell').replace(',', '')}"
        for state, cells in zip(drawn.tolist(), size.tolist(), strict=True)
    }
    times = np.arange(run.states.size)[:, None]
    first, where = np.unique(run.states, return_index=True)
    since = np.full(len(filter.transition), times.size)
    since[first] = where
    outside = (filter.color[drawn] == 1) | (size == 0)
    plain = [
        PLAIN if grey else cycle_color(color)[1]
        for grey, color in zip(outside, filter.color[drawn].tolist(), strict=True)
    ]
    been = (since[drawn] <= times) & outside
    colors = np.where(been[..., None], ROBOT, plain).astype(np.uint8)
    edges = map(tuple, drawing.edge.tolist())
    path, title, visited = "filter/graph", "The filter", run.states
    return log_states(stream, path, title, names, drawing.position, edges, size, colors, visited)


def _legend(map: CellMap, localized: Localized) -> list[tuple[str, Color]]:
    cycles = [("on a knowledge cycle (its colour)", cycle_color(2)[1])]
    return [
        *run_legend(map),
        ("the state of the filter", CURRENT),
        ("a state that it was in", ROBOT),
        ("a state that it was not in", PLAIN),
        *(cycles if localized.filter.cycles else []),
    ]


def _text(localized: Localized, drawing: Drawing, spec: Spec) -> str:
    run = localized.run
    colors = {
        "colour": [f"{one} ({cycle_color(one)[0]})" for one in localized.cycle_color.tolist()]
    }
    return f"""# Where is the robot?

{bouncing(localized.bounce)} It has a map, a bump sensor and a clock. This run
makes {len(run.word):,} observations (0: it moved, 1: it bumped):

`{observed(run.word)}`

{_outcome(localized)}

## How to look

{SEEN}

The tab **Groups** shows the periodic group of each cell, over the slider `direction`.

## {counted(len(localized.filter.cycles), "knowledge cycle")}

A dot is a set of cells: violet is the state of the filter, vermilion are its earlier states.
{_drawn(localized.filter, drawing)} A coloured loop is a *knowledge cycle*, which is never left:

{described(localized, "cycle_uncertainty", "cycle_length", first=colors, most=_MAX_ROWS)}

{made_with(spec, localized.cells)}"""


def _outcome(localized: Localized) -> str:
    state, filter = int(localized.run.states[-1]), localized.filter
    if state == filter.trap:
        return "The last observation cannot occur on this map: the robot is **somewhere else**."
    count = int(filter.uncertainty[state])
    if filter.color[state] == 1:
        return f"In the end it may be in {count:,} cells: it is **not localized** yet."
    where = "it is in **one** cell" if count == 1 else f"it is in one of **{count:,}** cells"
    truth = "" if localized.run.truth_is_a_candidate else ", but the truth is **not** among them"
    return f"Then it is **localized**: {where}{truth}."


def _drawn(filter: Filter, drawing: Drawing) -> str:
    if drawing.whole:
        return "Each column is one observation farther from the start."
    left_out = f"; {drawing.cycles_left_out:,} cycles are left out" * bool(drawing.cycles_left_out)
    return (
        f"Of {len(filter.transition):,} states, too many to draw, the graph has the last states of "
        f"this run, in the rows at the top, and knowledge cycles{left_out}."
    )
