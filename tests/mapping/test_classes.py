import math

import networkx as nx
import numpy as np
from hypothesis import given
from random_chains import matrices

from jaxcell.mapping.classes import persistent_groups
from jaxcell.mapping.generalized import Chain


@given(matrices())
def test_persistent_groups_are_components_without_exit(matrix):
    groups = persistent_groups(Chain.from_scipy(matrix))
    graph = nx.from_numpy_array(matrix, create_using=nx.DiGraph)
    leaks = matrix.sum(axis=1) < 1 - 1e-9
    closed = [
        component
        for component in nx.strongly_connected_components(graph)
        if not leaks[list(component)].any()
        and all(image in component for cell in component for image in graph.successors(cell))
    ]
    closed.sort(key=min)
    expected = np.full(len(matrix), -1)
    for number, component in enumerate(closed):
        expected[list(component)] = number
    np.testing.assert_array_equal(groups.group, expected)
    assert groups.count == len(closed)
    assert groups.size.tolist() == [len(component) for component in closed]


@given(matrices())
def test_period_is_the_gcd_of_return_times(matrix):
    groups = persistent_groups(Chain.from_scipy(matrix))
    group = np.asarray(groups.group)
    for number in range(groups.count):
        cells = np.flatnonzero(group == number)
        step, power, returns = matrix > 0, np.eye(len(matrix), dtype=bool), 0
        # A group of n cells has circuits of at most n steps, and their sums show by 2 n^2.
        for length in range(1, 2 * len(cells) ** 2 + 1):
            power = (power.astype(int) @ step.astype(int)) > 0
            if power[cells[0], cells[0]]:
                returns = math.gcd(returns, length)
        assert int(groups.period[number]) == returns
