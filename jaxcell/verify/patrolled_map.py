import networkx as nx
import numpy as np
import shapely
from jaxtyping import Bool

from ..patrol import PatrolledMap
from ..patrol.map import Policy
from ..space.sight import AT_CENTRE
from .comparison import Comparison, sample


_TARGETS = 12
_TIME = 1e-6
# A part of a line of sight, or of a step, that is due to rounding.
_ROUNDING = 1e-10
# Limit in standard deviations; a normal variable exceeds it about once in 10^15 draws.
_DEVIATIONS = 8.0


def compare_patrolled_map(patrol: PatrolledMap) -> list[Comparison]:
    """Compare visible cells, capture of the target, steps and commute times of a patrol.

    Sight and steps are found by polygons, and capture by simulation.
    """
    attack = patrol.attack
    targets = np.union1d(sample(patrol.cells.positions, _TARGETS), attack.target)
    looked = [_seen(patrol, target) for target in targets.tolist()]
    seen, sure = (np.stack(masks) for masks in zip(*looked, strict=True))
    wrong = [
        f"cell {targets[row]} from {viewer}: expected {'seen' if seen[row, viewer] else 'hidden'}"
        for row, viewer in np.argwhere((seen != patrol.visible[:, targets].T) & sure).tolist()
    ]
    # In the attack on one cell, the worst starts are those for the first time.
    times = slice(1) if patrol.captures.attack.start == "worst" else slice(None)
    exact, simulated = (one[times] for one in (attack.exact, attack.simulated))
    spread = np.maximum(exact * (1 - exact), 1 / attack.arrival.size)
    deviation = (simulated - exact) / np.sqrt(spread / attack.arrival.size)
    compared = [
        Comparison.exact("cells that are seen, by polygons of shapely", wrong, int(sure.sum())),
        Comparison.close(
            "capture of the target, by simulation, in standard deviations",
            deviation,
            np.zeros(deviation.size),
            _DEVIATIONS,
        ),
        _compare_steps(patrol),
    ]
    if patrol.search is None:
        back = "commute times of the robots, by resistances of networkx"
        commutes = [_commute(patrol, one) for one in patrol.policies]
        compared.append(Comparison.close(back, patrol.commute_time, commutes, _TIME, relative=True))
    return compared


def _seen(
    patrol: PatrolledMap, target: int
) -> tuple[Bool[np.ndarray, "cells"], Bool[np.ndarray, "cells"]]:
    """Find the cells from which `target` is seen, and those of which this is sure."""
    assert patrol.cells.workspace is not None
    environment, cell = patrol.cells.workspace.environment, patrol.cells.cell
    side = cell * (AT_CENTRE if patrol.sight == "centre" else 1)
    every = np.arange(patrol.cells.positions)
    eye, other = (every, target) if patrol.sight != "source" else (target, every)
    eyes = np.broadcast_to(shapely.points(*patrol.xy[eye].T), every.shape)
    low, high = (patrol.xy[other] + sign * side / 2 for sign in (-1, 1))
    squares = np.broadcast_to(shapely.box(*low.T, *high.T), every.shape)

    parts = shapely.intersection(squares, environment)
    beyond = shapely.hausdorff_distance(eyes, parts) - patrol.reach
    near = np.flatnonzero(beyond < _TIME * cell)
    triangles, of = shapely.get_parts(
        shapely.constrained_delaunay_triangles(parts[near]), return_index=True
    )
    sights = shapely.convex_hull(shapely.union(triangles, eyes[near][of]))
    behind = shapely.area(shapely.difference(sights, environment)) / shapely.area(sights)
    hidden = np.zeros(every.size)
    np.maximum.at(hidden, near[of], behind)
    unsure = (np.abs(beyond) < _TIME * cell) | ((hidden > _ROUNDING) & (hidden < _TIME))
    return (beyond < 0) & (hidden <= _ROUNDING), ~unsure


def _compare_steps(patrol: PatrolledMap) -> Comparison:
    """Test whether robots go along free segments, as far from walls as their radius."""
    assert patrol.cells.workspace is not None
    workspace, small = patrol.cells.workspace, _TIME * patrol.cells.cell
    used = np.flatnonzero(np.sum([one.weights for one in patrol.policies], axis=0))
    ways = shapely.linestrings(patrol.xy[patrol.graph.edges[used]])
    outside = shapely.length(shapely.difference(ways, workspace.environment))
    beside = shapely.distance(ways, shapely.boundary(workspace.environment))
    blocked = (outside > small) | (beside < workspace.robot_radius - small)
    wrong = [f"edge {edge}" for edge in used[blocked].tolist()]
    return Comparison.exact("steps through walls, by segments of shapely", wrong, used.size)


def _commute(patrol: PatrolledMap, policy: Policy) -> float:
    """Compute the mean commute time 2 C R, with total conductance C = 1 and mean resistance R."""
    used = policy.weights > 0
    if not used.any():
        return 0.0
    graph = nx.Graph()
    edges = zip(*patrol.graph.edges[used].T.tolist(), policy.weights[used].tolist(), strict=True)
    graph.add_weighted_edges_from(edges)
    resistance = nx.effective_graph_resistance(graph, weight="weight", invert_weight=False)
    return float(4 * resistance / (len(graph) * (len(graph) - 1)))
