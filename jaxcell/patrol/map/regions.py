import dataclasses
from typing import Annotated, ClassVar

import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Bool, Int

from ...base.connected import check_connected
from ...base.quantities import Result, derived, quantity
from ...optimize import Graph


@dataclasses.dataclass(frozen=True, eq=False)
class Regions(Result):
    """Who patrols where, around a base station."""

    title: ClassVar[str] = "Regions around a base station"

    base: Annotated[int, quantity("", "base station", kind="place")]
    view: Annotated[
        Bool[np.ndarray, "cells"],
        quantity("position", "whether the base station sees the cell", kind="flag"),
    ]
    region: Annotated[
        Int[np.ndarray, "cells"],
        quantity("position", "region of the cell, -1 where nobody patrols", kind="index"),
    ]
    count: Annotated[int, quantity("", "regions", kind="count")]
    sectors: str
    'How the cells were divided, `"equal"` or `"balanced"`.'

    @derived("", "cells that the base station sees", kind="count")
    def cells_in_view(self) -> int:
        return int(self.view.sum())

    @derived("", "cells that nobody patrols", kind="count")
    def patrolled_by_nobody(self) -> int:
        return int((self.region < 0).sum())

    def cells(self, region: int) -> Int[np.ndarray, "vertices"]:
        """The cells of one region, in order."""
        return np.flatnonzero(self.region == region).astype(np.int32)


def base_station(
    graph: Graph, visible: Bool[np.ndarray, "cells cells"], central: float = 0.1
) -> int:
    """The cell for a base station: of the most central ones, that which sees most cells.

    The source asks for a place near the middle that sees much (Alam 2018, section 4.4.5) and does
    not say how near. Here a cell is the more central the shorter its mean way to all others, which
    is its closeness in the graph; of equals, the first of the most central is chosen.

    **Arguments:**

    - `graph`: the cells and the ways between them, a connected graph.
    - `visible`: which cells are seen from each, within the range of the base station.
    - `central`: the share of the cells that count as central, more than 0 and at most 1.

    **Returns:** the number of the cell.

    **Raises:** `ValueError` for a share out of range, for an array that does not match the graph,
    for a graph that is not connected, and if no central cell sees another.

    A corridor of five cells, each of which sees its neighbours:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> patrol.base_station(graph, visible)
        2
    """
    check_visible(graph, visible)
    if not 0 < central <= 1:
        raise ValueError(f"central: expected a share, more than 0 and at most 1, got {central}")
    check_connected(graph.vertices, graph.edges)
    near = graph.matrix(graph.lengths)
    far = scipy.sparse.csgraph.dijkstra(near, directed=False).sum(axis=1)
    # Rounded, so that cells that are alike by symmetry are in the order of their numbers.
    order = np.argsort(far.round(9), stable=True)[: max(1, round(central * graph.vertices))]
    base = int(order[np.argmax(visible[order].sum(axis=1))])
    _check_sees(base, visible[base])
    return base


def angular_regions(
    graph: Graph,
    base: int,
    view: Bool[np.ndarray, "cells"],
    robots: int,
    sectors: str = "equal",
) -> Regions:
    """Divide the cells that a base station does not see among robots (Alam 2018, section 4.4.5).

    The cells outside the view belong to a region, and with them its *rim*, the cells in view that
    are next to one outside: there, robots report. The rest of the view is patrolled by nobody, and
    no robot enters the cell of the base station. Regions are sectors of the angle around it,
    counter-clockwise from the x axis.

    Where obstacles cut a sector into pieces, its largest with a part of the rim is the region, and
    the others go to the region that they touch along most edges. A piece that touches none is
    joined to the nearest along the shortest way through the view, which is then patrolled too.

    **Arguments:**

    - `graph`: the cells, with their positions, and the ways between them.
    - `base`: the cell of the base station.
    - `view`: the cells that it sees.
    - `robots`: how many regions there are.
    - `sectors`: `"equal"` angles as in the source, or `"balanced"` so that each has as many cells
        outside the view.

    **Returns:** [`Regions`][], each of them connected.

    **Raises:** `ValueError` for a base that does not exist, sees no other cell or sees all of them,
    for fewer than 1 robot or more than there are cells out of view, for unknown sectors, for a
    graph without positions, and if no regions can be made: the message names the region, or the
    cells, and the reason.

    A corridor of five cells, each of which sees its neighbours. Robots report at 1 and 3, which the
    base station in the middle sees:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> regions = patrol.angular_regions(graph, 2, visible[2], 2)
        >>> regions.region.tolist(), regions.cells(0).tolist()
        ([1, 1, -1, 0, 0], [3, 4])
    """
    _check_base(graph, base, view)
    near = graph.matrix(graph.lengths)
    outside = ~view
    outside[base] = False
    if not outside.any():
        raise ValueError(
            f"view: the base station at cell {base} sees all cells; none are patrolled"
        )
    patrolled = outside.copy()
    patrolled[graph.edges[outside[graph.edges[:, ::-1]]]] = True
    patrolled[base] = False
    if not 1 <= robots <= np.count_nonzero(outside):
        raise ValueError(
            f"robots: expected 1 to {np.count_nonzero(outside)}, the number of cells that the base "
            f"station at cell {base} does not see, got {robots}"
        )
    if graph.xy is None:
        raise ValueError("graph: expected positions of its vertices, for their angles")
    across, up = (graph.xy - graph.xy[base]).T
    # Of a full turn, rounded so that a cell on a border belongs to the sector that it opens.
    angle = np.round(np.arctan2(up, across) / (2 * np.pi), 12) % 1
    if sectors == "equal":
        sector = np.floor(np.round(robots * angle, 9)).astype(np.int64) % robots
    elif sectors == "balanced":
        before = np.searchsorted(np.sort(angle[outside]), angle)
        sector = np.minimum(robots * before // np.count_nonzero(outside), robots - 1)
    else:
        raise ValueError(f"sectors: expected 'equal' or 'balanced', got {sectors!r}")
    region = np.where(patrolled, sector, -1)
    region = _connected(near, region, view, robots, base)
    for k in range(robots):
        if not outside[region == k].any():
            raise ValueError(_refusal(k, robots, "keeps no cell that only its robot watches"))
    return Regions(base, view, region.astype(np.int32), robots, sectors)


def _connected(
    near: scipy.sparse.csr_array,
    region: Int[np.ndarray, "cells"],
    view: Bool[np.ndarray, "cells"],
    robots: int,
    base: int,
) -> Int[np.ndarray, "cells"]:
    """The regions with their pieces brought together."""
    settled = np.full_like(region, -1)
    loose = []
    for k in range(robots):
        pieces = _pieces(near, np.flatnonzero(region == k))
        main = next((i for i, piece in enumerate(pieces) if view[piece].any()), None)
        if main is None:
            reason = "in view from which its robot could report" if pieces else "to patrol"
            raise ValueError(_refusal(k, robots, f"has no cell {reason}"))
        settled[pieces.pop(main)] = k
        loose += pieces
    loose.sort(key=len, reverse=True)
    inner = (region < 0) & view
    inner[base] = False
    while loose:
        piece = next((p for p in loose if (settled[near[p].indices] >= 0).any()), loose[0])
        loose = [other for other in loose if other is not piece]
        touched = settled[near[piece].indices]
        touched = touched[touched >= 0]
        if touched.size:
            settled[piece] = np.bincount(touched).argmax()
            continue
        way = _way(near, piece, settled >= 0, inner & (settled < 0))
        if way is None:
            raise ValueError(
                f"regions: {_some(piece)} would be in region {region[piece[0]]} of {robots}, but "
                "touch no other region and cannot be reached from one through the view of the "
                f"base station at cell {base}"
            )
        settled[way] = settled[piece] = settled[way[-1]]
    return settled


def _pieces(
    near: scipy.sparse.csr_array, cells: Int[np.ndarray, "some"]
) -> list[Int[np.ndarray, "..."]]:
    """The connected parts of some cells, the largest first."""
    if cells.size == 0:
        return []
    parts, part = scipy.sparse.csgraph.connected_components(near[cells][:, cells], directed=False)
    return sorted((cells[part == p] for p in range(parts)), key=len, reverse=True)


def _way(
    near: scipy.sparse.csr_array,
    piece: Int[np.ndarray, "some"],
    goal: Bool[np.ndarray, "cells"],
    through: Bool[np.ndarray, "cells"],
) -> list[int] | None:
    """The shortest way from a piece to a goal, from the first cell after the piece to the goal."""
    allowed = goal | through
    allowed[piece] = True
    cells = np.flatnonzero(allowed)
    distance, before, _ = scipy.sparse.csgraph.dijkstra(
        near[cells][:, cells],
        indices=np.searchsorted(cells, piece),
        min_only=True,
        return_predecessors=True,
    )
    distance[~goal[cells]] = np.inf
    here = int(np.argmin(distance))
    if np.isinf(distance[here]):
        return None
    way = []
    while before[here] >= 0:
        way.append(int(cells[here]))
        here = int(before[here])
    return way[::-1]


def check_visible(graph: Graph, visible: Bool[np.ndarray, "cells others"]) -> None:
    """Whether visibility is that of the cells of a graph.

    **Raises:** `ValueError` with the shapes if it is not.
    """
    if visible.shape != (graph.vertices, graph.vertices):
        raise ValueError(
            f"visible: expected an array [{graph.vertices}, {graph.vertices}], one row a cell of "
            f"the graph, got {list(visible.shape)}"
        )


def _check_base(graph: Graph, base: int, view: Bool[np.ndarray, "cells"]) -> None:
    if not 0 <= base < graph.vertices:
        raise ValueError(f"base: cell {base} does not exist; cells are 0 to {graph.vertices - 1}")
    if view.shape != (graph.vertices,):
        raise ValueError(
            f"view: expected an array [{graph.vertices}], one entry a cell of the graph, got "
            f"{list(view.shape)}"
        )
    _check_sees(base, view)


def _check_sees(base: int, view: Bool[np.ndarray, "cells"]) -> None:
    if not np.delete(view, base).any():
        raise ValueError(
            f"view: the base station at cell {base} sees no other cell, so that no robot could "
            "report to it"
        )


def _refusal(region: int, robots: int, reason: str) -> str:
    return (
        f"regions: region {region} of {robots} {reason}; expected fewer robots, another base "
        "station, or other sectors"
    )


def _some(cells: Int[np.ndarray, "some"]) -> str:
    shown = ", ".join(str(z) for z in cells[:8])
    return f"cells {shown}" + (f", ... ({cells.size})" if cells.size > 8 else "")
