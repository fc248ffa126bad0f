"""Rounds against cases of other people, own searches over all schedules, and own evaluations."""

import itertools
import math

import networkx as nx
import numpy as np
import pytest
from patrolled_rounds import least_longest, waits

from jaxcell.patrol import Graph
from jaxcell.patrol.rounds import Game, Guarded, Route, best_rounds, bound, evaluate


# A floor of 14 rooms: the length of the way between two of them, in metres.
DOORS = [
    ("lobby", "hall_w", 12.6), ("lobby", "reception", 9.5),
    ("hall_w", "hall_m", 14.7), ("hall_w", "office1", 9.5),
    ("hall_w", "store", 9.5), ("hall_m", "hall_e", 14.7),
    ("hall_m", "office2", 11.4), ("hall_m", "vault", 10.5),
    ("hall_m", "kitchen", 9.5), ("hall_e", "lab", 10.5),
    ("hall_e", "server", 8.4), ("hall_e", "archive", 9.5),
    ("office1", "office2", 8.4), ("server", "dock", 9.7),
    ("store", "kitchen", 14.7), ("archive", "dock", 10.5),
]  # fmt: skip


def floor():
    plan = nx.Graph()
    plan.add_weighted_edges_from(DOORS, weight="length")
    return plan


def cycle(vertices):
    return Graph([(v, (v + 1) % vertices) for v in range(vertices)])


@pytest.mark.parametrize(
    ("graph", "robots", "attack"),
    [(cycle(6), 2, 3.0), (cycle(8), 2, 4.0), (cycle(9), 3, 3.0), ("@line", 4, 8.0)],
)
def test_no_attack_succeeds_where_a_team_can_prevent_it(graph, robots, attack):
    game = Game.of(graph, attack, robots=robots)
    found = best_rounds(game)
    moments = np.arange(0, 2 * max(route.period for route in found.routes)) + 1e-6
    for target in game.targets:
        assert waits(found.routes, target, moments).max() <= attack
    assert Guarded.of(game, found.routes).watched_capture == 1


def test_two_guards_of_14_rooms_need_90_seconds():
    game = Game.of(floor(), 90.0, robots=2, speed=1.2)
    found = best_rounds(game)
    own = [waits(found.routes, target, np.arange(0.0, 180.5, 0.05)) for target in game.targets]
    assert max(wait.max() for wait in own) == pytest.approx(90.29, abs=0.06)
    np.testing.assert_allclose(
        found.evaluation.exposure, [(wait > 90).mean() for wait in own], atol=1e-3
    )
    answer = Guarded.of(game, found.routes).answer
    assert answer[0].startswith("No intruder who needs 90.3 s escapes")
    assert "can succeed for 0.292 s of every 90.3 s" in answer[1]
    longer = Game.of(floor(), 95.0, robots=2, speed=1.2)
    assert Guarded.of(longer, found.routes).watched_capture == 1


def test_one_guard_of_three_rooms_lets_nobody_escape():
    rooms = ["vault", "archive", "server"]
    game = Game.of(floor(), 90.0, targets=rooms, speed=1.2)
    found = best_rounds(game)
    assert found.evaluation.longest.max() == pytest.approx(86.2 / 1.2)
    assert bound(game).between == pytest.approx(86.2 / 1.2)
    answer = Guarded.of(game, found.routes, bound=bound(game)).answer
    assert answer[0].startswith("No intruder who needs 90 s escapes, whatever they see")
    assert answer[1] == "No patrol by one guard has a shorter longest time between visits."


@pytest.mark.parametrize(("vertices", "robots"), [(4, 2), (5, 2), (6, 1), (6, 2)])
@pytest.mark.parametrize("seed", range(3))
def test_longest_time_is_that_of_the_best_of_all_schedules(vertices, robots, seed):
    graph = nx.random_labeled_tree(vertices, seed=seed)
    random = np.random.default_rng(seed)
    pairs = itertools.combinations(range(vertices), 2)
    graph.add_edges_from(pair for pair in pairs if random.random() < 0.2)
    game = Game.of(Graph(list(graph.edges), vertices), 100.0, robots=robots)
    least = least_longest(graph, robots)
    assert best_rounds(game).evaluation.longest.max() == least
    assert bound(game).between <= least


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_robots_follow_one_way_streets(robots):
    random = np.random.default_rng(robots)
    streets = nx.DiGraph()
    nx.add_cycle(streets, range(20))
    for a, b in random.integers(20, size=(25, 2)).tolist():
        streets.add_edge(a, b)
    for a, b in streets.edges:
        streets.edges[a, b]["length"] = float(random.uniform(50, 100))
    game = Game.of(streets, 60.0, robots=robots, speed=8.0)
    found = best_rounds(game)
    for route in found.routes:
        there = zip(route.vertex, np.roll(route.vertex, -1), strict=True)
        lasts = [streets.edges[int(game.names[a]), int(game.names[b])] for a, b in there]
        took = np.diff(np.append(route.arrive, route.arrive[0] + route.period))
        np.testing.assert_allclose(took, [one["length"] / 8 for one in lasts])
    moments = random.uniform(0, 40 * max(route.period for route in found.routes), 400)
    missed = [(waits(found.routes, t, moments) > 60).mean() for t in game.targets]
    np.testing.assert_allclose(found.evaluation.exposure, missed, atol=0.12)
    limit = bound(game)
    assert limit.between <= found.evaluation.longest.max()
    assert limit.capture >= 1 - found.evaluation.exposure.max()


def test_target_with_short_attacks_is_visited_more_often():
    star = Graph([[0, 1], [0, 2], [0, 3], [1, 4]])
    game = Game.of(star, [8.0, 4.0, 12.0, 12.0], targets=["0", "4", "2", "3"])
    found = best_rounds(game)
    walk = found.routes[0].vertex.tolist()
    assert walk.count(4) > walk.count(2) == 1
    once = evaluate(game, best_rounds(Game.of(star, 8.0, targets=["0", "4", "2", "3"])).routes)
    assert found.evaluation.exposure.max() < once.exposure.max()


def test_robots_with_unrelated_periods_meet_in_all_phases():
    game = Game.of(cycle(4), 3.0, robots=2)
    at = np.arange(4.0)
    routes = [Route(np.arange(4), at * k, at * k, 4.0 * k) for k in (1.0, math.sqrt(2))]
    found = evaluate(game, routes)
    moments = np.random.default_rng(0).uniform(0, 4000, 2000)
    missed = (waits(routes, 2, moments) > 3).mean()
    assert found.exposure[2] == pytest.approx(missed, abs=4 * math.sqrt(missed / 2000))
    assert found.longest[2] == 4.0
    # Periods with a ratio of 2 keep their phases.
    related = [Route(np.arange(4), at * k, at * k, 4.0 * k) for k in (1.0, 2.0)]
    assert evaluate(game, related).exposure[0] == pytest.approx(0.25)


def test_guards_stay_where_there_are_enough_of_them():
    game = Game.of(floor(), 9.0, robots=5, targets=["vault", "archive", "server"], speed=1.2)
    found = best_rounds(game)
    answer = Guarded.of(game, found.routes, bound=bound(game)).answer
    assert answer[0] == "No intruder escapes, whatever they see: a guard stays at each target."
    assert "Guard 1 stays at vault." in answer


def test_waiting_robot_guards_its_vertex():
    game = Game.of(Graph([[0, 1], [1, 2]]), 2.0)
    waiting = Route(np.array([0, 1]), np.array([0.0, 6.0]), np.array([5.0, 6.0]), 7.0)
    found = evaluate(game, [waiting])
    assert found.longest.tolist() == [2.0, 7.0, math.inf]
    np.testing.assert_allclose(found.exposure, [0, 5 / 7, 1])
    assert Guarded.of(game, [waiting]).answer[0] == "No guard ever visits `2`."


@pytest.mark.parametrize("seed", range(4))
def test_bound_on_capture_holds_for_walks_in_which_robots_may_do_anything(seed):
    """The bound is at least the mean capture of random walks of shortest ways."""
    random = np.random.default_rng(seed)
    graph = nx.random_labeled_tree(7, seed=seed)
    game = Game.of(Graph(list(graph.edges)), 3.0, robots=2)
    limit = bound(game)
    larger = nx.disjoint_union(nx.disjoint_union(graph, graph), nx.path_graph(2))
    larger.add_edges_from([(0, 7), (0, 14)])
    tree = bound(Game.of(Graph(list(larger.edges)), 3.0))
    assert not tree.exact
    assert 0 < limit.capture <= 1
    assert 0 < tree.capture <= 1
    shown = np.zeros(7)
    for _ in range(300):
        places = random.integers(7, size=2)
        seen = set(places.tolist())
        for _ in range(3):
            places = [random.choice([v, *graph[v]]) for v in places]
            seen |= {int(v) for v in places}
        shown[list(seen)] += 1 / 300
    assert shown.min() <= limit.capture
    assert 1 - best_rounds(game).evaluation.exposure.max() <= limit.capture + 1e-9


def test_watcher_is_answered_first_for_a_watcher():
    game = Game.of(floor(), 90.0, robots=2, speed=1.2, adversary="watcher")
    guarded = Guarded.of(game, best_rounds(game).routes)
    assert guarded.risk == 1
    assert guarded.answer[0].startswith("An adversary who sees the guards")


def test_robots_are_needed_for_each_part_of_the_streets():
    streets = nx.DiGraph([("a", "b"), ("b", "a"), ("b", "c")])
    with pytest.raises(ValueError, match=r"robots: expected at least 2, .* 'a' to 'c' and back"):
        Game.of(streets, 3.0, targets=["a", "c"])


def test_dead_ends_of_one_way_streets_are_no_targets():
    streets = nx.DiGraph([("a", "b"), ("b", "a"), ("b", "c")])
    game = Game.of(streets, 3.0)
    assert game.names_of_targets == ["a", "b"]
    assert game.omitted == (
        "1 of 3 vertices are no targets, because no way leads there and back: c; to choose, set "
        "`targets`",
    )
    assert Game.of(streets, 3.0, robots=2).names_of_targets == ["a", "b", "c"]
