from collections.abc import Sequence
from typing import TypeAlias

import networkx as nx
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from ...automata import Policy
from ...bounce import AdaptivelyLocalized
from ..canvas.map import CellMap, directions_shown
from ..canvas.page import log_tab, log_text
from ..canvas.palette import CURRENT, KNOWN, PLAIN, angle_color
from ..canvas.prose import Spec, counted, degrees, made_with, numbers, table, times
from ..canvas.scale import Scale
from ..canvas.stream import pace, send_blueprint
from .run import SEEN, log_localized, log_states, log_turns, run_legend


MAX_DRAWN = 80
"""Largest number of drawn states of a policy."""
_ACROSS, _DOWN = 26.0, 30.0
_Tree: TypeAlias = dict[int, int]


def log_localization_policy(
    stream: rr.RecordingStream, localized: AdaptivelyLocalized, spec: Spec
) -> None:
    """Record a robot that chooses bouncing angles to localize itself."""
    map = CellMap(stream, localized.cells)
    tabs = [_log_run(map, localized, spec), _log_needed(map, localized)]
    send_blueprint(stream, tabs, "step", pace(localized.run.path.size))


def _log_run(map: CellMap, localized: AdaptivelyLocalized, spec: Spec) -> rrb.Container:
    stream, turned = map.stream, localized.turned_by >= 0
    left = log_localized(map, localized, "policy", ["turn"])
    angles = localized.bounces[localized.turned_by[turned]].tolist()
    log_turns(map, map.xy(localized.run.path), turned, angles)
    tree = _tree(localized.policy, localized.run.states.tolist())
    drawing = _log_tree(stream, localized, tree)
    legend = [
        *run_legend(map),
        *((f"turns by {degrees(one)}", angle_color(i)) for i, one in enumerate(localized.bounces)),
        ("a state where it is localized", KNOWN),
        ("the start, until the first bump", PLAIN),
        ("the state of the robot", CURRENT),
    ]
    text = log_text(stream, "text", _text(localized, len(tree), spec))
    side = log_tab(stream, "tree", "Policy", drawing, "", legend, shares=(5, 4))
    about = rrb.Vertical(text, side, row_shares=[1, 1])
    return rrb.Horizontal(left, about, column_shares=[1, 1], name="Localization")


def _tree(policy: Policy, visited: Sequence[int]) -> _Tree:
    """Choose at most `MAX_DRAWN` states to draw; return the predecessor of each, -1 for the start.

    The drawn states are the visited states, as many whole levels of the tree as possible, and then
    successors of the visited states.
    """
    run = list(dict.fromkeys(visited))
    above = dict(zip(run, [-1, *run], strict=False))
    level = run[:1]
    while level:
        below = {target: state for state in level for target in policy.after(state).values()}
        level = [state for state in below if state not in above]
        if len(above) + len(level) > MAX_DRAWN:
            break
        level += [state for state in run if state in below]
        above = below | above
    beside = {target: state for state in run for target in policy.after(state).values()}
    kept = [one for one in beside.items() if one[0] not in above]
    return above | dict(kept[: MAX_DRAWN - len(above)])


def _log_tree(stream: rr.RecordingStream, localized: AdaptivelyLocalized, tree: _Tree) -> rrb.View:
    """Log the policy as a tree, with the start at the top and a row per bump."""
    policy, drawn = localized.policy, sorted(tree)
    names = {state: _name(localized, state) for state in drawn}
    edges = [(above, state) for state, above in tree.items() if above >= 0]
    turns = {state: int(policy.turn[state]) for state in drawn}
    color_of = {state: angle_color(turn) for state, turn in turns.items() if turn >= 0}
    colors = np.array([color_of.get(state, KNOWN if state else PLAIN) for state in drawn], np.uint8)
    place, size = _layout(tree), policy.uncertainty[drawn]
    path, title, visited = "tree/graph", "The policy", localized.run.states
    return log_states(stream, path, title, names, place, edges, size, colors, visited)


def _layout(tree: _Tree) -> Float[np.ndarray, "drawn 2"]:
    """Place states in one row per bump, with each state above the middle of its successors."""
    graph = nx.DiGraph((above, state) for state, above in tree.items())
    depth = nx.single_source_shortest_path_length(graph, -1)
    # States without successors are side by side, in the order of a walk through the tree.
    below, order = nx.dfs_successors(graph, -1), list(nx.dfs_preorder_nodes(graph, -1))
    ends = [state for state in order if state not in below]
    across = {state: float(column) for column, state in enumerate(ends)}
    for state in reversed(order):
        if state in below:
            across[state] = float(np.mean([across[target] for target in below[state]]))
    # The rows have the proportions of the view.
    down = max(_DOWN, 0.55 * _ACROSS * len(ends) / max(depth.values()))
    return np.array([[_ACROSS * across[s], down * depth[s]] for s in sorted(tree)])


def _name(localized: AdaptivelyLocalized, state: int) -> str:
    """Return the label of a state: its number, its number of cells, and the turn in this state."""
    turn = int(localized.policy.turn[state])
    cells = counted(int(localized.policy.uncertainty[state]), "cell").replace(",", "")
    does = f"turn by {degrees(localized.bounces[turn])}" if turn >= 0 else "run to the first bump"
    if state in localized.policy.ends:
        does = "localized"
    return f"state {state}: {cells}, {does}"


def _log_needed(map: CellMap, localized: AdaptivelyLocalized) -> rrb.Container:
    """Log a tab with the number of bumps until localization, for the worst and for each heading."""
    needed = localized.bumps_needed
    least, most = int(needed.min()), int(needed.max())
    scale = Scale.counting(least, most, lambda count: f"{count} bump{'s' * (count != '1')}")
    worst = map.picture("bumps_worst", scale.classes, scale.levels(needed.max(axis=0)))
    shown = directions_shown(localized.cells, localized.run.path)
    one = map.by_direction("bumps_needed", scale.classes, scale.levels(needed), shown)
    views = rrb.Vertical(
        map.view("Bumps until it is localized, from the worst heading", [worst]),
        map.view("The same for one heading", [one]),
    )
    bumps, starts = np.unique(needed, return_counts=True)
    rows = list(zip(bumps.tolist(), (f"{n:,}" for n in starts.tolist()), strict=True))
    text = f"""# Bumps until the robot is localized

Their number, from each cell.

- **Above**: from the worst heading on each square.
- **Below**: from one heading, that of `direction` at the bottom, or of the robot at `step`.

{table(("bumps", "cells"), rows)}
"""
    legend = scale.legend()
    return log_tab(map.stream, "needed", "Bumps needed", views, text, legend, shares=(3, 2))


def _text(localized: AdaptivelyLocalized, drawn: int, spec: Spec) -> str:
    angles = ", ".join(degrees(one) for one in localized.bounces)
    end = localized.run.candidates.size
    where = "**one cell**" if end == 1 else f"one of **{end:,} cells**"
    fixed = ", ".join(f"{one:g}°" for one in localized.fixed_turns_deg.tolist())
    part = (
        f" The tree has those of {localized.policy_states:,} states that this run visits, some of "
        "their neighbours, and the first ones from the start."
        if drawn < localized.policy.turn.size
        else ""
    )
    return f"""# Turns that localize a robot

A robot runs straight and counts its steps. At a bump the *policy* chooses one of its angles,
{angles}. This run bumps {times(localized.run.bumps)}; then it is in {where}.

## How to look

{SEEN}

The tab **Bumps needed** shows the number of bumps from each square.

## The policy

The start is at the top, and each row is a bump. A dot is a set of cells where the robot may be, in
the colour of its next turn, below a dot that leads to it.{part}

{numbers(localized)}

One sequence of turns for all starts is `{fixed or "none"}`.

{made_with(spec, localized.cells)}"""
