import numpy as np
import pytest
from graphs import SMALL, TABLE_4_2

from jaxcell.optimize.commute import minimum_commute
from jaxcell.patrol import Graph, random_walk
from jaxcell.patrol.walks import measure


def test_the_chain_has_the_probabilities_of_its_definition():
    graph = Graph([[0, 1], [2, 1], [0, 2], [2, 3]])
    expected = np.array(
        [[0, 1 / 4, 3 / 4, 0], [1 / 3, 0, 2 / 3, 0], [3 / 9, 2 / 9, 0, 4 / 9], [0, 0, 1, 0]]
    )
    chain = random_walk(graph, [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(chain.to_scipy().toarray(), expected, atol=1e-15)


def test_the_small_graph():
    walk = minimum_commute(SMALL, tolerance=1e-11)
    # Of the optimum as a semidefinite program, and of another interior-point method.
    expected = (
        ".115657 .052148 .069178 .103238 .052148 .068108 .080961 .068046 .093542 .069178 .107600 "
        ".093542 .026655"
    )
    np.testing.assert_allclose(walk.weights, np.array(expected.split(), float), atol=1e-6)
    assert walk.commute_time == pytest.approx(18.626151, abs=1e-6)
    np.testing.assert_allclose(walk.weights[[1, 2, 8]], walk.weights[[4, 9, 11]], atol=1e-8)


def test_order_of_the_vertices_of_the_small_graph():
    # Alam 2018, Table 4.2, P_MAECT: the mean time from all vertices.
    times = measure(random_walk(SMALL, minimum_commute(SMALL).weights)).hitting_time
    # Vertices 3 and 8 are as far, by symmetry.
    order = np.argsort(times.mean(axis=0).round(6), stable=True)
    assert order.tolist() == TABLE_4_2[8].tolist()


@pytest.mark.parametrize("share", [0.6, 0.7, 0.8, 0.9, 0.95])
def test_order_with_an_emphasis(share):
    # Alam 2018, Table 4.2, P_Clique: the mean time from a vertex to those emphasised.
    emphasis = [1, 4, 7]
    weights = minimum_commute(SMALL, emphasis, share).weights
    times = measure(random_walk(SMALL, weights)).hitting_time
    order = np.argsort(times[:, emphasis].mean(axis=1))
    assert order.tolist() == TABLE_4_2[9].tolist()


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ([1.0, -1.0, 1.0], r"weights\[1\] is -1.0; expected a finite number, at least 0"),
        ([1.0, 1.0, 0.0], "weights: vertex 3 has only weights of 0"),
    ],
)
def test_wrong_weights_are_refused(weights, message):
    with pytest.raises(ValueError, match=message):
        random_walk(Graph([[0, 1], [1, 2], [2, 3]]), weights)
