"""Joint schedules of robots against own searches and own linear programs over all schedules."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest
import scipy.optimize
from patrolled_rounds import draw_game_on_a_tree, least_risk, waits

from jaxcell.patrol import Graph, maximin_capture
from jaxcell.patrol.rounds import Game, Guarded, best_rounds, best_routes, bound, evaluate


def can_be_safe(streets, robots, attack):
    """Check by removing states without future whether robots can be in time at all targets.

    Times are halves of a unit, so that robots may be between the units of the library, and robots
    may wait anywhere.
    """
    near = {v: [v] for v in streets}
    for a, b, time in streets.edges(data="length"):
        place = a
        for _ in range(int(2 * time) - 1):
            near[place].append(new := len(near))
            near[new], place = [], new
        near[place].append(b)
    number, full = {v: i for i, v in enumerate(attack)}, tuple(2 * a for a in attack.values())
    starts = itertools.combinations_with_replacement(streets, robots)
    after, stack = {}, [(start, full) for start in starts]
    while stack:
        if (state := stack.pop()) in after:
            continue
        after[state] = set()
        for places in itertools.product(*(near[v] for v in state[0])):
            left = tuple(full[i] if v in places else state[1][i] - 1 for v, i in number.items())
            if min(left) > 0:
                after[state].add((tuple(sorted(places)), left))
        stack += after[state]
    alive = set(after)
    while lost := {state for state in alive if not after[state] & alive}:
        alive -= lost
    return bool(alive)


def streets_of(random):
    streets = nx.gnp_random_graph(int(random.integers(3, 5)), 0.6, seed=random, directed=True)
    for a, b in streets.edges:
        streets.edges[a, b]["length"] = float(random.integers(1, 3))
    return streets


@pytest.mark.parametrize("seed", range(15))
@pytest.mark.parametrize("speed", [1.0, 1.2])
def test_all_attacks_are_stopped_where_any_schedule_can(seed, speed):
    random = np.random.default_rng(seed)
    while not nx.is_strongly_connected(streets := streets_of(random)):
        pass
    robots = int(random.integers(1, 3))
    targets = sorted(random.permutation(len(streets))[: int(random.integers(robots + 1, 5))])
    attack = {v: int(random.integers(1, 7)) for v in targets}
    times = np.array(list(attack.values())) / speed
    game = Game.of(streets, times, robots=robots, targets=[f"{v}" for v in targets], speed=speed)
    safe = can_be_safe(streets, robots, attack)
    assert bound(game).preventable == safe
    found = evaluate(game, routes := best_routes(game))
    assert (found.longest <= game.attack * (1 + 1e-9)).all() == safe
    for moments, target, longest in itertools.product(
        [np.arange(0, 40, 0.37)] * safe, range(len(targets)), [game.attack]
    ):
        assert waits(routes, targets[target], moments, 40).max() <= longest[target] + 1e-6


def test_guards_share_a_target_in_turn():
    path = Graph([[0, 1], [1, 2]])
    game = Game.of(path, [3.0, 1.0, 2.0], robots=2)
    assert best_rounds(game).evaluation.exposure.max() > 0
    routes = best_routes(game)
    assert Guarded.of(game, routes, bound=bound(game)).watched_capture == 1
    assert all((route.vertex == 1).any() for route in routes)


@pytest.mark.parametrize("seed", range(12))
def test_least_risk_is_that_of_an_own_linear_program(seed):
    random = np.random.default_rng(seed)
    edges, attack, value, robots = draw_game_on_a_tree(random, seed)
    ways = [float(time) for *_, time in edges]
    graph = Graph([edge[:2] for edge in edges], len(attack), ways=ways)
    game = Game.of(graph, attack, value=value, robots=robots, speed=1.0)
    least = least_risk(edges, attack, value, robots)
    limit = bound(game)
    assert (1 - limit.capture) * max(value) == pytest.approx(least, abs=1e-7)
    routes = best_routes(game)
    found = evaluate(game, routes)
    assert least - 1e-9 <= found.risk(game).max() <= least + 0.031 * max(value)
    moments = random.uniform(0, routes[0].period, 500)
    late = np.array([(waits(routes, v, moments, 8) > a).mean() for v, a in enumerate(attack)])
    error = (found.exposure * (1 - found.exposure) / moments.size) ** 0.5
    assert (abs(late - found.exposure) <= 3.5 * error + 1e-9).all()


@pytest.mark.parametrize("attack", [1.25, 1.5, 2.75])
def test_attacks_with_parts_of_a_step_are_bounded_by_an_own_linear_program(attack):
    least = least_risk([(0, 1, 1), (1, 2, 1)], [attack] * 3, [1] * 3)
    game = Game.of(Graph([[0, 1], [1, 2]]), attack)
    assert 1 - bound(game).capture == pytest.approx(least, abs=1e-7)
    found = evaluate(game, routes := best_routes(game))
    assert least - 1e-9 <= found.exposure.max() <= least + 0.021
    moments = np.random.default_rng(0).uniform(0, routes[0].period, 2000)
    missed = np.array([(waits(routes, v, moments) > attack).mean() for v in range(3)])
    assert (abs(missed - found.exposure) <= 3 * (missed * (1 - missed) / 2000) ** 0.5 + 1e-9).all()


def test_answer_says_whether_all_schedules_were_compared():
    cycle = Graph([(v, (v + 1) % 5) for v in range(5)])
    game = Game.of(cycle, 2.0, robots=2, adversary="watcher")
    answer = Guarded.of(game, best_routes(game), bound=bound(game)._replace(capture=1.0)).answer
    assert "All schedules were compared: none stops every attack." in answer
    game = Game.of(cycle, [2.0, 2.0, 2.0, 2.0, 2.0**0.5], robots=2, speed=None)
    small = bound(game)
    assert small.preventable is False
    apart = Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [1, 2**0.5]])
    game = Game.of(apart, [1.0, 1.0, 2.0], robots=2, speed=1.0)
    assert bound(game).preventable is None
    routes = best_rounds(game).routes
    answer = Guarded.of(game, routes, bound=bound(game)._replace(capture=1.0)).answer
    shown = "Not all schedules were compared: another one may stop every attack." in answer
    assert shown == (evaluate(game, routes).exposure.max() > 0)


def most_against_recent(near, attack, seen):
    """Compute the capture by the best random walk if an adversary sees its last `seen` vertices.

    The variables are the shares of all walks as long as what he sees and the longest attack;
    `attack` has the steps of an attack on each target.
    """
    steps = range(seen + max(attack.values()) - 1)
    walks = [
        walk
        for walk in itertools.product(range(len(near)), repeat=len(steps) + 1)
        if all(walk[k + 1] in near[walk[k]] for k in steps)
    ]
    ends = sorted({walk[:-1] for walk in walks} | {walk[1:] for walk in walks})
    balance = np.array([[(w[:-1] == e) - 1.0 * (w[1:] == e) for w in walks] for e in ends])
    balance = np.append(balance, np.ones((1, len(walks))), axis=0)
    pairs = [(w, v) for w in sorted({walk[:seen] for walk in walks}) for v in attack]
    total = np.append(np.zeros(len(ends)), 1.0)
    low, high = 0.0, 1.0
    while high - low > 1e-3:
        tried = (low + high) / 2
        missing = [
            [
                (tried - (v in walk[seen : seen + attack[v]])) * (walk[:seen] == begin)
                for walk in walks
            ]
            for begin, v in pairs
        ]
        late = np.array(missing, float)
        zero = np.zeros(len(walks))
        found = scipy.optimize.linprog(zero, late, np.zeros(len(late)), balance, total)
        low, high = (low, tried) if found.status == 2 else (tried, high)
    return high


@pytest.mark.parametrize(
    ("graph", "attack"),
    [
        (nx.complete_graph(3), 2),
        (nx.cycle_graph(4), 2),
        (nx.path_graph(3), 2),
        (nx.path_graph(3), 3),
        (nx.DiGraph([(0, 1), (1, 2), (2, 0), (1, 0)]), 2),
    ],
)
def test_watcher_is_bounded_by_the_best_answers_to_one_who_sees_less(graph, attack):
    near = [[v, *graph[v]] for v in range(len(graph))]
    game = Game.of(graph, float(attack), adversary="watcher")
    limit = bound(game).capture
    for seen in (1, 2):
        assert limit <= most_against_recent(near, dict.fromkeys(graph, attack), seen) + 2e-3
    if not graph.is_directed():
        edges = Graph(list(graph.edges))
        assert (
            limit >= maximin_capture(edges, attack, stay=True, memory=2, throw=False).value - 1e-6
        )
    blind = bound(dataclasses.replace(game, adversary="blind")).capture
    assert limit <= blind


def test_watcher_of_a_path_is_met_by_random_walks_up_to_the_bound():
    game = Game.of(Graph([[0, 1], [1, 2]]), 3.0, adversary="watcher")
    known = maximin_capture(Graph([[0, 1], [1, 2]]), 3, stay=True, memory=2, throw=False).value
    assert known == pytest.approx(bound(game).capture, abs=2e-3)
    answer = Guarded.of(game, best_routes(game), bound=bound(game)).answer
    assert any(
        "No patrol, not even a random one, stops more than 58.6 %" in line for line in answer
    )


def missed_by_walk(matrix, vertex, attack):
    """Compute the probability of no capture by recursion, from each state and on each target."""
    for target, steps in attack.items():
        missed = jnp.ones(len(matrix))
        for _ in range(steps):
            missed = matrix @ jnp.where(vertex == target, 0.0, missed)
        yield missed


def best_walk(near, attack, memories=2):
    """Search for a walk with a memory of some states, and return its capture if all is known."""
    vertex = np.tile(np.arange(len(near)), memories)
    legal = jnp.array([[there in near[here] for there in vertex] for here in vertex])

    def missed(weights):
        matrix = jax.nn.softmax(jnp.where(legal, weights.reshape(legal.shape), -jnp.inf), axis=1)
        return jnp.concatenate([*missed_by_walk(matrix, vertex, attack)])

    def smooth(weights, sharp):
        return jax.nn.logsumexp(sharp * missed(weights)) / sharp

    slope, best = jax.jit(jax.value_and_grad(smooth)), 1.0
    for start in np.random.default_rng(0).normal(0, 2, (8, legal.size)):
        for sharp in (10.0, 100.0, 1000.0):
            start = scipy.optimize.minimize(slope, start, (sharp,), jac=True, tol=1e-9).x
        best = min(best, float(missed(start).max()))
    return 1 - best


PATH, STAR = nx.path_graph(3), nx.star_graph(3)
PAW = nx.Graph([(1, 3), (3, 2), (2, 0), (0, 3)])


@pytest.mark.parametrize(
    ("graph", "attack", "least"),
    [
        (PATH, {0: 2, 2: 2}, 0.49),
        (PATH, {0: 3, 2: 3}, 0.57),
        (PATH, {0: 3, 2: 2}, 0.49),
        (PATH, {0: 4, 2: 2}, 0.6),
        (PATH, {0: 4, 2: 3}, 0.61),
        (STAR, {1: 2, 2: 2, 3: 2}, 0.32),
        (PAW, {1: 3, 2: 3}, 0.49),
    ],
)
def test_bound_for_a_watcher_is_valid_where_vertices_are_no_targets(graph, attack, least):
    near = {v: [v, *graph[v]] for v in sorted(graph)}
    targets, steps = [f"{v}" for v in attack], [float(a) for a in attack.values()]
    game = Game.of(graph, steps, targets=targets, adversary="watcher")
    limit = bound(game).capture
    known = best_walk(near, attack)
    assert least <= known <= limit + 1e-9
    assert limit <= most_against_recent(near, attack, 1) + 2e-3
    # A patrol of all vertices is one of some of them.
    every = Game.of(graph, max(steps), adversary="watcher")
    fewer = Game.of(graph, max(steps), targets=targets, adversary="watcher")
    assert bound(fewer).capture >= bound(every).capture - 1e-3


@pytest.mark.parametrize(
    ("graph", "attack", "known"),
    [(PATH, {0: 3, 2: 3}, 0.5), (PATH, {0: 2, 2: 2}, 0.0), (nx.complete_graph(3), None, 0.5)],
)
def test_bound_for_a_watcher_in_seconds_is_reached_by_a_walk_that_is_seen_on_its_way(
    graph, attack, known
):
    attack = attack or dict.fromkeys(graph, 2)
    # Each way has three places, and he sees a walker there, too. Walkers leave at once.
    number = {(v, v): v for v in sorted(graph)}
    ways = [(a, b, k) for a in graph for b in graph[a] for k in range(3)]
    number |= {way: len(number) + i for i, way in enumerate(ways)}
    matrix = np.zeros((len(number),) * 2)
    for a, b, k in ways:
        matrix[number[a, b, k], number[a, b, k + 1] if k < 2 else b] = 1.0
        matrix[a, number[a, b, 0]] = 1 / len(graph[a])
    seen = {v: 4 * steps for v, steps in attack.items()}
    # He looks just before a moment, after which the attack takes as many.
    missed = max(each.max() for each in missed_by_walk(matrix, np.arange(len(matrix)), seen))
    assert 1 - missed == pytest.approx(known)
    timed = nx.create_empty_copy(graph)
    timed.add_edges_from(graph.edges, length=1.0)
    names, times = [f"{v}" for v in attack], [float(a) for a in attack.values()]
    limit = bound(Game.of(timed, times, targets=names, speed=1.0, adversary="watcher")).capture
    assert known <= limit <= known + 2e-3
