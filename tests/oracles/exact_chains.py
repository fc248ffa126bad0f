"""Quantities of chains in exact rational numbers, from the probabilities as they are stored.

The probability of staying in a cell is 1 minus the probabilities of the other steps, so rounding of
the stored one has no effect.
"""

import itertools
import math
from fractions import Fraction

import numpy as np
from flint import fmpq, fmpq_mat


def rational(number):
    """Convert a float or a fraction to the rational number that it is."""
    exact = number if isinstance(number, Fraction) else Fraction(float(number))
    return fmpq(exact.numerator, exact.denominator)


def as_floats(numbers):
    """Round rational numbers to floats, also if parts of them are beyond the range of floats."""
    return np.array([float(Fraction(int(x.p), int(x.q))) for x in numbers])


def solve(matrix, right):
    """Solve a system of rational equations; return the rows of the solution."""
    size, columns = len(matrix), len(right[0])
    left = fmpq_mat(size, size, [x for row in matrix for x in row])
    solution = left.solve(fmpq_mat(size, columns, [x for row in right for x in row]))
    return [[solution[i, j] for j in range(columns)] for i in range(size)]


def ends(matrix, sets):
    """Compute the probability of ending in each of several sets of cells, and the expected time.

    Returns a row per cell: the probability of each set, and the number of steps until one of them.
    """
    cells = len(matrix)
    inside = [i for i in range(cells) if not any(i in members for members in sets)]
    system, right = [], []
    for i in inside:
        off = {j: rational(matrix[i, j]) for j in range(cells) if j != i and matrix[i, j]}
        onward = sum(off.values(), fmpq(0))
        system.append([onward if i == j else -off.get(j, fmpq(0)) for j in inside])
        into = [sum((off.get(j, fmpq(0)) for j in members), fmpq(0)) for members in sets]
        right.append([*into, fmpq(1)])
    table = [[fmpq(int(i in members)) for members in sets] + [fmpq(0)] for i in range(cells)]
    for i, row in zip(inside, solve(system, right) if inside else (), strict=True):
        table[i] = row
    return table


def times(matrix, target):
    """Compute the expected number of steps from each cell to a target cell."""
    return [row[-1] for row in ends(matrix, [{target}])]


def stationary(matrix):
    """Compute the stationary distribution."""
    last = len(matrix) - 1
    chance = [[rational(p) for p in row] for row in matrix]
    for i, row in enumerate(chance):
        row[i] = 1 - sum((p for j, p in enumerate(row) if j != i), fmpq(0))
    system = [
        [row[i] - int(i == j) if i < last else fmpq(1) for j, row in enumerate(chance)]
        for i in range(last + 1)
    ]
    return [row[0] for row in solve(system, [[fmpq(0)]] * last + [[fmpq(1)]])]


def kemeny(matrix):
    """Compute Kemeny's constant, the mean time from any cell to a cell of the long run."""
    share = stationary(matrix)
    return sum((p * times(matrix, j)[0] for j, p in enumerate(share)), fmpq(0))


def conditional_times(matrix, target, other):
    """Compute the expected number of steps to `target` over paths that do not end in `other`."""
    chance = [row[0] for row in ends(matrix, [target, other])]
    inside = [i for i in range(len(matrix)) if i not in target and i not in other]
    system, right = [], []
    for i in inside:
        off = {j: rational(matrix[i, j]) for j in range(len(matrix)) if j != i and matrix[i, j]}
        onward = sum(off.values(), fmpq(0))
        system.append([onward if i == j else -off.get(j, fmpq(0)) for j in inside])
        right.append([chance[i]])
    weighed = zip(inside, solve(system, right), strict=True)
    return {i: row[0] / chance[i] for i, row in weighed if chance[i] != 0}


def first_arrivals(matrix, robots, target):
    """Compute the expected time until one of several robots is at a cell, for each start.

    Returns a dictionary from the cells of the robots to the time. The target must be certain.
    """
    cells = range(len(matrix))
    chance = [[rational(p) for p in row] for row in matrix]
    for i in cells:
        chance[i][i] = 1 - sum((chance[i][j] for j in cells if j != i), fmpq(0))
    inside = list(itertools.product([i for i in cells if i != target], repeat=robots))
    system = [
        [
            int(here == there)
            - math.prod((chance[i][j] for i, j in zip(here, there, strict=True)), start=fmpq(1))
            for there in inside
        ]
        for here in inside
    ]
    times = solve(system, [[fmpq(1)]] * len(inside))
    return {here: row[0] for here, row in zip(inside, times, strict=True)}


def best_values(matrices, reward, discount):
    """Compute the values of the best policy, `V = discount * max_u (r_u + P_u V)`, by Howard."""
    actions, cells = reward.shape
    factor = rational(discount)
    chance = [[[rational(p) for p in row] for row in matrix] for matrix in matrices]
    gain = [[rational(r) for r in row] for row in reward]
    policy = [0] * cells
    while True:
        system = [
            [fmpq(int(i == j)) - factor * chance[policy[i]][i][j] for j in range(cells)]
            for i in range(cells)
        ]
        value = [
            row[0] for row in solve(system, [[factor * gain[policy[i]][i]] for i in range(cells)])
        ]
        better = list(policy)
        for i in range(cells):
            of_action = [
                factor
                * (gain[a][i] + sum((chance[a][i][j] * value[j] for j in range(cells)), fmpq(0)))
                for a in range(actions)
            ]
            if max(of_action) > of_action[policy[i]]:
                better[i] = of_action.index(max(of_action))
        if better == policy:
            return value
        policy = better


def distance(value, exact):
    """Return the absolute difference of a float and a rational number, as a float."""
    return abs(float(Fraction(float(value)) - Fraction(int(exact.p), int(exact.q))))


def relative(values, exact):
    """Return the largest relative error of floats."""
    pairs = zip(np.ravel(values), exact, strict=True)
    parts = (distance(x, y) / abs(float(Fraction(int(y.p), int(y.q)))) for x, y in pairs if y != 0)
    return max(parts, default=0.0)
