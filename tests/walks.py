"""Sums over all walks, which the tests of capture compare with."""

import itertools

import numpy as np


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
