import dataclasses
import math

import networkx as nx
import numpy as np
from jaxtyping import Float, Int, Integer

from ...automata import Filter


# Largest number of states of a filter that is drawn completely.
_MAX_STATES = 300
# Otherwise the last states of a run are drawn, and cycles with this number of states in total.
_LAST_VISITED = 120
_MAX_ON_CYCLES = 300
_SPACING = 30.0
_GAP = 1.5
# Largest number of states of a ring; longer cycles are folded.
_MAX_RING = 40
_PATH_COLUMNS = 24


@dataclasses.dataclass(frozen=True, eq=False)
class Drawing:
    """A drawing of states of a filter in the plane, with y down."""

    state: Int[np.ndarray, "drawn"]
    position: Float[np.ndarray, "drawn 2"]
    edge: Int[np.ndarray, "edges 2"]
    "The transitions between drawn states, as pairs of states; each pair occurs once."
    whole: bool
    "`True` if all states are drawn; the trap, for impossible observations, only if it was visited."
    cycles_left_out: int
    "The number of cycles in `Filter.cycles` that are not drawn."


def draw_filter(filter: Filter, visited: Integer[np.ndarray, "visits"]) -> Drawing:
    """Place the states of a filter in the plane.

    Knowledge cycles, which a filter never leaves, are loops. Column k contains the other states
    that are k edges away from the start. `visited` lists the states of a run. If a filter has more
    than 300 states, only some cycles and the last 120 other states of the run are drawn.
    """
    visited = visited[np.sort(np.unique(visited, return_index=True)[1])]
    on_cycle = np.zeros(len(filter.transition), bool)
    for cycle in filter.cycles:
        on_cycle[cycle.states] = True
    whole = len(filter.transition) <= _MAX_STATES
    if whole:
        entered = filter.trap is None or filter.trap in visited
        free = np.flatnonzero(~on_cycle)
        free = free if entered else free[free != filter.trap]
        place = _columns(filter.transition, free)
        cycles = [cycle.states for cycle in filter.cycles]
    else:
        free = visited[~on_cycle[visited]][-_LAST_VISITED:]
        place = _rows(free.size)
        cycles = _some_cycles(filter, visited)

    loops = [_loop(len(states)) for states in cycles]
    if whole:
        right, bottom = place.max(axis=0, initial=0) + _GAP
        loops = _pack(loops, wide=_area(loops) / bottom)
        places = [place, *(loop + np.array([right, 0]) for loop in loops)]
    else:
        places = _pack([place, *loops], wide=math.sqrt(1.6 * _area([place, *loops])))
    position = np.concatenate(places) * _SPACING
    state = np.concatenate([free, *cycles]).astype(np.int32)
    edge = np.stack([np.repeat(np.arange(len(filter.transition)), 2), filter.transition.ravel()], 1)
    edge = np.unique(edge[np.isin(edge, state).all(axis=1)], axis=0)
    return Drawing(state, position, edge, whole, len(filter.cycles) - len(cycles))


def _columns(
    transition: Integer[np.ndarray, "states 2"], states: Integer[np.ndarray, "drawn"]
) -> Float[np.ndarray, "drawn 2"]:
    """Place states in columns by their distance from the start, ordered so that edges are short."""
    source, target = np.repeat(np.arange(len(transition)), 2), transition.ravel()
    source, target = source[target >= 0], target[target >= 0]
    graph = nx.DiGraph(zip(source.tolist(), target.tolist(), strict=True))
    depth = np.full(len(transition), -1)
    for distance, reached in enumerate(nx.bfs_layers(graph, 0)):
        depth[reached] = distance

    linked = np.isin(source, states) & np.isin(target, states)
    source, target = source[linked], target[linked]
    columns = [states[depth[states] == d] for d in np.unique(depth[states])]
    height = np.zeros(len(transition))
    for sweep in range(8):
        here, there = (target, source) if sweep % 2 == 0 else (source, target)
        for column in columns if sweep % 2 == 0 else columns[::-1]:
            # Order states by the mean height of their neighbours on one side.
            wanted = [height[there[here == state]] for state in column]
            mean = [w.mean() if w.size else height[s] for w, s in zip(wanted, column, strict=True)]
            order = column[np.argsort(mean, kind="stable")]
            height[order] = np.arange(order.size) - (order.size - 1) / 2
    height -= height[states].min(initial=0)
    return np.stack([depth[states], height[states]], axis=1).astype(float)


def _rows(count: int) -> Float[np.ndarray, "count 2"]:
    """Place states in rows, alternately from left to right and from right to left."""
    row, column = np.divmod(np.arange(count), _PATH_COLUMNS)
    column = np.where(row % 2 == 0, column, _PATH_COLUMNS - 1 - column)
    return np.stack([column, row], axis=1).astype(float)


def _some_cycles(filter: Filter, visited: Integer[np.ndarray, "_"]) -> list[Int[np.ndarray, "_"]]:
    """Choose the last visited state's cycle, then others, up to `_MAX_ON_CYCLES` states in all."""
    reached = [c.states for c in filter.cycles if visited[-1] in c.states]
    others = [c.states for c in filter.cycles if visited[-1] not in c.states]
    drawn, total = reached, sum(map(len, reached))
    for states in others:
        total += len(states)
        if total > _MAX_ON_CYCLES:
            break
        drawn.append(states)
    return drawn


def _loop(count: int) -> Float[np.ndarray, "count 2"]:
    """Place states on a closed path: a ring, or a comb for more than `_MAX_RING` states."""
    if count <= _MAX_RING:
        radius = max(count / (2 * np.pi), 0.4)
        angle = 2 * np.pi * np.arange(count) / count
        return radius * np.stack([1 + np.sin(angle), 1 - np.cos(angle)], axis=1)
    # A comb has pairs of columns, down and up, and a way back along the top.
    pairs = math.ceil(math.sqrt(count) * 0.6)
    spare = count - 2 * pairs
    points = []
    for pair in range(pairs):
        share = spare * (pair + 1) // pairs - spare * pair // pairs
        down, up = (share + 1) // 2, share // 2
        points += [(2 * pair, 1 + row) for row in range(down)]
        points += [(2 * pair + 1, 1 + row) for row in reversed(range(up))]
    points += [(column, 0) for column in reversed(range(2 * pairs))]
    return np.array(points, float)


def _pack(shapes: list[Float[np.ndarray, "_ 2"]], wide: float) -> list[Float[np.ndarray, "_ 2"]]:
    """Put shapes side by side in rows of width `wide`; a wider shape has its own row."""
    placed = []
    left = top = height = 0.0
    for shape in shapes:
        width, high = _size(shape)
        if left > 0 and left + width > wide:
            left, top, height = 0.0, top + height, 0.0
        placed.append(shape + np.array([left, top]))
        left, height = left + width, max(height, high)
    return placed


def _area(shapes: list[Float[np.ndarray, "_ 2"]]) -> float:
    return sum(math.prod(_size(shape)) for shape in shapes)


def _size(shape: Float[np.ndarray, "_ 2"]) -> tuple[float, float]:
    """Return the width and height of a shape, including a gap to the next shape."""
    width, height = shape.max(axis=0, initial=0) + _GAP
    return float(width), float(height)
