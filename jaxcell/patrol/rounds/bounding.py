"""Upper bounds on what any patrol of some robots does, whatever its strategy."""

from typing import NamedTuple

import numpy as np
import scipy.sparse.csgraph

from .blind import least_risk
from .game import Game
from .joint import safe_routes, watched_risk
from .mixing import mix
from .subsets import MOST_ROBOTS, MOST_SUBSETS, closed_tours, membership, of_several, open_walks


# Relative increase of a way of length 0, which sparse matrices leave out.
_LITTLE = 1e-12


class Bound(NamedTuple):
    """Limits of all patrols by the robots of a game, against any adversary."""

    between: float
    "The longest time between visits to the target that is visited least is at least this long."
    capture: float
    """The least probability of capture over targets is at most this for the adversary of the game:
    1 less a risk that no patrol undercuts, relative to the largest value. In small games with a
    watcher it is rounded up to a multiple of 1/1024."""
    exact: bool
    """`True` if all sets of targets on walks were compared, in up to 14 targets and 4 robots. Such
    walks need not follow one another, so that a patrol may be worse. `False` for the weaker bounds
    by spanning trees."""
    preventable: bool | None = None
    "`True` if a joint schedule stops every attack, `False` if none does, `None` if unknown."
    least: bool = False
    """`True` if a patrol is known to have this capture: one that stops every attack or, for a blind
    adversary, [`best_mixture`][]. Otherwise the truth may be less."""


def bound(game: Game) -> Bound:
    """Bound the time between visits, and the capture, of all patrols of a game.

    In any stretch of time as long as an attack, each robot visits the targets of a walk of this
    length. For up to 14 targets and 4 robots, the sets of targets on such walks are computed, and
    a linear program mixes them; otherwise the number of targets on walks is bounded by the shortest
    edges of a spanning tree. One robot needs the shortest closed tour between visits to a target.
    In small games with whole times all joint schedules are compared: `safe_routes` decides whether
    one stops every attack. In smaller ones `least_risk` computes the least risk for a blind
    adversary, and `watched_risk` bounds random walks for a watcher.

    One robot on a cycle of four vertices, where attacks take 3 steps:

        >>> from jaxcell import patrol
        >>> cycle = patrol.Graph([(i, (i + 1) % 4) for i in range(4)])
        >>> patrol.rounds.bound(patrol.rounds.Game.of(cycle, 3.0))
        Bound(between=4.0, capture=0.75, exact=True, preventable=False, least=True)
    """
    few = game.targets.size <= MOST_SUBSETS and game.robots <= MOST_ROBOTS
    found = _by_subsets(game) if few else _by_trees(game)
    if (safe := safe_routes(game)) is None:
        return found
    if safe:
        return found._replace(preventable=True, least=True)
    blind, watched = least_risk(game), None
    if game.adversary == "watcher":
        watched = watched_risk(game)
    risk = max((one for one in (blind, watched) if one is not None), default=0.0)
    capture = min(found.capture, 1 - risk / float(game.value.max()))
    known = blind is not None and game.adversary == "blind"
    return found._replace(capture=capture, preventable=False, least=known)


def _by_subsets(game: Game) -> Bound:
    between, count = game.between, game.targets.size
    free = open_walks(between, np.full(count, np.inf))
    longest = float(of_several(free, game.robots)[-1])
    if game.robots == 1:
        longest = float(closed_tours(between)[-1])
    timely = open_walks(between, game.attack)
    possible = np.isfinite(of_several(np.where(np.isfinite(timely), 0.0, np.inf), game.robots))
    inside = membership(count)
    larger = np.array([possible[np.arange(1 << count) | 1 << target] for target in range(count)])
    maximal = possible & ~(larger.T & ~inside).any(axis=1)
    mixed = mix(inside[maximal].astype(float), game.value / game.value.max())
    return Bound(longest, float(np.clip(1 - mixed.risk, 0.0, 1.0)), True)


def _by_trees(game: Game) -> Bound:
    between = game.between
    either = np.minimum(between, between.T)
    finite = np.where(np.isfinite(either), np.maximum(either, _LITTLE), 0.0)
    edges = np.sort(scipy.sparse.csgraph.minimum_spanning_tree(finite).data)
    count, robots = game.targets.size, game.robots
    # Walks of robots through all targets contain a forest, with a tree for each robot.
    joined = np.append(0.0, np.cumsum(edges))
    longest = (
        float(joined[max(0, count - robots)]) / robots if edges.size >= count - robots else 0.0
    )
    within = robots * float(game.attack.max())
    reached = robots + int(np.searchsorted(joined, within * (1 + 1e-9), side="right")) - 1
    # The least risk if `reached` targets can be visited at a time, by the most valuable ones.
    value = np.sort(game.value / game.value.max())[::-1]
    missed = np.arange(1, count + 1) - reached
    risk = float((missed / np.cumsum(1 / value)).max(initial=0.0))
    return Bound(longest, min(1.0, 1 - max(0.0, risk)), False)
