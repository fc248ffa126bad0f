import networkx
import numpy as np
import pytest
from graphs import network_of

from jaxcell.optimize import minimum_commute
from jaxcell.optimize.cover import greedy_cover
from jaxcell.optimize.tour import on_walk
from jaxcell.patrol import Graph, random_walk
from jaxcell.patrol.map.graph import cell_graph
from jaxcell.patrol.map.policies import centralized_policies, distributed_policies
from jaxcell.patrol.map.regions import angular_regions
from jaxcell.space import CellSpace, Workspace, visible_cells


MAP = Workspace(
    [(0, 0), (8, 0), (8, 6), (0, 6)],
    [[(2, 2), (3, 2), (3, 4), (2, 4)], [(6, 0), (7, 0), (7, 2), (6, 2)]],
)
CELLS = CellSpace.of(MAP, 1.0, 1)
ROOM = cell_graph(CELLS)
VISIBLE = visible_cells(CELLS, 2.8)
BASE = int(CELLS.index(4.5, 3.5))
REGIONS = angular_regions(ROOM, BASE, VISIBLE[BASE], 2)


def test_distributed_policies():
    policies = distributed_policies(ROOM, VISIBLE, 2, share=0.7)
    assert len(policies) == 2
    for i, policy in enumerate(policies):
        assert policy.cover.tolist() == greedy_cover(VISIBLE, i).chosen.tolist()
        assert VISIBLE[policy.cover].any(axis=0).all()
        assert policy.uncovered.size == 0
        assert set(policy.cover.tolist()) <= set(policy.tour.tolist())
        assert policy.weights[on_walk(ROOM, policy.tour)].sum() >= 0.7 - 1e-9
        expected = minimum_commute(ROOM, policy.cover.tolist(), 0.7)
        np.testing.assert_array_equal(policy.weights, expected.weights)
        assert policy.commute_time == expected.commute_time
        assert policy.certificate.residual <= policy.certificate.tolerance
        walk = random_walk(ROOM, policy.weights)
        np.testing.assert_array_equal(policy.chain.to_scipy().toarray(), walk.to_scipy().toarray())
        assert policy.cells.tolist() == list(range(CELLS.positions))
        assert policy.contact is None
    assert len({tuple(policy.cover.tolist()) for policy in policies}) == 2


def test_one_cell_that_sees_all_is_not_emphasised():
    graph = Graph([[0, 1], [1, 2], [2, 3]])
    visible = np.eye(4, dtype=bool)
    visible[2] = True
    (policy,) = distributed_policies(graph, visible, 1)
    assert policy.cover.tolist() == [2]
    assert policy.tour is None
    np.testing.assert_array_equal(policy.weights, minimum_commute(graph).weights)


def test_cells_that_no_cell_sees_are_uncovered():
    visible = VISIBLE.copy()
    visible[:, [3, 17]] = False
    (policy,) = distributed_policies(ROOM, visible, 1)
    assert policy.uncovered.tolist() == [3, 17]
    assert np.flatnonzero(~visible[policy.cover].any(axis=0)).tolist() == [3, 17]


def test_centralized_policies():
    visible = visible_cells(CELLS, 2.2)
    policies = centralized_policies(ROOM, visible, REGIONS, share=0.6)
    assert len(policies) == 2
    net = network_of(ROOM)
    for k, policy in enumerate(policies):
        own = set(np.flatnonzero(REGIONS.region == k).tolist())
        assert policy.cells.tolist() == sorted(own)
        assert set(policy.cover.tolist()) <= own
        assert visible[policy.cover].any(axis=0)[policy.cells].all()
        part = net.subgraph(own)
        ways = dict(networkx.all_pairs_dijkstra_path_length(part, weight="length"))
        ways = {
            z: sum(ways[z][stop] for stop in policy.cover.tolist()) for z in own if REGIONS.view[z]
        }
        assert ways[policy.contact] == pytest.approx(min(ways.values()))
        assert {*policy.cover.tolist(), policy.contact} <= set(policy.tour.tolist()) <= own
        assert policy.weights[on_walk(ROOM, policy.tour)].sum() >= 0.6 - 1e-9
        inside = np.isin(ROOM.edges, policy.cells).all(axis=1)
        assert (policy.weights[inside] > 0).all()
        assert (policy.weights[~inside] == 0).all()
        matrix = policy.chain.to_scipy().toarray()
        weights = np.zeros_like(matrix)
        for (a, b), weight in zip(ROOM.edges, policy.weights, strict=True):
            weights[a, b] = weights[b, a] = weight
        stays = ~np.isin(np.arange(CELLS.positions), policy.cells)
        weights[stays, stays] = 1
        np.testing.assert_allclose(matrix, weights / weights.sum(axis=1, keepdims=True), atol=1e-15)


@pytest.mark.parametrize("robots", [0, CELLS.positions + 1])
def test_a_wrong_number_of_robots_is_refused(robots):
    message = f"robots: expected 1 to {CELLS.positions}, the number of cells, got {robots}"
    with pytest.raises(ValueError, match=message):
        distributed_policies(ROOM, VISIBLE, robots)


def test_sights_and_regions_of_another_graph_are_refused():
    graph = Graph([[0, 1], [1, 2]])
    message = r"visible: expected an array \[3, 3\]"
    with pytest.raises(ValueError, match=message):
        distributed_policies(graph, VISIBLE, 1)
    with pytest.raises(ValueError, match=message):
        centralized_policies(graph, VISIBLE, REGIONS)
    with pytest.raises(ValueError, match="regions: expected regions of the 3 cells of the graph"):
        centralized_policies(graph, np.ones((3, 3), bool), REGIONS)
