import jax
import networkx
import numpy as np
import pytest
from graphs import on_map
from walks import missed

from jaxcell.optimize import Graph
from jaxcell.patrol.map.attack import Attack, boundary, contested, outside
from jaxcell.patrol.map.attacked_cell import vulnerability
from jaxcell.patrol.map.capture import Capture, capture_probabilities
from jaxcell.patrol.map.policies import centralized_policies, distributed_policies
from jaxcell.patrol.map.regions import angular_regions, base_station


TIMES = [1, 2, 5, 11, 30]


@pytest.fixture(scope="module")
def depot():
    graph, visible = on_map("depot", 6.0)
    return graph, visible, distributed_policies(graph, visible, 2)


def corridor(places=9):
    """Places on a line, each of which sees its neighbours."""
    graph = Graph([(i, i + 1) for i in range(places - 1)], xy=[(i, 0) for i in range(places)])
    visible = np.abs(np.subtract.outer(np.arange(places), np.arange(places))) <= 1
    return graph, visible


def small():
    """Seven places on a line, and two robots."""
    return *corridor(7), distributed_policies(*corridor(7), 2)


def test_the_first_of_equal_cells_up_to_rounding_is_the_weakest():
    caught = np.array([[0.1, 0.3, 0.5, 0.3 - 1e-12], [0.1, 0.3, 0.2, 0.4]])
    seen = caught[::-1]
    capture = Capture(Attack([1, 2]), caught, caught, seen, np.array([1, 2, 3]))
    assert capture.weakest.tolist() == [1, 2]
    assert capture.weakest_watched.tolist() == [2, 1]


def test_one_cell_three_ways():
    graph, visible, policies = small()
    everywhere = capture_probabilities(graph, visible, policies, Attack(TIMES))
    target = int(everywhere[0].argmin())
    runs = 5000
    result = vulnerability(
        jax.random.key(1), graph, visible, policies, target, Attack(TIMES), runs=runs
    )
    np.testing.assert_allclose(result.exact, everywhere[:, target], atol=1e-12)
    error = np.sqrt(result.exact * (1 - result.exact) / runs)
    assert (np.abs(result.simulated - result.exact) <= 4 * error + 1e-12).all()
    # The fit is as far from the runs as it says, which are as far from the truth as they may be.
    assert (np.abs(result.fitted - result.simulated) <= result.fit.distance + 1e-9).all()
    assert result.fit.censored
    assert result.failure is None
    assert result.law[0] == 0


def test_the_boundary_is_where_a_robot_from_outside_arrives(depot):
    graph, visible, policies = depot
    edges = boundary(graph, visible)
    net = networkx.Graph(graph.edges.tolist())
    for target in (0, 31, 100):
        view = visible[target]
        expected = [bool(view[z]) and any(not view[n] for n in net[z]) for z in range(view.size)]
        np.testing.assert_array_equal(edges[target], expected)
        np.testing.assert_array_equal(boundary(graph, view), expected)
    starts = outside(policies, visible)
    assert starts.shape == (2, *visible.shape)
    assert not (starts & visible).any()


def test_robots_of_regions_begin_in_theirs():
    graph, visible = on_map("harbour", 6.0)
    base = base_station(graph, visible)
    regions = angular_regions(graph, base, visible[base], 3)
    policies = centralized_policies(graph, visible, regions)
    target = int(regions.cells(1)[0])
    starts = outside(policies, visible[target])
    for k, start in enumerate(starts):
        np.testing.assert_array_equal(start, (regions.region == k) & ~visible[target])
    # A robot whose region has no cell in view never comes; the others are as without it.
    alone = [
        capture_probabilities(graph, visible, [policy], Attack(50))[0, target]
        for policy in policies
    ]
    together = capture_probabilities(graph, visible, policies, Attack(50))[0, target]
    assert together == pytest.approx(1 - np.prod(1 - np.array(alone)))


def test_a_robot_that_sees_the_target_from_everywhere_has_come_already():
    graph, _, policies = small()
    everything = np.ones((7, 7), bool)
    assert (capture_probabilities(graph, everything, policies, Attack(1)) == 1).all()
    result = vulnerability(
        jax.random.key(0), graph, everything, policies, 3, Attack([1, 4]), runs=100
    )
    assert result.law[0] == 1
    assert (result.exact == 1).all()
    assert (result.simulated == 1).all()
    assert result.fit is None
    assert "different" in result.failure
    assert np.isnan(result.fitted).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0,), "times: expected at least 1 step, got 0"),
        (([],), "times: expected whole numbers of steps"),
        ((2.5,), "times: expected whole numbers of steps, got 2.5"),
        ((3, "best"), "start: expected one of stationary, uniform, worst, got 'best'"),
    ],
)
def test_wrong_attacks_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Attack(*arguments)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target": 7}, "target: expected a vertex, 0 to 6, got 7"),
        ({"policies": []}, "got none"),
        ({"visible": np.ones((3, 3), bool)}, "visible: expected"),
        ({"graph": Graph([(0, 1)]), "visible": np.ones((2, 2), bool)}, "robot 0 is for 7 cells"),
    ],
)
def test_policies_targets_and_sights_of_another_graph_are_refused(change, message):
    graph, visible, policies = small()
    given = {"graph": graph, "visible": visible, "policies": policies, "attack": Attack(3)}
    with pytest.raises(ValueError, match=message):
        vulnerability(jax.random.key(0), **{**given, "target": 3, **change})
    if "target" not in change:
        with pytest.raises(ValueError, match=message):
            capture_probabilities(**{**given, **change})


def test_capture_of_more_targets_than_are_computed_at_once():
    graph, visible = corridor(600)
    (policy,) = distributed_policies(graph, visible, 1, 0.0)
    caught = capture_probabilities(graph, visible, [policy], Attack(20, "uniform"))[0]
    matrix = policy.chain.to_scipy().toarray()
    for target in (0, 300, 511, 512, 599):
        late = missed(matrix, visible[target], 20, "uniform")
        assert caught[target] == pytest.approx(1 - late, abs=1e-9)


@pytest.mark.parametrize("start", ["stationary", "uniform", "worst"])
def test_capture_of_every_cell_by_powers_of_matrices(start):
    graph, visible, policies = small()
    sooner, later = capture_probabilities(graph, visible, policies, Attack([3, 9], start))
    assert (later > sooner).all()
    matrices = [policy.chain.to_scipy().toarray() for policy in policies]
    for target, caught in enumerate(sooner):
        late = [missed(matrix, visible[target], 3, start) for matrix in matrices]
        assert caught == pytest.approx(1 - np.prod(late), abs=1e-9)
    weakest = int(sooner.argmin())
    attack = vulnerability(
        jax.random.key(0), graph, visible, policies, weakest, Attack(3, start), runs=4000
    )
    assert attack.exact[0] == pytest.approx(sooner[weakest], abs=1e-9)
    assert abs(attack.simulated[0] - sooner[weakest]) < 0.04


def test_cells_that_are_always_or_never_seen_are_not_contested():
    graph, visible = corridor()
    policies = distributed_policies(graph, visible, 1)
    assert contested(visible, policies).tolist() == list(range(9))
    regions = angular_regions(graph, 4, visible[4], 2)
    in_regions = centralized_policies(graph, visible, regions)
    assert contested(visible, in_regions, regions).tolist() == [0, 1, 2, 6, 7, 8]
    visible[:, 0] = False
    assert contested(visible, policies).tolist() == list(range(1, 9))


def test_a_robot_that_sees_the_target_captures_whether_or_not_it_is_seen_from_there():
    """Walking robots that look to one side only, and attacks at late times, by simulation."""
    graph, _ = corridor()
    ahead = np.subtract.outer(np.arange(9), np.arange(9))
    visible = (ahead <= 0) & (ahead >= -2)
    policies = distributed_policies(graph, visible, 2, 0.0)
    capture = Capture.of(graph, visible, policies, Attack(5))
    random, runs, target = np.random.default_rng(0), 20_000, 6
    matrix = policies[0].chain.to_scipy().toarray()
    here = random.integers(9, size=(runs, 2))
    for after, expected in ((0, capture.at_first), (400, capture.probability)):
        places = here.copy()
        for step in range(after + 6):
            seen = visible[places, target].any(axis=1)
            if step == after:
                hidden, caught = ~seen, np.zeros(runs, bool)
            elif step > after:
                caught |= seen
            up = random.random(places.shape)[..., None] > np.cumsum(matrix[places], axis=-1)
            places = np.minimum(up.sum(axis=-1), 8)
        assert hidden.sum() > 5000
        assert caught[hidden].mean() == pytest.approx(expected[0, target], abs=0.02)
    other = Capture.of(graph, visible.T, policies, Attack(5))
    assert abs(other.probability[0, target] - capture.probability[0, target]) > 0.1
