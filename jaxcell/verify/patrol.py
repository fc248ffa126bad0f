from collections.abc import Sequence

import numpy as np
import scipy.optimize
import shapely
from jaxtyping import Bool, Float

from ..optimize import Graph
from ..patrol import Policy
from ..patrol.map.attack import Vulnerability
from ..patrol.walks.game import StrategyGame
from ..patrol.walks.measures import Measures
from ..space import CellSpace
from .bounce import sample
from .comparison import Comparison


_TARGETS = 6
_PAIRS = 150
_ROBOTS = 3
# Of eigenvalues and inverses, which take a second.
_MOST_VERTICES = 700
_TIME = 1e-6
_CLOSE = 1e-8
# So many standard deviations are seen once in 10^14 numbers that are normal.
_DEVIATIONS = 8.0


def compare_walk(measures: Measures) -> list[Comparison]:
    """A patroller's chain on a graph against dense solves and eigenvalues."""
    P, share, times = measures.transition, measures.stationary, measures.hitting_times
    vertices = len(P)
    again, told = [], []
    for target in sample(vertices, _TARGETS).tolist():
        others = np.delete(np.arange(vertices), target)
        system = np.eye(vertices - 1) - P[np.ix_(others, others)]
        again.append(np.linalg.solve(system, np.ones(vertices - 1)))
        told.append(times[others, target])
    what = "hitting times of some vertices, by dense solves"
    found = [
        Comparison.close(
            "what a step changes of the shares of time, by the dense matrix",
            share @ P,
            share,
            _CLOSE,
        ),
        Comparison.close(what, np.array(told), np.array(again), _TIME, relative=True),
    ]
    logarithm = np.log(np.where(P > 0, P, 1))
    entropy = -float(share @ (P * logarithm).sum(axis=1))
    what = "entropy rate, by its definition"
    found.append(Comparison.close(what, [measures.entropy_rate], [entropy], _CLOSE))
    what = "Kemeny constant, by eigenvalues"
    if vertices > _MOST_VERTICES:
        found.append(Comparison.omitted(what, f"more than {_MOST_VERTICES} vertices"))
        return found
    values = np.linalg.eigvals(P)
    kemeny = (1 / (1 - np.delete(values, np.abs(values - 1).argmin()))).sum().real
    found.append(Comparison.close(what, [measures.kemeny_constant], [kemeny], _TIME, relative=True))
    return found


def compare_game(game: StrategyGame) -> list[Comparison]:
    """A mixture of walks against a linear program for each vertex that may be attacked."""
    best = -np.inf
    strategies, vertices = game.patroller.shape
    for vertex in range(vertices):
        # No other vertex pays the adversary more.
        solved = scipy.optimize.linprog(
            -game.patroller[:, vertex],
            A_ub=(game.adversary - game.adversary[:, [vertex]]).T,
            b_ub=np.zeros(vertices),
            A_eq=np.ones((1, strategies)),
            b_eq=[1],
            method="highs-ipm",
        )
        if solved.status == 0:
            best = max(best, -solved.fun)
    commitment = game.commitment
    weights, attacked = np.asarray(commitment.weights), int(commitment.answer[0])
    paid = weights @ game.adversary
    scale = 1e-6 * max(1.0, float(np.abs(game.patroller).max()))
    value = commitment.value
    return [
        Comparison.close("value of the game, by interior points", [value], [best], scale),
        Comparison.close(
            "what the adversary is paid, by the best of all vertices",
            [paid[attacked]],
            [paid.max()],
            1e-6 * max(1.0, float(np.abs(paid).max())),
        ),
    ]


def compare_patrol(
    cells: CellSpace,
    reach: float,
    graph: Graph,
    visible: Bool[np.ndarray, "cells cells"],
    policies: Sequence[Policy],
    attack: Vulnerability,
    capture: Float[np.ndarray, "times cells"],
) -> list[Comparison]:
    """The patrol of a map against polygons of shapely, distributions pushed forward, and inverses.

    **Arguments:**

    - `cells`, `reach`: the cells of a map, and how far robots see, in metres.
    - `graph`, `visible`, `policies`: as for [`jaxcell.patrol.capture_probabilities`][].
    - `attack`: one attack.
    - `capture`: the probabilities for all cells at its attack times.
    """
    times = attack.attack_times
    targets = sample(cells.positions, _TARGETS).tolist()
    caught = np.array([_caught(visible[one], policies, times) for one in targets])
    spread = np.maximum(attack.exact * (1 - attack.exact), 1 / attack.arrivals.time.size)
    deviation = (attack.simulated - attack.exact) / np.sqrt(spread / attack.arrivals.time.size)
    found = [
        _compare_sight(cells, reach, visible),
        Comparison.close(
            "capture of some cells, by pushing distributions forward",
            capture[:, targets].T,
            caught,
            _CLOSE,
        ),
        Comparison.close(
            "capture of the target, by simulation, in standard deviations",
            deviation,
            np.zeros(times.size),
            _DEVIATIONS,
        ),
    ]
    what = "commute times of the robots, by inverting"
    walks = [one for one in policies if 1 < one.cells.size <= _MOST_VERTICES][:_ROBOTS]
    if not walks:
        return [*found, Comparison.omitted(what, "no walk of two cells or more that is small")]
    told = [one.commute_time for one in walks]
    inverted = [_commute_time(one) for one in walks]
    return [*found, Comparison.close(what, told, inverted, _TIME, relative=True)]


def _caught(
    view: Bool[np.ndarray, "cells"], policies: Sequence[Policy], times: np.ndarray
) -> np.ndarray:
    """The probability that one robot has been in view, by each of some times."""
    survive = np.ones(int(times.max()) + 1)
    for policy in policies:
        walked = np.isin(np.arange(view.size), policy.cells) & ~view
        unseen = walked / max(1, walked.sum())
        forward = policy.chain.to_scipy().T.tocsr()
        for t in range(survive.size):
            survive[t] *= unseen.sum()
            unseen = np.where(view, 0, forward @ unseen)
    return 1 - survive[times]


def _commute_time(policy: Policy) -> float:
    """The mean over pairs of cells, from the fundamental matrix."""
    P = policy.chain.to_scipy()[policy.cells][:, policy.cells].toarray()
    count = len(P)
    # The shares of time, from one equation too many.
    system = np.vstack([P.T - np.eye(count), np.ones(count)])
    share = np.linalg.lstsq(system, np.append(np.zeros(count), 1), rcond=None)[0]
    Z = np.linalg.inv(np.eye(count) - P + share)
    times = (np.diag(Z) - Z) / share
    return float(2 * times.sum() / (count * (count - 1)))


def _compare_sight(
    cells: CellSpace, reach: float, visible: Bool[np.ndarray, "cells cells"]
) -> Comparison:
    """Pairs of cells of which the second is a whole square, half of them visible."""
    assert cells.workspace is not None
    environment, side = cells.workspace.environment, cells.cell
    random = np.random.default_rng(0)
    wrong, count = [], 0
    for seen in (True, False):
        viewers, others = np.nonzero(visible == seen)
        for i in sample(viewers.size, _PAIRS // 2, seed=int(random.integers(2**31))).tolist():
            viewer, other = int(viewers[i]), int(others[i])
            (x, here_x), (y, here_y) = (
                v.tolist() for v in cells.centre(np.array([other, viewer]))[:2]
            )
            square = shapely.box(x - side / 2, y - side / 2, x + side / 2, y + side / 2)
            if square.difference(environment).area > 1e-10 * side**2:
                continue
            eye = shapely.Point(here_x, here_y)
            far = float(eye.hausdorff_distance(square)) - reach
            hull = shapely.union(square, eye).convex_hull
            hidden = hull.difference(environment).area / side**2
            if abs(far) < 1e-6 * side or 1e-10 < hidden < 1e-6:
                continue
            count += 1
            if (far < 0 and hidden <= 1e-10) != seen:
                wrong.append(f"cell {other} from {viewer}: {'seen' if seen else 'hidden'} is told")
    return Comparison.exact("cells that are seen, by polygons of shapely", wrong, count)
