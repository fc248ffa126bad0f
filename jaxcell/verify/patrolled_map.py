import networkx as nx
import numpy as np
import shapely

from ..patrol import PatrolledMap
from ..patrol.map import Policy
from ..space.sight import AT_CENTRE
from .comparison import Comparison, sample


_TARGETS = 6
_PAIRS = 150
_CLOSE = 1e-8
_TIME = 1e-6
# Limit in standard deviations; a normal variable exceeds it about once in 10^15 draws.
_DEVIATIONS = 8.0


def compare_patrolled_map(patrol: PatrolledMap) -> list[Comparison]:
    """Compare visible cells, capture probabilities and walks with independent computations."""
    attack, times = patrol.attack, patrol.attack.attack_time
    targets = sample(patrol.cells.positions, _TARGETS).tolist()
    caught = np.array([_caught(patrol, target) for target in targets])
    spread = np.maximum(attack.exact * (1 - attack.exact), 1 / attack.arrival.size)
    deviation = (attack.simulated - attack.exact) / np.sqrt(spread / attack.arrival.size)
    seen = "capture of some cells, by products with sparse matrices"
    runs = "capture of the target, by simulation, in standard deviations"
    return [
        _compare_sight(patrol),
        Comparison.close(seen, patrol.captures.probability[:, targets].T, caught, _CLOSE),
        Comparison.close(runs, deviation, np.zeros(times.size), _DEVIATIONS),
        _compare_walks(patrol),
    ]


def _compare_walks(patrol: PatrolledMap) -> Comparison:
    if patrol.search is None:
        back = "commute times of the robots, by resistances of networkx"
        commutes = [_commute(patrol, one) for one in patrol.policies]
        return Comparison.close(back, patrol.commute_time, commutes, _TIME, relative=True)
    shares = [policy.share_of_time(patrol.graph) for policy in patrol.policies]
    later = [
        policy.chain.to_scipy().T @ share
        for policy, share in zip(patrol.policies, shares, strict=True)
    ]
    return Comparison.close("shares of time, a step later", shares, later, _CLOSE)


def _caught(patrol: PatrolledMap, target: int) -> np.ndarray:
    """Compute the probability that a robot sees an attack on `target`, for each attack duration."""
    view, times = patrol.visible[:, target], patrol.attack.attack_time
    survive = np.ones(int(times.max()) + 1)
    for policy in patrol.policies:
        unseen = np.isin(np.arange(view.size), policy.cells) & ~view
        forward = policy.chain.to_scipy().T.tocsr()
        if patrol.captures.attack.start == "worst":
            each = np.diag(unseen.astype(float))[:, unseen]
        else:
            share = unseen.astype(float)
            if patrol.captures.attack.start == "stationary":
                share *= policy.share_of_time(patrol.graph)
            each = (share / share.sum())[:, None] if share.any() else np.zeros((view.size, 0))
        for t in range(survive.size):
            survive[t] *= each.sum(axis=0).max(initial=0.0)
            each = np.where(view[:, None], 0, forward @ each)
    return 1 - survive[times]


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


def _compare_sight(patrol: PatrolledMap) -> Comparison:
    assert patrol.cells.workspace is not None
    environment, side = patrol.cells.workspace.environment, patrol.cells.cell
    if patrol.sight == "centre":
        side *= AT_CENTRE
    visible = patrol.visible.T if patrol.sight == "source" else patrol.visible
    wrong, count = [], 0
    for seen in (True, False):
        pairs = np.argwhere(visible == seen)
        for viewer, other in pairs[sample(len(pairs), _PAIRS // 2, seed=seen)].tolist():
            (x, y), eye = patrol.xy[other].tolist(), shapely.Point(patrol.xy[viewer])
            square = shapely.box(x - side / 2, y - side / 2, x + side / 2, y + side / 2)
            if square.difference(environment).area > 1e-10 * side**2:
                continue
            far = float(eye.hausdorff_distance(square)) - patrol.reach
            hull = shapely.union(square, eye).convex_hull
            hidden = hull.difference(environment).area / hull.area
            if abs(far) < 1e-6 * patrol.cells.cell or 1e-10 < hidden < 1e-6:
                continue
            count += 1
            if (far < 0 and hidden <= 1e-10) != seen:
                expected = "hidden" if seen else "seen"
                wrong.append(f"cell {other} from {viewer}: expected {expected}")
    return Comparison.exact("cells that are seen, by polygons of shapely", wrong, count)
