from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from ...automata import Policy
from ...bounce import AdaptivelyLocalized
from ..canvas.belief import MAX_ARROWS, log_beliefs
from ..canvas.curves import curve_view, log_curve
from ..canvas.map import CellMap, log_pictures, on_squares
from ..canvas.marks import log_robot
from ..canvas.page import lay_out_tab, log_legend, log_text
from ..canvas.palette import (
    CATEGORIES,
    CURRENT,
    KNOWN,
    PLAIN,
    ROBOT,
    TRAIL,
    Color,
    Level,
)
from ..canvas.prose import counted, degrees, made_with, table, times
from ..canvas.scale import Scale
from ..canvas.stream import send_blueprint
from .localization import log_end, log_turns


# Without the colours of the robot, and of what is known in the end.
_ANGLES = [
    CATEGORIES[name] for name in ("orange", "sky blue", "pink", "yellow", "blue", "vermilion")
]
_MAX_DRAWN = 300
_MAX_CORNERS = 100
_LEGEND_ROWS = 5
_ACROSS, _DOWN = 26.0, 30.0


def log_localization_policy(
    stream: rr.RecordingStream, found: AdaptivelyLocalized, spec: Mapping[str, Any]
) -> None:
    """Log a robot that is localized by its choice of angles.

    Over the timeline `step`: the robot and its trail, the cells where it may be, the angle that it
    turns by at each bump, and its path through the tree of the policy. Over the timeline
    `direction`: from where it takes how many bumps.
    """
    map = CellMap(stream, found.cells)
    tabs = [_log_run(map, found, spec), _log_needed(map, found)]
    send_blueprint(stream, tabs, "step", float(np.clip(found.run.path.size / 20, 2, 30)))


def _log_run(map: CellMap, found: AdaptivelyLocalized, spec: Mapping[str, Any]) -> rrb.Container:
    stream, cells = map.stream, found.cells
    log_beliefs(stream, cells, found.beliefs)
    log_robot(
        stream,
        "map/robot",
        (found.robot_x, found.robot_y, found.robot_theta),
        max(0.7 * cells.cell, 0.035 * map.extent),
        ROBOT,
        trail="map/trail",
        trail_color=TRAIL,
        corners=_MAX_CORNERS,
        middle=0.0,
        order=18.0,
    )
    log_end(map, found.run)
    log_turns(map, map.xy(found.run.path), found.turned_by, found.bounces)
    last = found.run.observations.size
    log_curve(stream, "policy/uncertainty", found.belief_size)
    log_curve(stream, "policy/bits", np.log2(found.belief_size))
    bumps = np.append(0, np.cumsum(found.run.observations))
    log_curve(stream, "policy/bumps", bumps, color=ROBOT)
    marks = ["grid/belief", "belief", "trail", "robot", "candidates", "truth", "turn"]
    numbers = rrb.Horizontal(
        curve_view("policy/uncertainty", "Cells left", last, int(found.belief_size.max())),
        curve_view("policy/bits", "The same, log2", last),
        curve_view("policy/bumps", "Bumps so far", last, int(bumps[-1])),
    )
    left = rrb.Vertical(
        map.view("Where the robot is, and where it may be", marks), numbers, row_shares=[7, 3]
    )
    drawn = _drawn(found.policy, found.run.states.tolist())
    tree = _log_tree(stream, found, drawn)
    legend = [
        *((f"turns by {degrees(one)}", _angle_color(i)) for i, one in enumerate(found.bounces)),
        ("localized", KNOWN),
        ("the state of the robot", CURRENT),
    ]
    log_legend(stream, "tree/legend", legend)
    text = log_text(stream, "text", _text(found, drawn, spec))
    side = lay_out_tab("tree", "Policy", [tree], len(legend), None, shares=(3, 1))
    about = rrb.Vertical(text, side, row_shares=[1, 1])
    return rrb.Horizontal(left, about, column_shares=[1, 1], name="Localization")


def _drawn(policy: Policy, visited: Sequence[int]) -> list[int]:
    """The states to draw: all, or where these are too many, those of a run and their successors."""
    if policy.turn.size <= _MAX_DRAWN:
        return list(range(policy.turn.size))
    run = list(dict.fromkeys(visited))
    onward = [target for state in run for target in policy.after(state).values()]
    kept = dict.fromkeys([*run, *onward[::-1]])
    return sorted(list(kept)[:_MAX_DRAWN])


def _log_tree(stream: rr.RecordingStream, found: AdaptivelyLocalized, drawn: list[int]) -> rrb.View:
    """Log the policy as a graph, with the start at the top and a row for each bump."""
    policy = found.policy
    place = _layout(policy, drawn)
    names = {state: _name(found, state) for state in drawn}
    nodes = rr.GraphNodes.from_fields(
        node_ids=list(names.values()), positions=place, show_labels=False
    )
    stream.log("tree/graph", nodes, static=True)
    pairs = [
        (names[state], names[target])
        for state in drawn
        for target in dict.fromkeys(policy.after(state).values())
        if target in names
    ]
    stream.log("tree/graph", rr.GraphEdges(pairs, graph_type="directed"), static=True)
    plain = np.array([_state_color(policy, state) for state in drawn], np.uint8)
    here = found.run.states[:, None] == np.array(drawn)
    colors = np.where(here[..., None], np.array(CURRENT), plain).astype(np.uint8)
    radii = 4 + 0.45 * np.log2(1 + policy.uncertainty[drawn]) + 5 * here
    columns = rr.GraphNodes.columns(colors=colors.reshape(-1, 3), radii=radii.ravel())
    index = [rr.TimeColumn("step", sequence=found.time)]
    stream.send_columns("tree/graph", index, columns.partition([len(drawn)] * found.time.size))
    (left, top), (right, bottom) = place.min(axis=0) - 40, place.max(axis=0) + 40
    return rrb.GraphView(
        origin="tree/graph",
        name="The policy",
        visual_bounds=rrb.VisualBounds2D(x_range=[left, right], y_range=[top, bottom]),
    )


def _layout(policy: Policy, drawn: list[int]) -> Float[np.ndarray, "drawn 2"]:
    """A row for each bump, and each state over the middle of those that it alone leads to."""
    known = set(drawn)
    depth, order = dict.fromkeys(drawn, 0), []
    # States after all that lead to them, which are those of an acyclic graph.
    left = dict.fromkeys(drawn, 0)
    after = {s: [t for t in policy.after(s).values() if t in known] for s in drawn}
    for state in drawn:
        for target in after[state]:
            left[target] += 1
    queue = [state for state in drawn if not left[state]]
    for state in queue:
        for target in after[state]:
            depth[target] = max(depth[target], depth[state] + 1)
            left[target] -= 1
            if not left[target]:
                queue.append(target)

    # Leaves side by side, in the order of a walk through the tree.
    across: dict[int, float] = {}
    stack, column = [0], 0
    owned: dict[int, list[int]] = {}
    while stack:
        state = stack.pop()
        if state in owned:
            continue
        owned[state] = []
        order.append(state)
        stack += after[state][::-1]
    seen: set[int] = set()
    for state in order:
        owned[state] = [t for t in dict.fromkeys(after[state]) if t not in seen]
        seen.update(owned[state])
        if not owned[state]:
            across[state] = float(column)
            column += 1
    for state in reversed(order):
        if owned[state]:
            at = [across[t] for t in owned[state] if t in across]
            across[state] = sum(at) / len(at) if at else float(column)
    # As wide as the view is for its height.
    down = max(_DOWN, 0.55 * _ACROSS * column / (1 + max(depth.values())))
    return np.array([[_ACROSS * across[s], down * depth[s]] for s in drawn])


def _name(found: AdaptivelyLocalized, state: int) -> str:
    """What hovering over a state shows."""
    turn = int(found.policy.turn[state])
    cells = counted(int(found.policy.uncertainty[state]), "cell").replace(",", "")
    does = f"turn by {degrees(found.bounces[turn])}" if turn >= 0 else "run to the first bump"
    if state in found.policy.ends:
        does = "localized"
    return f"state {state}: {cells}, {does}"


def _state_color(policy: Policy, state: int) -> Color:
    turn = int(policy.turn[state])
    if turn >= 0:
        return _angle_color(turn)
    return PLAIN if state == 0 else KNOWN


def _angle_color(turn: int) -> Color:
    return _ANGLES[turn % len(_ANGLES)]


def _log_needed(map: CellMap, found: AdaptivelyLocalized) -> rrb.Container:
    """Log from where it takes how many bumps: at worst over the headings, and for each."""
    needed = found.bumps_needed.astype(float)
    least, most = int(needed.min()), int(needed.max())
    # A level for each number of bumps, whose name is the number.
    scale = Scale.over(
        needed, "{} bumps".format, levels=most - least + 1, least=least - 0.5, most=most + 0.5
    )
    worst = map.picture("bumps_worst", scale.classes, scale.levels(needed.max(axis=0)))
    every, pictures = np.arange(found.cells.directions), scale.levels(needed)
    one = map.picture("bumps_needed", scale.classes, pictures, "direction", every)
    # Over the steps of the run, for the heading of the robot.
    heading = found.run.path // found.cells.positions
    turns = np.flatnonzero(np.diff(heading, prepend=-1))
    shown = on_squares(found.cells, pictures[heading[turns]])
    log_pictures(map.stream, "map/grid/bumps_needed", [], shown, "step", turns)
    views = rrb.Vertical(
        map.view("Bumps until it is localized, from the worst heading", [worst]),
        map.view("The same for one heading", [one]),
    )
    shown = np.unique(np.linspace(most, least, min(most - least + 1, _LEGEND_ROWS)).round())
    legend = [
        Level(counted(bumps, "bump"), scale.colors[bumps - least])
        for bumps in shown[::-1].astype(int).tolist()
    ]
    log_legend(map.stream, "needed/legend", legend)
    text = log_text(map.stream, "needed/text", _needed_text(found))
    return lay_out_tab("needed", "Bumps needed", views, len(legend), text, shares=(3, 2))


def _needed_text(found: AdaptivelyLocalized) -> str:
    bumps, starts = np.unique(found.bumps_needed, return_counts=True)
    rows = list(zip(bumps.tolist(), (f"{n:,}" for n in starts.tolist()), strict=True))
    return f"""# How long it takes

From each cell, how many bumps it takes until the robot knows where it is: **{found.worst_bumps} at
worst**, and {found.mean_bumps:.3g} in the mean.

- **Above**: from the worst heading on each square.
- **Below**: from one heading, that of `direction` at the bottom, or of the robot at `step`.

{table(("bumps", "cells from which it takes so many"), rows)}
"""


def _text(found: AdaptivelyLocalized, drawn: list[int], spec: Mapping[str, Any]) -> str:
    """What the recording shows."""
    angles = ", ".join(degrees(one) for one in found.bounces)
    end = found.run.candidates.size
    where = "**one cell**" if end == 1 else f"one of **{end:,} cells**"
    fixed = ", ".join(f"{one:g}°" for one in found.fixed_turns_deg.tolist())
    best = (
        f"No policy needs fewer {'at worst' if found.aim == 'worst' else 'in the mean'}."
        if found.optimal
        else f"Whether one needs fewer is not known; none needs less than {found.least:.4g}."
    )
    part = (
        ""
        if len(drawn) == found.policy.turn.size
        else f" Of {found.policy_states:,} states these are near this run."
    )
    return f"""# Which way to turn, to find out where one is

A robot runs straight and counts its steps. Where it bumps the *policy* says by which of its angles,
{angles}, it turns. This run bumps {times(found.run.bumps)}; then it is in {where}.

From all cells it takes **{counted(found.worst_bumps, "bump")} at worst** and \
{found.mean_bumps:.3g} in the mean. {best}

## How to look

Press play, or drag `step` at the bottom.

- **vermilion arrow**: the robot, and its trail.
- **blue arrows**: the cells where it may be; blue squares, while these are more than
  {MAX_ARROWS:,}.
- **green squares**, at the end: the cells that are left.

The tab **Bumps needed** shows how long it takes from everywhere.

## The policy

The start is at the top, and each row is a bump. A dot is a set of cells where the robot may be, in
the colour of the angle that it turns by.{part}

One sequence for all starts takes {counted(found.fixed_bumps, "bump")}: {fixed or "no turn"}. These
angles can tell {found.classes:,} classes of cells apart.

{made_with(spec, found.cells)}"""
