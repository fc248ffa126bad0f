"""Walks, and other ways to compute their times and capture, for tests to compare with."""

import itertools

import numpy as np
import scipy.optimize


def walk_on(graph, weights=None):
    """The transition matrix of a random walk, by default with equal weights."""
    matrix = np.zeros((graph.vertices, graph.vertices))
    weights = np.ones(len(graph.edges)) if weights is None else weights
    for (tail, head), weight in zip(graph.edges.tolist(), weights, strict=True):
        matrix[tail, head] = matrix[head, tail] = weight
    return matrix / matrix.sum(axis=1, keepdims=True)


def times_by_solves(matrix, step=1.0):
    """The mean time from each state to each other, one linear system per target."""
    times, step = np.zeros_like(matrix), np.broadcast_to(step, len(matrix))
    for target in range(len(matrix)):
        others = np.delete(np.arange(len(matrix)), target)
        system = np.eye(others.size) - matrix[np.ix_(others, others)]
        times[others, target] = np.linalg.solve(system, step[others])
    return times


def missed(matrix, view, steps, start):
    """The probability that a robot stays out of view in some steps, by powers of matrices."""
    stop = np.where(view, 0, matrix) * ~view[:, None]
    late = np.linalg.matrix_power(stop, steps).sum(axis=1)
    if start == "worst":
        return late.max()
    share = np.ones(len(matrix))
    if start == "stationary":
        lazy = (matrix + np.eye(len(matrix))) / 2
        share = np.linalg.matrix_power(lazy, 4096).mean(axis=0)
    # A robot that has the target in view wherever it is misses no attack.
    share = share * ~view
    return share @ late / max(share.sum(), 1e-300)


def delays_of(graph, times):
    """The duration of each move; a robot that stays takes 1."""
    delays = np.eye(graph.vertices, dtype=int)
    delays[graph.edges[:, 0], graph.edges[:, 1]] = times
    delays[graph.edges[:, 1], graph.edges[:, 0]] = times
    return delays


def by_walks(matrix, delays, attack):
    """The probabilities of capture, summed over all walks between states at vertices."""
    states, vertices = len(matrix), len(delays)
    captured = np.zeros((states, vertices))
    for start, target in itertools.product(range(states), range(vertices)):
        walks = [(start, 0, 1.0)]
        while walks:
            here, time, chance = walks.pop()
            for there in np.flatnonzero(matrix[here] > 0):
                later = time + delays[here % vertices, there % vertices]
                if later <= attack[target]:
                    if there % vertices == target:
                        captured[start, target] += chance * matrix[here, there]
                    else:
                        walks.append((there, later, chance * matrix[here, there]))
    return captured


def by_slsqp(among, loss, starts, seed):
    """The losses of chains to which another solver leads, from random starts."""
    sums, sides = among.equalities()
    rule = {"type": "eq", "fun": lambda p: sums @ p - sides, "jac": lambda p: sums}
    options = {"constraints": rule, "method": "SLSQP"}
    ends = []
    for start in among.starts(starts, 1, seed)[:, 0]:
        bounds = [(1e-6, 1)] * start.size
        found = scipy.optimize.minimize(
            lambda p: loss(among.matrix(p)), start, bounds=bounds, **options
        )
        if np.abs(sums @ found.x - sides).max() < 1e-9:
            ends.append(found.fun)
    return ends
