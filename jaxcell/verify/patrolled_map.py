import networkx as nx
import numpy as np
import scipy.sparse
import shapely
from jaxtyping import Bool, Float

from ..patrol import PatrolledMap
from ..patrol.map import Policy
from ..space.sight import AT_CENTRE
from .comparison import Comparison, sample


_TARGETS = 12
_CLOSE = 1e-8
_TIME = 1e-6
# A part of a line of sight, or of a step, that is due to rounding.
_ROUNDING = 1e-10
# Limit in standard deviations; a normal variable exceeds it about once in 10^15 draws.
_DEVIATIONS = 8.0


def compare_patrolled_map(patrol: PatrolledMap) -> list[Comparison]:
    """Compare visible cells, capture probabilities and walks with independent computations.

    Sight is found by polygons, and walks are made from the shares of steps along edges. Where a
    search chose the walks, they are those of the result.
    """
    attack, start = patrol.attack, patrol.captures.attack.start
    targets = np.union1d(sample(patrol.cells.positions, _TARGETS), attack.target)
    looked = [_seen(patrol, target) for target in targets.tolist()]
    seen, sure = (np.stack(masks) for masks in zip(*looked, strict=True))
    reported = patrol.visible[:, targets].T
    wrong = [
        f"cell {targets[row]} from {viewer}: expected {'seen' if seen[row, viewer] else 'hidden'}"
        for row, viewer in np.argwhere((seen != reported) & sure).tolist()
    ]
    sight = Comparison.exact("cells that are seen, by polygons of shapely", wrong, int(sure.sum()))

    walks = [_walk(patrol, policy) for policy in patrol.policies]
    views = np.where(sure, seen, reported)
    caught = np.array([_caught(patrol, walks, view) for view in views])
    expected = caught[targets.tolist().index(attack.target)]
    # In the attack on one cell, the worst starts are those for the first time.
    times = slice(1) if start == "worst" else slice(None)
    exact, simulated = (one[times] for one in (attack.exact, attack.simulated))
    spread = np.maximum(expected[times] * (1 - expected[times]), 1 / attack.arrival.size)
    deviation = (simulated - expected[times]) / np.sqrt(spread / attack.arrival.size)
    return [
        sight,
        Comparison.close(
            "capture of some cells, by shares of steps along edges",
            np.append(patrol.captures.probability[:, targets].T, exact),
            np.append(caught, expected[times]),
            _CLOSE,
        ),
        Comparison.close(
            "capture of the target, by simulation, in standard deviations",
            deviation,
            np.zeros(deviation.size),
            _DEVIATIONS,
        ),
        *_compare_walks(patrol, walks),
    ]


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


def _walk(
    patrol: PatrolledMap, policy: Policy
) -> tuple[scipy.sparse.csr_array, Float[np.ndarray, "cells"]]:
    """Make the transition matrix of a robot, and compute its share of time in each cell."""
    every = np.arange(patrol.cells.positions)
    one, other = patrol.graph.edges.T
    pairs, steps = (np.append(one, other), np.append(other, one)), np.tile(policy.weights / 2, 2)
    share = np.zeros(every.size)
    np.add.at(share, pairs[0], steps)
    if not steps.any():
        share[policy.cells] = 1 / policy.cells.size
    if patrol.search is None:
        stays = ~np.isin(every, np.asarray(pairs[0])[steps > 0])
        steps = np.append(steps / np.where(share > 0, share, 1)[pairs[0]], stays.astype(float))
        pairs = np.append(pairs[0], every), np.append(pairs[1], every)
    else:
        image, steps = (np.asarray(a) for a in (policy.chain.image, policy.chain.probability))
        pairs, steps = (np.tile(every, len(image)), image.ravel()), steps.ravel()
    return scipy.sparse.csr_array((steps, pairs), shape=(every.size,) * 2), share


def _caught(
    patrol: PatrolledMap, walks: list, view: Bool[np.ndarray, "cells"]
) -> Float[np.ndarray, "times"]:
    """Compute the probability that a robot sees an attack, for each attack duration."""
    times, start = patrol.attack.attack_time, patrol.captures.attack.start
    survive = np.ones(int(times.max()) + 1)
    for policy, (steps, shares) in zip(patrol.policies, walks, strict=True):
        unseen = np.isin(np.arange(view.size), policy.cells) & ~view
        if start == "worst":
            each = np.diag(unseen.astype(float))[:, unseen]
        else:
            share = unseen * (shares if start == "stationary" else 1.0)
            each = (share / share.sum())[:, None] if share.any() else np.zeros((view.size, 0))
        for t in range(survive.size):
            survive[t] *= each.sum(axis=0).max(initial=0.0)
            each = np.where(view[:, None], 0, steps.T @ each)
    return 1 - survive[times]


def _compare_walks(patrol: PatrolledMap, walks: list) -> list[Comparison]:
    compared = [_compare_steps(patrol)]
    if patrol.search is None:
        gap = [
            abs(policy.chain.to_scipy() - steps).max()
            for policy, (steps, _) in zip(patrol.policies, walks, strict=True)
        ]
        turns = "probabilities of steps, by shares of steps along edges"
        compared.append(Comparison.close(turns, gap, np.zeros(len(gap)), _CLOSE))
        back = "commute times of the robots, by resistances of networkx"
        commutes = [_commute(patrol, one) for one in patrol.policies]
        compared.append(Comparison.close(back, patrol.commute_time, commutes, _TIME, relative=True))
    else:
        what = "shares of time, a step later"
        shares, later = [share for _, share in walks], [steps.T @ share for steps, share in walks]
        compared.append(Comparison.close(what, shares, later, _CLOSE))
    return compared


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
