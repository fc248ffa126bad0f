import dataclasses
import heapq

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Int
from scipy.sparse import csgraph

from ..base.shown import Pictured, Shown
from ..mapping import Chain, ChainSequence, PersistentGroups
from ..mapping.classes import reaching
from ..optimize import greedy_cover, minimum_cover
from .long_term import LongTermBehaviour
from .water import Water


# The largest size of a table of views, in bytes, and the number of entries computed at once.
_MAX_TABLE, _CHUNK = 2**32, 2**24
_ROUNDING = 1e-9
# Nodes and edges that a breadth-first search handles in a second.
_EDGES = 1e8


@dataclasses.dataclass(frozen=True, eq=False)
class Deployment(Shown):
    """Cells in which to drop drifters so that they can together ever reach every cell."""

    cells: Int[np.ndarray, "drifters"]
    "One cell of each persistent group, then one or more cells of each transient group."
    group: Int[np.ndarray, "drifters"]
    "The persistent group of each cell, -1 for a transient cell."
    transient_group: Int[np.ndarray, "drifters"]
    "The transient group of each cell, -1 for a persistent cell."
    gained: Int[np.ndarray, "drifters"]
    "The number of cells in its group that each drifter can ever reach but no earlier one can."


@dataclasses.dataclass(frozen=True, eq=False)
class CoverageCurve(Pictured):
    """The number of cells that can ever be reached, as a function of the number of drifters."""

    cells: Int[np.ndarray, "drifters"]
    "The cell in which each drifter is dropped, in order."
    covered: Int[np.ndarray, "drifters"]
    """The number of cells that the first drifter, the first two drifters, ... can ever reach: with
    any positive probability, after any time."""


@dataclasses.dataclass(frozen=True, eq=False)
class VisibleDeployment(Shown):
    """Cells in which to drop drifters whose cameras together see the whole sea bed."""

    cover: Int[np.ndarray, "views"]
    "Cells from which cameras see all cells, in the order in which they were chosen."
    cells: Int[np.ndarray, "drifters"]
    "The cells of the cover in which drifters are dropped: at most one cell per persistent group."
    least: int | None = None
    "A lower bound on the size of any cover; `None` if the cover is greedy."


def deployment_cells(behaviour: LongTermBehaviour) -> Deployment:
    """Choose where to drop drifters (Alam 2018, section 5.4.4 and Alg. 5.2).

    In a persistent group any cell leads to all others, so the cell with the smallest number is
    chosen. The cells of a transient group are examined from the longest absorption time to the
    shortest, and in the order of their numbers if times are equal. A cell is chosen unless a chosen
    cell leads to it within the group. The dissertation draws the cell of a persistent group at
    random, and if times are equal it chooses the cell that leads to the most other cells; in a map
    without disturbances, cells with equal times lead to equally many cells.

    Fewer cells may suffice: see [`minimum_deployment`][jaxcell.drift.minimum_deployment].

    **Arguments:** the result of [`jaxcell.drift.long_term_behaviour`][]. **Returns:** the cells and
    their groups.

    Cells 2 and 3 are persistent groups, and cell 0 leads to all other cells:

        >>> from jaxcell import drift, examples
        >>> chain = examples.stream()
        >>> chosen = drift.deployment_cells(drift.long_term_behaviour(chain, duration=3600))
        >>> chosen.cells.tolist(), chosen.group.tolist(), chosen.transient_group.tolist()
        ([2, 3, 0], [0, 1, -1], [-1, -1, 0])
    """
    begins, parts = behaviour.begins, np.asarray(behaviour.transient.group)
    groups = begins.groups
    group, part = np.asarray(groups.group), parts[: behaviour.chain.cells]
    # Times are compared to seven digits, so that rounding does not decide between equal times.
    digits, power = np.frexp(np.asarray(begins.absorption.value))
    time = np.ldexp(np.round(digits, 7), power)
    transient = np.flatnonzero(group < 0)
    order = transient[np.lexsort((transient, -time[transient], part[transient]))]
    # Edges between states of one part cost nothing.
    edges = behaviour.chain.to_scipy().tocoo()
    kept = (parts[edges.row] == parts[edges.col]) & (parts[edges.row] >= 0)
    places = edges.row[kept], edges.col[kept]
    within = scipy.sparse.coo_array((np.zeros(places[0].size), places), shape=edges.shape)
    same = parts.reshape(-1, part.size) == part
    taken, left, first = np.zeros(0, np.int64), np.arange(order.size), np.zeros(0, np.int64)
    while left.size:
        # Take every cell of `left` to which no earlier cell of `left` leads. In a steady map one
        # round is enough, because a cell leads to no more cells than its predecessors lead to.
        first = _first_ancestor(within, order, left, same)
        taken = np.union1d(taken, left[first[left] == left])
        first = _first_ancestor(within, order, taken, same)
        left = left[first[left] > left]
    persistent = np.flatnonzero(group >= 0)
    _, smallest = np.unique(group[persistent], return_index=True)
    cells = np.concatenate([persistent[smallest], order[taken]])
    gained = np.concatenate(
        [np.asarray(groups.size), np.bincount(first, minlength=order.size)[taken]]
    )
    number = np.asarray(begins.transient.group)
    return Deployment(cells.astype(np.int32), group[cells], number[cells], gained.astype(np.int32))


def _first_ancestor(
    within: scipy.sparse.coo_array,
    order: Int[np.ndarray, "transients"],
    sources: Int[np.ndarray, "sources"],
    same: Bool[np.ndarray, "phases cells"],
) -> Int[np.ndarray, "transients"]:
    """For each cell in `order`, find the first source that leads to it within its transient group.

    `sources` and the result are positions in `order`; a result beyond the end of `order` means that
    no source leads to the cell. A path counts only if it ends at a phase at which `same` is true:
    the cell is then in the same group as at phase 0. Dijkstra's algorithm begins at an additional
    node with an edge to each source, whose weight grows with the position of the source. The edges
    of `within` have weight 0 and stay in a group, so the distance to a cell shows its first source.
    """
    states = within.shape[0]
    rows = np.concatenate([within.row, np.full(sources.size, states)])
    columns = np.concatenate([within.col, order[sources]])
    graph = scipy.sparse.csr_array(
        (np.concatenate([within.data, sources + 1.0]), (rows, columns)),
        shape=(states + 1, states + 1),
    )
    away = csgraph.dijkstra(graph, indices=states)[:-1]
    away = np.minimum(away, order.size + 1).astype(np.int64).reshape(same.shape) - 1
    return np.where(same, away, order.size).min(axis=0)[order]


def minimum_deployment(chain: Chain) -> Int[np.ndarray, "drifters"]:
    """Find the fewest cells from which all cells can ever be reached.

    It runs on the host, because the number of drifters depends on the chain. The cells are one cell
    of each *source*, a strongly connected component to which no other component leads. Each source
    needs a drifter, and all other components are reached from the sources.

    A persistent group gets no drifter if a transient cell leads to it, although a drifter from that
    cell may end in another group. To put a drifter in each group, use
    [`deployment_cells`][jaxcell.drift.deployment_cells].

    **Arguments:** the map from [`jaxcell.drift.drift_map`][], or any chain. **Returns:** the
    smallest cell of each source, in order.

    A drifter from cell 0 can reach all cells:

        >>> from jaxcell import drift, examples
        >>> chain = examples.stream()
        >>> drift.minimum_deployment(chain).tolist()
        [0]
    """
    _, smallest, _, sources = _components(chain)
    return np.sort(smallest[sources]).astype(np.int32)


def coverage_curve(chain: Chain | ChainSequence) -> CoverageCurve:
    """Compute how the number of cells that can ever be reached grows with the number of drifters.

    A cell can be reached if a drifter visits it with any positive probability, after any time.
    In a limited time drifters visit far fewer cells.

    Each drifter is dropped in one of the cells of
    [`minimum_deployment`][jaxcell.drift.minimum_deployment]: the one that adds the most cells. For
    any number of drifters, this covers at least the share `1 - 1/e` of the largest possible number
    of cells (Nemhauser, Wolsey and Fisher 1978). [`coverage_seconds`][] foretells the time that
    this takes.

    **Arguments:** the map from [`jaxcell.drift.drift_map`][], or any chain; or a sequence of
    chains, for drifters that are dropped at phase 0 and visit cells at any phase. **Returns:** the
    cells in which drifters are dropped, and the numbers of cells that they can reach.

    Two separate cells, the second of which leads to a third:

        >>> import numpy as np
        >>> from jaxcell import drift, mapping
        >>> chain = mapping.Chain.from_scipy(np.array([[1.0, 0, 0], [0, 0, 1], [0, 0, 1]]))
        >>> curve = drift.coverage_curve(chain)
        >>> curve.cells.tolist(), curve.covered.tolist()
        ([1, 0], [2, 3])
    """
    label, smallest, matrix, sources = _components(chain)
    covered = np.zeros(chain.cells, bool)
    cell = np.arange(label.size) % chain.cells
    inside = scipy.sparse.csr_array(
        (np.ones(label.size, bool), (label, cell)), shape=(matrix.shape[0], chain.cells)
    )

    def added(component: int) -> Int[np.ndarray, "new"]:
        reached = csgraph.breadth_first_order(matrix, component, return_predecessors=False)
        cells = np.unique(inside[reached].indices)
        return cells[~covered[cells]]

    # Gains never grow, so only the largest of the known gains must be computed again.
    queue = [(-added(one).size, int(smallest[one]), one) for one in sources.tolist()]
    heapq.heapify(queue)
    cells, gained = [], []
    while queue:
        _, first, source = heapq.heappop(queue)
        new = added(source)
        entry = (-new.size, first, source)
        if queue and queue[0] < entry:
            heapq.heappush(queue, entry)
            continue
        if not new.size:
            break
        covered[new] = True
        cells.append(first)
        gained.append(new.size)
    return CoverageCurve(np.array(cells, np.int32), np.cumsum(gained).astype(np.int32))


def coverage_seconds(chain: Chain | ChainSequence) -> float:
    """Foretell the seconds that [`coverage_curve`][] takes, on one processor.

    **Arguments:** the map, as for [`coverage_curve`][]. **Returns:** the seconds.

    Four cells:

        >>> from jaxcell import drift, examples
        >>> drift.coverage_seconds(examples.stream()) < 1
        True
    """
    _, _, matrix, sources = _components(chain)
    return sources.size * (matrix.nnz + matrix.shape[0]) / _EDGES


def visible_deployment(
    water: Water,
    reach: float | int,
    groups: PersistentGroups,
    *,
    seconds: float | int | None = None,
) -> VisibleDeployment:
    """Choose where to drop drifters with cameras that see the sea bed (Alam 2018, Alg. 5.3).

    A camera that looks down from the middle of a cell sees a disc (Eq. 5.1), and a cell is seen if
    it lies wholly within the disc. Distances are computed with the sides of the camera's cell.
    If several cells of the cover are in one persistent group, only the first gets a drifter,
    because this drifter will visit the others in the long run.

    **Arguments:**

    - `water`: the cells.
    - `reach`: radius of the disc, in metres.
    - `groups`: persistent groups of a chain on these cells.
    - `seconds`: the time limit of [`jaxcell.optimize.minimum_cover`][]; by default the cover is
        found by [`jaxcell.optimize.greedy_cover`][].

    **Returns:** [`VisibleDeployment`][jaxcell.drift.VisibleDeployment].

    The surface of the bundled sea, with discs of 3 km radius:

        >>> from jaxcell import drift, examples, mapping
        >>> water, flow = examples.gyres()
        >>> groups = mapping.persistent_groups(drift.drift_map(water, flow, drift.DriftStep()))
        >>> chosen = drift.visible_deployment(water, 3000, groups)
        >>> len(chosen.cover), len(chosen.cells)
        (47, 37)
    """
    group = np.asarray(groups.group)
    if group.shape != (water.cells,):
        raise ValueError(f"groups: expected those of {water.cells} cells, got {group.shape}")
    check_reach(water, reach)
    sees = _visible(water, reach)
    if seconds is None:
        cover, least = greedy_cover(sees).chosen, None
    else:
        smallest = minimum_cover(sees, time_limit=float(seconds), throw=False)
        cover, least = smallest.chosen, smallest.bound
    label = group[cover]
    _, first = np.unique(label, return_index=True)
    kept = label < 0
    kept[first] = True
    return VisibleDeployment(cover, cover[kept], least)


def check_reach(water: Water, reach: float | int, name: str = "reach") -> None:
    """Raise `ValueError` if a camera cannot see all of its cell, or if there are too many cells."""
    if water.cells**2 > _MAX_TABLE:
        raise ValueError(
            f"{name}: the views of {water.cells} cells take more than 4 GiB; expected at most "
            "65536 cells"
        )
    corner = np.hypot(*water.sides) / 2
    if not reach * (1 + _ROUNDING) >= corner.max():
        cell = int(np.argmax(corner))
        raise ValueError(
            f"{name}: expected {corner[cell]:g} m or more, the distance to the corners of cell "
            f"{cell}, got {reach:g}"
        )


def _visible(water: Water, reach: float | int) -> Bool[np.ndarray, "cells cells"]:
    """Mark the cells that lie wholly within the disc around each cell."""
    dx, dy = water.sides[..., None]
    sees = np.zeros((water.cells, water.cells), bool)
    rows = max(1, _CHUNK // water.cells)
    for start in range(0, water.cells, rows):
        part = slice(start, start + rows)
        right = np.abs(water.column - water.column[part, None])
        if water.wraps:
            right = np.minimum(right, water.number.shape[1] - right)
        up = np.abs(water.row - water.row[part, None]) + 0.5
        sees[part] = np.hypot((right + 0.5) * dx[part], up * dy[part]) <= reach * (1 + _ROUNDING)
    return sees


def _components(
    chain: Chain | ChainSequence,
) -> tuple[
    Int[np.ndarray, "states"],
    Int[np.ndarray, "components"],
    scipy.sparse.csr_array,
    Int[np.ndarray, "sources"],
]:
    """Find the strongly connected components of a chain.

    **Returns:** the component of each cell at each phase; the first state of each component; the
    edges between components; and the sources, components with cells at phase 0 to which no other
    component leads.
    """
    matrix = chain.to_scipy()
    if isinstance(chain, ChainSequence):
        # Edges from states that no drifter from phase 0 reaches are removed.
        begins = np.arange(matrix.shape[0]) < chain.cells
        met = reaching(matrix.T.tocsr(), begins).astype(float)
        matrix = (scipy.sparse.diags_array(met) @ matrix).tocsr()
        matrix.eliminate_zeros()
    count, label = csgraph.connected_components(matrix, connection="strong")
    source, target = np.repeat(label, np.diff(matrix.indptr)), label[matrix.indices]
    between = source != target
    edges = scipy.sparse.csr_array(
        (np.ones(between.sum()), (source[between], target[between])), shape=(count, count)
    )
    _, first = np.unique(label, return_index=True)
    led_to = np.bincount(edges.indices, minlength=count) > 0
    return label, first, edges, np.flatnonzero(~led_to & (first < chain.cells))
