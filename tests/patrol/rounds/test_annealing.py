"""Rounds for unequal attacks, in games in which a known patrol stops every attack."""

import itertools

import networkx as nx
import numpy as np
import pytest
from patrolled_rounds import waits

from jaxcell.patrol import Graph
from jaxcell.patrol.rounds import Game, best_rounds, bound


def check_safe(game):
    found = best_rounds(game)
    assert found.evaluation.exposure.max() == 0
    moments = np.random.default_rng(0).uniform(0, 50, 200)
    for vertex, attack in zip(game.targets.tolist(), game.attack, strict=True):
        assert waits(found.routes, vertex, moments, 20).max() <= attack + 1e-6


def test_guards_stay_where_attacks_are_short_and_one_walks_among_the_others():
    far = [[10 * np.cos(k), 10 * np.sin(k)] for k in range(5)]
    graph = Graph([(v, 5) for v in (0, 1, 2, 3, 4, 6, 7)], xy=[*far, [0, 0], [1, 0], [0, 1]])
    # One guard passes vertex 5 every 2 s, and comes to 6 and to 7 every 4 s.
    attack = [0.5] * 5 + [2.0, 4.0, 4.0]
    check_safe(Game.of(graph, attack, robots=6, speed=1.0))
    check_safe(Game.of(graph, attack, robots=6, speed=1.0, adversary="watcher"))


def draw_guarded(random, targets, guards):
    """Draw places, ways, targets, and attacks that rounds of guards among near targets stop."""
    count = targets + int(random.integers(0, 5))
    places = random.uniform(0, 10, (count, 2))
    far = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    ways = nx.minimum_spanning_tree(nx.from_numpy_array(far))
    for a, b in random.choice(count, (count // 2, 2)):
        if a != b:
            ways.add_edge(int(a), int(b), weight=far[a, b])
    length = dict(nx.all_pairs_dijkstra_path_length(ways))
    path = dict(nx.all_pairs_dijkstra_path(ways))
    chosen = random.choice(count, targets, replace=False).tolist()
    heads, longest = chosen[:guards], dict.fromkeys(chosen, np.inf)
    for head in heads:
        left = [v for v in chosen if min(heads, key=lambda h, v=v: length[h][v]) == head]
        order, now = [head], 0.0
        left.remove(head)
        while left:
            order.append(min(left, key=lambda v: length[order[-1]][v]))
            left.remove(order[-1])
        times = {v: [] for v in chosen}
        for a, b in zip(order, order[1:] + order[:1], strict=True):
            for u, w in itertools.pairwise(path[a][b]):
                times.get(u, []).append(now)
                now += far[u, w]
        for v, at in times.items():
            if at:
                longest[v] = min(longest[v], max(np.diff([*at, at[0] + now])))
        if len(order) == 1:
            longest[head] = min(longest[head], 0.5)
    attack = np.array([longest[v] for v in chosen]) * random.uniform(1, 1.1, targets)
    return Graph(list(ways.edges), count, xy=places), attack, [f"{v}" for v in chosen]


@pytest.mark.parametrize(("seed", "targets", "guards"), [(1, 12, 3), (8, 16, 2), (12, 8, 2)])
def test_every_attack_is_stopped_where_rounds_of_guards_with_neighbourhoods_do(
    seed, targets, guards
):
    graph, attack, names = draw_guarded(np.random.default_rng(seed), targets, guards)
    game = Game.of(graph, attack, targets=names, robots=guards, speed=1.0)
    assert bound(game).capture == pytest.approx(1)
    check_safe(game)
