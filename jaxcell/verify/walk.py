import math
import warnings
from collections.abc import Sequence

import numpy as np
import scipy.optimize
import scipy.sparse
import scipy.special

from ..optimize import shortest_tour
from ..patrol import GraphPatrol, StrategyGame
from .bounce import sample
from .comparison import Comparison, solve_transient


_TARGETS = 6
# A conic program with a number for each pair of a vertex and an edge takes some seconds.
_MAX_NUMBERS = 5_000
_TIME = 1e-6
_CLOSE = 1e-8


def compare_walk(patrol: GraphPatrol) -> list[Comparison]:
    """Compare a walk on a graph with sparse solves of scipy."""
    P, share, vertices = patrol.transition, patrol.stationary, len(patrol.names)
    visited, chain = np.flatnonzero(share > 0), scipy.sparse.csr_array(P)
    targets = visited[sample(visited.size, _TARGETS)]
    again = np.zeros((targets.size, vertices))
    for row, target in zip(again, targets.tolist(), strict=True):
        others = np.delete(np.arange(vertices), target)
        row[others] = solve_transient(chain, others, np.ones(vertices - 1))
    found = patrol.hitting_time[:, targets].T
    entropy = share @ scipy.special.entr(P).sum(axis=1)
    about = "hitting times of some vertices, by spsolve", found, again
    to_visited = patrol.hitting_time[np.ix_(visited, visited)] @ share[visited]
    kemeny = np.full(visited.size, patrol.kemeny_constant), to_visited
    what = "Kemeny constant, by the hitting times from each start"
    return [
        Comparison.close(*about, _TIME, relative=True),
        Comparison.close("shares of time after a step", share @ P, share, _CLOSE),
        Comparison.close("entropy rate, by entr", [patrol.entropy_rate_nats], [entropy], _CLOSE),
        Comparison.close(what, *kemeny, _TIME, relative=True),
    ]


def compare_commute(patrol: GraphPatrol, emphasis: Sequence[int], share: float) -> list[Comparison]:
    """Compare the least commute time with a conic program of cvxpy.

    The sum of the resistances between all vertices is the least energy of currents `F` that lead
    from each vertex to all others evenly, `sum_e |F_e|^2 / w_e` over edges with conductances `w`.
    """
    import cvxpy

    graph, what = patrol.graph, "least commute time, by cvxpy"
    vertices, edges = graph.vertices, len(graph.edges)
    if vertices * edges > _MAX_NUMBERS:
        return [Comparison.omitted(what, f"more than {_MAX_NUMBERS:,} pairs of vertex and edge")]
    incidence = np.zeros((edges, vertices))
    incidence[np.arange(edges)[:, None], graph.edges] = [1, -1]
    weight, flow = cvxpy.Variable(edges), cvxpy.Variable((vertices, edges))
    rules = [cvxpy.sum(weight) == 1, flow @ incidence == np.eye(vertices) - 1 / vertices]
    if emphasis:
        tour = shortest_tour(graph, emphasis)
        pairs = {frozenset(pair) for pair in zip(tour, np.roll(tour, -1), strict=True)}
        on_tour = [i for i, edge in enumerate(graph.edges) if frozenset(edge) in pairs]
        rules.append(cvxpy.sum(weight[on_tour]) >= share)
    times = np.ones(edges) if patrol.timed is None else patrol.timed.duration
    energy = cvxpy.sum(
        [cvxpy.quad_over_lin(flow[:, e], weight[e]) * times[e] for e in range(edges)]
    )
    with warnings.catch_warnings():
        # The comparison says whether it is accurate enough.
        warnings.simplefilter("ignore")
        least = cvxpy.Problem(cvxpy.Minimize(energy), rules).solve(solver="CLARABEL")
    found = [(patrol if patrol.timed is None else patrol.timed).mean_commute_time]
    return [Comparison.close(what, found, [4 * least / (vertices - 1)], _TIME, relative=True)]


def compare_game(game: StrategyGame) -> list[Comparison]:
    """Compare a mixture of walks with a linear program for each vertex that may be attacked."""
    paid, best = game.adversary_payoff, -math.inf
    strategies, vertices = paid.shape
    for vertex in range(vertices):
        # No other vertex pays the adversary more.
        gains, no_gain = (paid - paid[:, [vertex]]).T, np.zeros(vertices)
        shares = np.ones((1, strategies)), [1]
        cost = -game.patroller_payoff[:, vertex]
        solved = scipy.optimize.linprog(cost, gains, no_gain, *shares, method="highs-ipm")
        best = max(best, -solved.fun) if solved.status == 0 else best
    most = float((game.share @ paid).max())
    what = "what the adversary is paid, by the best of all vertices"
    scale = _TIME * max(1.0, float(np.abs(game.patroller_payoff).max()))
    return [
        Comparison.close("value of the game, by interior points", [game.value], [best], scale),
        Comparison.close(what, [game.adversary_value], [most], _TIME * max(1.0, abs(most))),
    ]
