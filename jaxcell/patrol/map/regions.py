import dataclasses
from typing import Annotated, ClassVar

import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Bool, Int

from ...base.connected import check_connected
from ...base.quantities import Result, derived, quantity
from ...optimize import Graph, GraphLike
from ..team.times import check_vertex


@dataclasses.dataclass(frozen=True, eq=False)
class Regions(Result):
    """The regions that robots patrol around a base station."""

    title: ClassVar[str] = "Regions around a base station"

    base: Annotated[int, quantity("", "base station", kind="place")]
    view: Annotated[
        Bool[np.ndarray, "cells"],
        quantity("position", "whether the base station sees the cell", kind="flag"),
    ]
    region: Annotated[
        Int[np.ndarray, "cells"],
        quantity("position", "region of the cell, -1 where no robot patrols", kind="index"),
    ]
    count: Annotated[int, quantity("", "regions", kind="count")]

    @derived("", "cells that the base station sees", kind="count")
    def cells_in_view(self) -> int:
        return int(self.view.sum())

    @derived("", "cells that no robot patrols", kind="count")
    def patrolled_by_nobody(self) -> int:
        return int((self.region < 0).sum())

    def cells(self, region: int) -> Int[np.ndarray, "vertices"]:
        """Return the cells of one region, in ascending order."""
        return np.flatnonzero(self.region == region).astype(np.int32)


def base_station(
    graph: GraphLike, visible: Bool[np.ndarray, "cells cells"], central: float = 0.1
) -> int:
    """Choose the cell for a base station: the central cell that sees the most cells.

    The source requires a place near the middle with a wide view (Alam 2018, section 4.4.5). Here a
    cell is more central if its paths to all other cells are shorter on average. Among cells with
    equal views, the most central cell is chosen.

    **Arguments:** the graph of the cells, which is connected; the mask of the cells seen from each
    cell, within the range of a base station; and the share of the cells that count as central, more
    than 0 and at most 1. **Returns:** the number of the cell.

    A corridor of five cells, each of which sees its neighbours:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> patrol.map.base_station(graph, visible)
        2
    """
    check_visible(graph, visible)
    if not 0 < central <= 1:
        raise ValueError(f"central: expected a share, more than 0 and at most 1, got {central}")
    check_connected(graph.vertices, graph.edges)
    near = graph.matrix(graph.lengths)
    far = scipy.sparse.csgraph.dijkstra(near, directed=False).sum(axis=1)
    # Distances are rounded, so that symmetric cells are in the order of their numbers.
    order = np.argsort(far.round(9), stable=True)[: max(1, round(central * graph.vertices))]
    base = int(order[np.argmax(visible[order].sum(axis=1))])
    _check_sees(base, visible[base])
    return base


def angular_regions(
    graph: GraphLike, base: int, view: Bool[np.ndarray, "cells"], robots: int
) -> Regions:
    """Divide among robots the cells that a base station does not see (Alam 2018, section 4.4.5).

    Regions contain the cells outside the view and the *rim*, the cells in view that are next to a
    cell outside the view. Robots report from the rim. The rest of the view belongs to no region,
    and no robot enters the cell of the base station. Regions are sectors with equal angles around
    the base station, counter-clockwise from the x axis.

    If obstacles cut a sector into pieces, the region is the largest piece that contains part of the
    rim, and every other piece joins the region with which it shares most edges. A piece next to no
    region joins the nearest region, together with the shortest path to the region through the view.

    **Arguments:** the graph of the cells, with their positions; the cell of the base station; the
    cells that it sees; and the number of robots. **Returns:** [`Regions`][], one connected region
    per robot.

    A corridor of five cells, each of which sees its neighbours. Robots report at cells 1 and 3,
    which the base station in the middle sees:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> regions = patrol.map.angular_regions(graph, 2, visible[2], 2)
        >>> regions.region.tolist(), regions.cells(0).tolist()
        ([1, 1, -1, 0, 0], [3, 4])
    """
    check_vertex("base", base, graph.vertices)
    if view.shape != (graph.vertices,):
        raise ValueError(
            f"view: expected an array [{graph.vertices}], one entry per cell of the graph, got "
            f"{list(view.shape)}"
        )
    _check_sees(base, view)
    near = graph.matrix(graph.lengths)
    outside = ~view
    outside[base] = False
    if not outside.any():
        raise ValueError(
            f"view: the base station at cell {base} sees all cells; expected cells to patrol"
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
    # Angles are fractions of a turn, rounded so that a sector contains cells at its first angle.
    angle = np.round(np.arctan2(up, across) / (2 * np.pi), 12) % 1
    sector = np.floor(np.round(robots * angle, 9)).astype(np.int64) % robots
    region = np.where(patrolled, sector, -1)
    region = _connected(near, region, view, robots, base)
    for k in range(robots):
        if not outside[region == k].any():
            raise ValueError(_refusal(k, robots, "keeps no cell that only its robot watches"))
    return Regions(base, view, region.astype(np.int32), robots)


def _connected(
    near: scipy.sparse.csr_array,
    region: Int[np.ndarray, "cells"],
    view: Bool[np.ndarray, "cells"],
    robots: int,
    base: int,
) -> Int[np.ndarray, "cells"]:
    """Move each piece that is not connected to the rest of its region to an adjacent region."""
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
        touching = next((p for p in loose if (settled[near[p].indices] >= 0).any()), None)
        if touching is not None:
            piece = touching
            touched = settled[near[piece].indices]
            settled[piece] = np.bincount(touched[touched >= 0]).argmax()
        else:
            # A piece without a path may touch a region after another piece has joined the region.
            paths = (_shortest_path(near, p, settled >= 0, inner & (settled < 0)) for p in loose)
            joined = next(((p, path) for p, path in zip(loose, paths, strict=True) if path), None)
            if joined is None:
                raise ValueError(
                    f"regions: {_listed(loose[0])} would be in region {region[loose[0][0]]} of "
                    f"{robots}, but touch no other region and cannot be reached from one through "
                    f"the view of the base station at cell {base}"
                )
            piece, path = joined
            settled[path] = settled[piece] = settled[path[-1]]
        loose = [other for other in loose if other is not piece]
    return settled


def _pieces(
    near: scipy.sparse.csr_array, cells: Int[np.ndarray, "chosen"]
) -> list[Int[np.ndarray, "..."]]:
    """Return the connected components of a set of cells, the largest first."""
    if cells.size == 0:
        return []
    parts, part = scipy.sparse.csgraph.connected_components(near[cells][:, cells], directed=False)
    return sorted((cells[part == p] for p in range(parts)), key=len, reverse=True)


def _shortest_path(
    near: scipy.sparse.csr_array,
    piece: Int[np.ndarray, "chosen"],
    goal: Bool[np.ndarray, "cells"],
    through: Bool[np.ndarray, "cells"],
) -> list[int] | None:
    """Find the shortest path from `piece` via `through` to `goal`, without its start, or `None`."""
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
    path = []
    while before[here] >= 0:
        path.append(int(cells[here]))
        here = int(before[here])
    return path[::-1]


def check_visible(graph: Graph, visible: Bool[np.ndarray, "cells others"]) -> None:
    """Check that `visible` has one row and one column per cell of the graph."""
    if visible.shape != (graph.vertices, graph.vertices):
        raise ValueError(
            f"visible: expected an array [{graph.vertices}, {graph.vertices}], one row per cell of "
            f"the graph, got {list(visible.shape)}"
        )


def check_team(graph: Graph, visible: Bool[np.ndarray, "rows cells"], robots: int) -> None:
    check_visible(graph, visible)
    if not 1 <= robots <= graph.vertices:
        raise ValueError(
            f"robots: expected 1 to {graph.vertices}, the number of cells, got {robots}"
        )


def _check_sees(base: int, view: Bool[np.ndarray, "cells"]) -> None:
    if not np.delete(view, base).any():
        raise ValueError(
            f"view: the base station at cell {base} sees no other cell, so no robot could "
            "report to it"
        )


def _refusal(region: int, robots: int, reason: str) -> str:
    return (
        f"regions: region {region} of {robots} {reason}; expected fewer robots, or another base "
        "station"
    )


def _listed(cells: Int[np.ndarray, "chosen"]) -> str:
    shown = ", ".join(str(z) for z in cells[:8])
    return f"cells {shown}" + (f", ... ({cells.size})" if cells.size > 8 else "")
