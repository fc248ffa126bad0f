import math

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_chains import matrices, reachable

from jaxcell.mapping import classes, periodic_groups
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
    np.testing.assert_array_equal(groups.persistent, expected >= 0)


@given(matrices())
def test_domicile_has_the_cells_that_can_reach_a_group(matrix):
    groups = persistent_groups(Chain.from_scipy(matrix))
    reach = reachable(matrix)
    assert groups.domicile.shape == (groups.count, len(matrix))
    for group in range(groups.count):
        expected = reach[:, np.asarray(groups.group) == group].any(axis=1)
        np.testing.assert_array_equal(groups.domicile[group], expected)
        np.testing.assert_array_equal(groups.reaching(group), expected)


@given(matrices())
def test_period_is_the_gcd_of_return_times(matrix):
    groups = persistent_groups(Chain.from_scipy(matrix))
    group, phase = np.asarray(groups.group), np.asarray(groups.phase)
    for number in range(groups.count):
        cells = np.flatnonzero(group == number)
        step, power, returns = matrix > 0, np.eye(len(matrix), dtype=bool), 0
        # A group of n cells has circuits of at most n steps, and their sums show by 2 n^2.
        for length in range(1, 2 * len(cells) ** 2 + 1):
            power = (power.astype(int) @ step.astype(int)) > 0
            if power[cells[0], cells[0]]:
                returns = math.gcd(returns, length)
        period = int(groups.period[number])
        assert period == returns
        assert phase[cells[0]] == 0
        for cell in cells:
            after = {(phase[cell] + 1) % period}
            assert {phase[image] for image in np.flatnonzero(step[cell])} == after
    np.testing.assert_array_equal(phase == -1, group == -1)


@given(st.lists(st.integers(0, 7), min_size=8, max_size=8))
def test_a_simple_map_has_its_periodic_groups(image):
    image = np.array([image], np.int32)
    groups = persistent_groups(Chain(image, np.ones((1, 8))))
    simple = periodic_groups(image[0])
    periodic = np.asarray(simple.periodic)
    np.testing.assert_array_equal(groups.group, np.where(periodic, simple.group, -1))
    np.testing.assert_array_equal(
        np.asarray(groups.period)[np.asarray(simple.group)], simple.period
    )
    # A cell has one image, so it can reach one group.
    np.testing.assert_array_equal(np.argmax(groups.domicile, axis=0), simple.group)
    assert (np.asarray(groups.domicile).sum(axis=0) == 1).all()


def test_leaking_class_is_not_persistent():
    circle = np.array([[0, 1.0], [1, 0]])
    assert persistent_groups(Chain.from_scipy(circle)).count == 1
    circle[1, 0] = 0.999
    leaky = persistent_groups(Chain.from_scipy(circle))
    assert leaky.count == 0
    assert leaky.group.tolist() == [-1, -1]
    assert leaky.domicile.shape == (0, 2)
    assert leaky.period.tolist() == []
    assert leaky.phase.tolist() == [-1, -1]


def test_too_large_table_of_domiciles_is_refused(monkeypatch):
    groups = persistent_groups(Chain(np.arange(3)[None], np.ones((1, 3))))
    monkeypatch.setattr(classes, "LARGEST_TABLE", 8)
    with pytest.raises(ValueError, match=r"3 groups x 3 cells .* reaching\(group\)"):
        _ = groups.domicile
    assert groups.reaching(1).tolist() == [False, True, False]
    with pytest.raises(ValueError, match="group 3 does not exist; there are 3"):
        groups.reaching(3)
