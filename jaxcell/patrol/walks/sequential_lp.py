from collections.abc import Callable

import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Float

from .polytope import ChainPolytope


_STEPS = 300
# Of a probability: how far the first step may go.
_FIRST = 0.1
# Steps that are shorter are lost in rounding.
_SHORTEST = 1e-9
# Of what was predicted: less is no step, and from there on the next may be longer.
_ENOUGH, _GOOD = 0.1, 0.75

# Of the value: what is further above the least is left out of the programs that make a step.
_NEAR = 0.5

# The probabilities of capture of each robot, and their derivatives by its moves.
Law = Callable[
    [Float[np.ndarray, "robots moves"]],
    tuple[
        Float[np.ndarray, "robots starts targets"],
        Float[np.ndarray, "robots starts targets moves"],
    ],
]


def maximize_least_capture(
    law: Law, polytope: ChainPolytope, moves: Float[np.ndarray, "robots moves"], tolerance: float
) -> tuple[Float[np.ndarray, "robots moves"], float, float, int]:
    """Maximize the least probability of capture by linear programs, within a trusted distance.

    Near a maximum of a least of smooth functions, several are least at the same time, and often so
    many that they determine it. Linear programs then find it as fast as Newton's method, where
    gradients of a soft minimum creep.

    **Returns:** the chains of the robots, the probability, the share of itself by which the linear
    program without a distance would raise it, and the number of programs.
    """
    probability, slope = law(moves)
    value = _value(probability)
    distance = _FIRST
    for programs in range(1, _STEPS):
        trial, predicted = _program(polytope, moves, probability, slope, distance)
        # No gain without a distance is less than one within it.
        if predicted <= tolerance / 10 or distance < _SHORTEST:
            gain = _program(polytope, moves, probability, slope, 1.0)[1]
            if gain <= tolerance / 4 or distance < _SHORTEST:
                return moves, value, gain, programs
        there = law(trial)
        raised_by = _value(there[0]) / value - 1
        distance = min(1.0, 2 * distance) if raised_by > _GOOD * predicted else distance
        if raised_by > _ENOUGH * predicted:
            moves, (probability, slope), value = trial, there, _value(there[0])
        else:
            distance /= 3
    return moves, value, _program(polytope, moves, probability, slope, 1.0)[1], _STEPS


def _value(probability: Float[np.ndarray, "robots starts targets"]) -> float:
    return float((1 - (1 - probability.min(axis=1)).prod(axis=0)).min())


def _program(
    polytope: ChainPolytope,
    moves: Float[np.ndarray, "robots moves"],
    probability: Float[np.ndarray, "robots starts targets"],
    slope: Float[np.ndarray, "robots starts targets moves"],
    distance: float,
) -> tuple[Float[np.ndarray, "robots moves"], float]:
    """The best chains if all probabilities changed as they do at first.

    The variables are the probabilities of the moves of each robot, how much its least probability
    of capture changes for each target, and the share by which the value does. Capture is in units
    of the value.

    **Returns:** the chains and that share, which is not negative.
    """
    robots, count = moves.shape
    targets = probability.shape[2]
    worst = probability.min(axis=1)
    miss = 1 - worst
    captured = 1 - miss.prod(axis=0)
    value = float(captured.min())
    lines, sides = [], []
    for robot in range(robots):
        above = (probability[robot] - worst[robot]).reshape(-1) / value
        # Without a distance all count, for the gain to be a close bound.
        near = above <= (_NEAR if distance < 1 else np.inf)
        flat = slope[robot].reshape(-1, count)[near] / value
        line = np.zeros((flat.shape[0], robots * (count + targets) + 1))
        line[:, robot * count : (robot + 1) * count] = -flat
        first = robots * count + robot * targets
        line[:, first : first + targets] = np.tile(np.eye(targets), (targets, 1))[near]
        lines.append(line)
        sides.append(above[near] - flat @ moves[robot])
    line = np.zeros((targets, robots * (count + targets) + 1))
    for robot in range(robots):
        others = np.delete(miss, robot, axis=0).prod(axis=0)
        first = robots * count + robot * targets
        line[:, first : first + targets] = -np.diag(others)
    line[:, -1] = 1
    lines.append(line)
    sides.append(captured / value - 1)
    sums, totals = polytope.equalities()
    equal = scipy.sparse.block_diag([sums] * robots)
    equal = scipy.sparse.hstack(
        [equal, scipy.sparse.csr_array((equal.shape[0], robots * targets + 1))], format="csr"
    )
    low = np.maximum(0, moves - distance).ravel()
    high = np.minimum(1, moves + distance).ravel()
    free = np.full(robots * targets + 1, np.inf)
    found = scipy.optimize.linprog(
        -np.append(np.zeros(robots * (count + targets)), 1.0),
        A_ub=np.concatenate(lines),
        b_ub=np.concatenate(sides),
        A_eq=equal,
        b_eq=np.tile(totals, robots),
        bounds=np.stack([np.append(low, -free), np.append(high, free)], axis=1),
        options={"primal_feasibility_tolerance": 1e-10},
    )
    if found.x is None:
        return moves, 0.0
    trial = np.maximum(0, found.x[: robots * count].reshape(robots, count))
    for robot in trial:
        robot /= np.bincount(polytope.tails, robot, polytope.vertices)[polytope.tails]
    return trial, max(0.0, float(found.x[-1]))
