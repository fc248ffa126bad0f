import dataclasses
import operator
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Bool, Float, Int

from ...base.certificate import Certificate, Numbers
from ...base.quantities import derived
from ...base.shown import Shown
from ...base.wide import traced
from ...mapping import Chain
from ...optimize import (
    Graph,
    GraphLike,
    MinimumCommute,
    greedy_cover,
    minimum_commute,
    minimum_cover,
    shortest_tour,
)
from ..team.division import part_of_graph
from ..walks.walk import random_walk
from .regions import Regions, check_team, check_visible


# Above this number of cells, the search for the smallest cover may take too long.
_MAX_COVERED = 500
_COVER_SECONDS = 5.0


@dataclasses.dataclass(frozen=True, eq=False)
class Policy(Shown):
    """The walk of one robot on the cells of a map, or on a subset of them."""

    cells: Int[np.ndarray, "visited"]
    "The cells that the robot visits, in ascending order."
    weights: Float[Numbers, "edges"]
    "The share of steps along each edge of the graph, in the long run."
    chain: Chain
    "The Markov chain of the walk, which stays in place in cells that the robot does not visit."
    cover: Int[np.ndarray, "stops"]
    "The cells from which all `cells` are seen, in the order in which they were chosen."
    uncovered: Int[np.ndarray, "unseen"]
    "The cells among `cells` that cannot be seen from any of `cells`."
    contact: int | None
    "The cell where the robot reports to a base station, or `None`."
    tour: Int[np.ndarray, "steps"] | None
    "The closed walk through the cover and the contact cell; `None` if they are a single cell."
    commute_time: float
    "The mean number of steps from one cell to another and back, over all pairs of `cells`."
    certificate: Certificate | None
    "The certificate of [`jaxcell.optimize.minimum_commute`][], if it computed the weights."

    def share_of_time(self, graph: Graph) -> Float[Numbers, "cells"]:
        """Compute the share of time that the robot spends in each cell in the long run."""
        if traced(self.weights):
            ends: Any = jnp.zeros(graph.vertices).at[graph.edges]
            return ends.add(jnp.tile(self.weights[:, None] / 2, (1, 2)))
        if not self.weights.any():
            return np.isin(np.arange(graph.vertices), self.cells) / self.cells.size
        return np.bincount(graph.edges.ravel(), np.repeat(self.weights, 2) / 2, graph.vertices)


def of_policies(path: str, *description: Any, **more: Any) -> Any:
    """Build a quantity: the attribute `path` of each policy; the rest is passed to `derived`."""
    attribute = operator.attrgetter(path)
    return derived(*description, **more)(
        lambda result: np.array([attribute(policy) for policy in result.policies])
    )


def distributed_policies(
    graph: GraphLike, visible: Bool[np.ndarray, "cells cells"], robots: int, share: float = 0.8
) -> tuple[Policy, ...]:
    """Compute walks that each watch the whole map (Alam 2018, section 4.4.4).

    Robot `i` has the cover of [`jaxcell.optimize.greedy_cover`][] with `choice=i`. Of all walks
    with at least a given share of steps on the closed tour through the cover, it takes the walk of
    least mean commute time, by [`jaxcell.optimize.minimum_commute`][]. A single cell needs no tour.

    **Arguments:** a connected graph and the visibility, as in
    [`jaxcell.patrol.capture_probabilities`][]; the number of robots; and the least share of steps
    on the tour, from 0 to 1. **Returns:** a [`Policy`][] for each robot.

    A corridor of five cells, each of which sees its neighbours; cells 1 and 3 see all cells:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> (policy,) = patrol.distributed_policies(graph, visible, 1)
        >>> policy.cover.tolist(), policy.tour.tolist(), policy.weights.round(3).tolist()
        ([1, 3], [1, 2, 3, 2], [0.1, 0.4, 0.4, 0.1])
    """
    check_team(graph, visible, robots)
    cells = np.arange(graph.vertices, dtype=np.int32)
    # Without an emphasis, the walk does not depend on the cover, so all robots have the same walk.
    walk = minimum_commute(graph) if share == 0 else None
    policies = [_policy(graph, cells, visible, share, choice=i, walk=walk) for i in range(robots)]
    if walk is not None:
        # A shared chain caches its derived arrays once for all robots.
        chain = policies[0].chain
        policies = [dataclasses.replace(policy, chain=chain) for policy in policies]
    return tuple(policies)


def centralized_policies(
    graph: GraphLike, visible: Bool[np.ndarray, "cells cells"], regions: Regions, share: float = 0.8
) -> tuple[Policy, ...]:
    """Compute walks that each watch one region and report to a base (Alam 2018, section 4.4.5).

    A robot stays in its region, and its cover consists of cells of the region. The source leaves
    the choice of the *contact cell* open: here it is the cell of the region, in view of the base
    station, with the least sum of path lengths to the cells of the cover.

    **Arguments:** the graph and the visibility, as in [`jaxcell.patrol.capture_probabilities`][];
    the region of each robot; and the least share of steps on the closed tour through the cover and
    the contact cell, from 0 to 1. **Returns:** a [`Policy`][] for each region, in order.

    A corridor of five cells with the base station in the middle. Each robot has two cells, sees
    both from the cell of its cover, and reports at cell 3 or 1:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> regions = patrol.map.angular_regions(graph, 2, visible[2], 2)
        >>> policies = patrol.map.centralized_policies(graph, visible, regions)
        >>> [(policy.contact, policy.cells.tolist(), policy.cover.tolist()) for policy in policies]
        [(3, [3, 4], [3]), (1, [0, 1], [0])]
    """
    check_visible(graph, visible)
    if regions.region.size != graph.vertices:
        raise ValueError(
            f"regions: expected regions of the {graph.vertices} cells of the graph, got "
            f"{regions.region.size} cells"
        )
    return tuple(
        _policy(graph, regions.cells(k), visible, share, view=regions.view)
        for k in range(regions.count)
    )


def smallest_covers(
    visible: Bool[np.ndarray, "cells cells"], policies: Sequence[Policy]
) -> Float[np.ndarray, "robots"]:
    """Find the size of the smallest cover of each robot's cells; NaN if this takes too long."""
    sizes: dict[bytes, float] = {}
    for policy in policies:
        key = policy.cells.tobytes()
        if policy.cells.size > _MAX_COVERED:
            sizes[key] = np.nan
        elif key not in sizes:
            sets = visible[np.ix_(policy.cells, policy.cells)]
            cover = minimum_cover(sets, time_limit=_COVER_SECONDS, throw=False)
            proven = 0 < cover.bound == cover.chosen.size
            sizes[key] = cover.chosen.size if proven else np.nan
    return np.array([sizes[policy.cells.tobytes()] for policy in policies], float)


def _policy(
    graph: Graph,
    cells: Int[np.ndarray, "visited"],
    visible: Bool[np.ndarray, "cells cells"],
    share: float,
    *,
    choice: int = 0,
    view: Bool[np.ndarray, "cells"] | None = None,
    walk: MinimumCommute | None = None,
) -> Policy:
    """Compute a policy on given cells, with a contact cell in `view` if there is a base station.

    The cover is the greedy cover with `choice`; a given `walk` is not optimised again.
    """
    inside = np.isin(graph.edges, cells).all(axis=1)
    part = part_of_graph(graph, cells)
    cover = greedy_cover(visible[np.ix_(cells, cells)], choice)
    stops, contact = cover.chosen, None
    if view is not None:
        contact = _contact(part, stops, view[cells])
        stops = np.union1d(stops, contact)
    through = stops.tolist() if stops.size > 1 else None
    if walk is None:
        walk = minimum_commute(part, through, share)
    elif through is not None:
        walk = dataclasses.replace(walk, tour=shortest_tour(part, through))
    weights = np.zeros(len(graph.edges))
    weights[inside] = walk.weights
    return Policy(
        cells=cells,
        weights=weights,
        chain=_among(cells, random_walk(part, walk.weights), graph.vertices),
        cover=cells[cover.chosen],
        uncovered=cells[cover.uncovered],
        contact=None if contact is None else int(cells[contact]),
        tour=None if walk.tour is None else cells[walk.tour],
        commute_time=walk.commute_time,
        certificate=walk.certificate,
    )


def _contact(
    graph: Graph, stops: Int[np.ndarray, "stops"], view: Bool[np.ndarray, "vertices"]
) -> int:
    """Find the vertex in view with the least sum of path lengths to the stops."""
    lengths = graph.matrix(graph.lengths)
    totals = scipy.sparse.csgraph.dijkstra(lengths, directed=False, indices=stops).sum(axis=0)
    return int(np.argmin(np.where(view, totals.round(9), np.inf)))


def _among(cells: Int[np.ndarray, "visited"], chain: Chain, count: int) -> Chain:
    """Extend a chain on given cells to all cells; in the other cells, it stays in place."""
    image = np.tile(np.arange(count, dtype=np.int32), (len(chain.image), 1))
    probability = np.zeros(image.shape)
    probability[0] = 1
    image[:, cells] = cells[np.asarray(chain.image)]
    probability[:, cells] = chain.probability
    return Chain(image, probability)
