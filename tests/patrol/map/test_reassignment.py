import itertools

import numpy as np
import pytest

from jaxcell.patrol import Graph
from jaxcell.patrol.map.policies import centralized_policies, distributed_policies
from jaxcell.patrol.map.reassignment import reassign, silence_limit
from jaxcell.patrol.map.regions import angular_regions


SIDE = 7
XY = np.stack(np.divmod(np.arange(SIDE * SIDE), SIDE), axis=1)[:, ::-1].astype(float)
EDGES = np.argwhere(np.triu(np.abs(XY[:, None] - XY).max(axis=-1) == 1))
GRAPH = Graph(EDGES, xy=XY)
BASE = SIDE * SIDE // 2
VISIBLE = np.hypot(*(XY[:, None] - XY).transpose(2, 0, 1)) <= 2
REGIONS = angular_regions(GRAPH, BASE, VISIBLE[BASE], 4)
POLICIES = centralized_policies(GRAPH, VISIBLE, REGIONS)


def silence_by_powers(policy, alpha):
    """The steps without a visit, from the distribution of the robot for each start."""
    matrix = policy.chain.to_scipy().toarray()
    now = np.eye(len(matrix))[policy.cells]
    for steps in itertools.count(1):
        now = now @ matrix
        now[:, policy.contact] = 0
        if now.sum(axis=1).max() <= alpha:
            return steps


@pytest.mark.parametrize("alpha", [0.5, 0.01, 1e-80])
@pytest.mark.parametrize("robot", [0, 3])
def test_silence_limit(robot, alpha):
    limit = silence_limit(POLICIES[robot], alpha)
    assert limit == silence_by_powers(POLICIES[robot], alpha)
    # More than two chunks of steps.
    assert alpha > 0.001 or limit > 2 * 256


def test_the_return_to_the_contact_counts():
    # Between two cells a robot is always there in a step, and back in two.
    graph = Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [2, 0]])
    view = np.array([True, True, False])
    visible = np.ones((3, 3), bool)
    regions = angular_regions(graph, 0, view, 1)
    (policy,) = centralized_policies(graph, visible, regions)
    assert (policy.cells.tolist(), policy.contact) == ([1, 2], 1)
    assert silence_limit(policy) == 2


@pytest.mark.parametrize("lost", [0, 2])
def test_reassign(lost):
    reassigned = reassign(GRAPH, VISIBLE, REGIONS, POLICIES, lost, share=0.6, alpha=0.05)
    assert reassigned.silence_limit == silence_limit(POLICIES[lost], 0.05)
    expected = angular_regions(GRAPH, BASE, VISIBLE[BASE], 3)
    assert reassigned.regions.region.tolist() == expected.region.tolist()
    for policy, other in zip(
        reassigned.policies, centralized_policies(GRAPH, VISIBLE, expected, 0.6), strict=True
    ):
        np.testing.assert_array_equal(policy.weights, other.weights)

    def kept(robots):
        return sum(
            np.count_nonzero((reassigned.regions.region == k) & (REGIONS.region == robot))
            for k, robot in enumerate(robots)
        )

    left = set(range(4)) - {lost}
    assert set(reassigned.robot.tolist()) == left
    assert kept(reassigned.robot) == max(map(kept, itertools.permutations(left)))


def test_wrong_robots_and_policies_are_refused():
    with pytest.raises(ValueError, match="lost: robot 4 does not exist; robots are 0 to 3"):
        reassign(GRAPH, VISIBLE, REGIONS, POLICIES, 4)
    with pytest.raises(ValueError, match="policies: expected 4, one per region, got 3"):
        reassign(GRAPH, VISIBLE, REGIONS, POLICIES[:3], 0)
    alone = angular_regions(GRAPH, BASE, VISIBLE[BASE], 1)
    with pytest.raises(ValueError, match="lost: robot 0 is the only robot"):
        reassign(GRAPH, VISIBLE, alone, POLICIES[:1], 0)
    for alpha in (0.0, 1.0):
        with pytest.raises(ValueError, match="alpha: expected a probability"):
            silence_limit(POLICIES[0], alpha)
    (policy,) = distributed_policies(GRAPH, VISIBLE, 1)
    with pytest.raises(ValueError, match="policy: expected a policy with a contact cell"):
        silence_limit(policy)
