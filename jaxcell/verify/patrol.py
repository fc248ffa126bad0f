import numpy as np
import scipy.optimize

from ..patrol.walks.game import StrategyGame
from ..patrol.walks.measures import Measures
from .bounce import sample
from .comparison import Comparison


_TARGETS = 6
# Of eigenvalues and inverses, which take a second.
_MOST_VERTICES = 700
_TIME = 1e-6
_CLOSE = 1e-8


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
