import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.optimize
import scipy.sparse
import scipy.special

from ..optimize import Linear, conic, shortest_tour
from ..optimize.tour import on_walk
from ..patrol import GraphPatrol
from ..patrol.walks import StrategyGame
from .comparison import Comparison, sample, solve_transient


_TARGETS = 6
# A conic program with this number of pairs of a vertex and an edge takes some seconds.
_MAX_NUMBERS = 5_000
_TIME = 1e-6
_CLOSE = 1e-8


def compare_walk(patrol: GraphPatrol) -> list[Comparison]:
    """Compare hitting times, stationary distribution and entropy rate of a walk with scipy."""
    P, share, vertices = patrol.transition, patrol.stationary, len(patrol.names)
    visited, chain = np.flatnonzero(share > 0), scipy.sparse.csr_array(P)
    targets = visited[sample(visited.size, _TARGETS)]
    shares = share[None] if patrol.team is None else patrol.shares
    entropy = (shares * scipy.special.entr(patrol.matrices).sum(axis=2)).sum(axis=1).mean()
    compared = [
        Comparison.close("shares of time after a step", share @ P, share, _CLOSE),
        Comparison.close("entropy rate, by entr", [patrol.entropy_rate_nats], [entropy], _CLOSE),
    ]
    if patrol.hitting_time is None:
        return compared
    again = np.zeros((targets.size, vertices))
    for row, target in zip(again, targets.tolist(), strict=True):
        others = np.delete(np.arange(vertices), target)
        row[others] = solve_transient(chain, others, np.ones(vertices - 1))
    reported = patrol.hitting_time[:, targets].T
    about = "hitting times of some vertices, by spsolve", reported, again
    compared.insert(0, Comparison.close(*about, _TIME, relative=True))
    if patrol.kemeny_constant is not None:
        to_visited = patrol.hitting_time[np.ix_(visited, visited)] @ share[visited]
        kemeny = np.full(visited.size, patrol.kemeny_constant), to_visited
        what = "Kemeny constant, by the hitting times from each start"
        compared.append(Comparison.close(what, *kemeny, _TIME, relative=True))
    return compared


def compare_commute(
    patrol: GraphPatrol, emphasis: Sequence[int], share: float, constraints: Sequence[Linear] = ()
) -> list[Comparison]:
    """Compare the minimum commute time under constraints with a conic program in cvxpy.

    At least `share` of all steps must be on the shortest closed tour of the vertices `emphasis`.
    """
    graph, what = patrol.graph, "least commute time, by cvxpy"
    vertices, edges = graph.vertices, len(graph.edges)
    if vertices * edges > _MAX_NUMBERS:
        return [Comparison.omitted(what, f"more than {_MAX_NUMBERS:,} pairs of vertex and edge")]
    rules = list(constraints)
    if emphasis:
        tour = on_walk(graph, shortest_tour(graph, emphasis))
        rules.append(Linear("the emphasis", tour, lower=share))
    timed = patrol.timed
    times = None if timed is None else timed.duration
    least = conic.least_resistance(graph, rules, durations=times).least
    reported: list[Any] = [(patrol if timed is None else timed).mean_commute_time]
    expected = [4 * least / (vertices - 1)]
    compared = [Comparison.close(what, reported, expected, _TIME, relative=True)]
    if rules and timed is None:
        shares = patrol.weight
        beyond = [max(c.lower - (v := c.coefficients @ shares), v - c.upper, 0) for c in rules]
        broken = "violation of constraints"
        compared.append(Comparison.close(broken, beyond, np.zeros(len(rules)), _CLOSE))
    return compared


def compare_game(game: StrategyGame) -> list[Comparison]:
    """Compare the best mixture of walks with linear programs, one for each attacked vertex."""
    paid, best = game.adversary_payoff, -math.inf
    strategies, vertices = paid.shape
    for vertex in range(vertices):
        # With these constraints the adversary does not gain by attacking another vertex.
        gains, no_gain = (paid - paid[:, [vertex]]).T, np.zeros(vertices)
        shares = np.ones((1, strategies)), [1]
        cost = -game.patroller_payoff[:, vertex]
        solved = scipy.optimize.linprog(cost, gains, no_gain, *shares, method="highs-ipm")
        best = max(best, -solved.fun) if solved.status == 0 else best
    most = float((game.share @ paid).max())
    what = "payoff of the adversary, by the best of all vertices"
    scale = _TIME * max(1.0, float(np.abs(game.patroller_payoff).max()))
    return [
        Comparison.close("value of the game, by interior points", [game.value], [best], scale),
        Comparison.close(what, [game.adversary_value], [most], _TIME * max(1.0, abs(most))),
    ]
