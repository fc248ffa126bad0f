"""Rounds against robots that are moved step by step, and against published cases."""

import math

import networkx as nx
import numpy as np
import pytest

from jaxcell.optimize import Graph
from jaxcell.patrol.team import evenly_spaced_round, round_on_map, walk_around
from jaxcell.study import PatrolMap


def cycle(vertices):
    return Graph([(v, (v + 1) % vertices) for v in range(vertices)])


@pytest.mark.parametrize(
    ("vertices", "robots", "attack"), [(6, 2, 3), (8, 2, 4), (9, 3, 3), (12, 5, 3)]
)
def test_robots_on_a_cycle_capture_every_attack(vertices, robots, attack):
    found = evenly_spaced_round(cycle(vertices), robots, attack)
    assert (found.longest, found.watched_capture, found.least_capture) == (attack, 1, 1)
    shorter = evenly_spaced_round(cycle(vertices), robots, attack - 1)
    assert shorter.watched_capture == 0
    assert 0 < shorter.least_capture < 1


def followed(found, lasts, clock):
    """The places of all robots at the times of a clock: they follow each other on their tours."""
    walks = []
    for names, robots in zip(found.stops.tolist(), found.robots.tolist(), strict=True):
        names, places = [name for name in names if name], []
        for here, there in zip(names, [*names[1:], names[0]], strict=True):
            places += [here] + [None] * (lasts.get(frozenset((here, there)), 1) - 1)
        walks += [
            [places[(time + r * len(places) // robots) % len(places)] for time in range(clock)]
            for r in range(robots)
        ]
    return np.array(walks, object)


def met(found, lasts, attack, network):
    """The longest time between visits, and the captures, by a clock that all tours divide."""
    clock = math.lcm(*(max(1, int(duration)) for duration in found.duration))
    walks = followed(found, lasts, clock)
    longest, blind, watched = 0, 1.0, 1.0
    for place in map(str, network):
        there = (walks == place).any(axis=0)
        assert there.any(), place
        wait = np.array([1 + int(np.roll(there, -time - 1).argmax()) for time in range(clock)])
        longest = max(longest, wait.max())
        blind = min(blind, (wait <= attack).mean())
        watched = min(watched, float(wait.max() <= attack))
    return longest, blind, watched


@pytest.mark.parametrize("seed", range(6))
def test_times_between_visits_are_those_of_robots_moved_step_by_step(seed):
    random = np.random.default_rng(seed)
    network = nx.random_labeled_tree(7, seed=seed)
    times = random.integers(1, 5, network.number_of_edges())
    ends = [frozenset(map(str, edge)) for edge in network.edges]
    robots, attack = int(random.integers(1, 4)), int(random.integers(3, 12))
    found = evenly_spaced_round(
        Graph(network), robots, attack, travel_times=times, names=[str(v) for v in network]
    )
    assert found.robots.sum() == robots
    longest, blind, watched = met(
        found, dict(zip(ends, times.tolist(), strict=True)), attack, network
    )
    assert found.longest == longest
    assert found.least_capture == pytest.approx(blind)
    assert found.watched_capture == watched


@pytest.mark.parametrize(
    ("network", "robots", "attack", "longest", "captured"),
    [
        # Four robots go to and fro on five vertices each, in eight steps.
        (nx.path_graph(20), 4, 8, 8, 1),
        (nx.path_graph(20), 4, 7, 8, 7 / 8),
        (nx.path_graph(20), 1, 20, 38, 20 / 38),
        (nx.cycle_graph(9), 3, 3, 3, 1),
        # A closed walk through all 16 vertices of a grid is shared by two robots.
        (nx.convert_node_labels_to_integers(nx.grid_2d_graph(4, 4)), 2, 8, 8, 1),
        (nx.convert_node_labels_to_integers(nx.grid_2d_graph(4, 4)), 2, 6, 8, 6 / 8),
        # One robot on a line of three and one on a cycle of five; a second one there; and a third.
        (nx.disjoint_union(nx.path_graph(3), nx.cycle_graph(5)), 2, 4, 5, 4 / 5),
        (nx.disjoint_union(nx.path_graph(3), nx.cycle_graph(5)), 3, 4, 4, 1),
        (nx.disjoint_union(nx.path_graph(3), nx.cycle_graph(5)), 4, 3, 3, 1),
        # A vertex without edges has a robot that stays.
        (nx.disjoint_union(nx.path_graph(3), nx.empty_graph(1)), 2, 3, 4, 3 / 4),
    ],
)
def test_rounds_on_parts_are_those_of_robots_on_a_clock(network, robots, attack, longest, captured):
    edges = [*network.edges]
    found = evenly_spaced_round(Graph(edges, len(network)), robots, attack)
    assert (found.longest, found.least_capture) == (longest, pytest.approx(captured))
    assert met(found, {}, attack, network) == (longest, pytest.approx(captured), captured == 1)
    assert found.watched_capture == (captured == 1)
    steps = {frozenset(map(str, edge)) for edge in edges}
    for tour in found.stops.tolist():
        tour = [name for name in tour if name]
        moves = zip(tour, [*tour[1:], tour[0]], strict=True)
        assert len(tour) == 1 or {frozenset(move) for move in moves} <= steps


def test_round_needs_a_robot_for_each_component():
    with pytest.raises(ValueError, match="robots: expected at least 2, one for each connected"):
        evenly_spaced_round(Graph([(0, 1), (2, 3)]), 1)


def test_times_of_a_round_have_units():
    line = Graph([[0, 1], [1, 2]])
    steps = evenly_spaced_round(line, 1)
    assert (steps.steps.tolist(), steps.steps_between, steps.seconds) == ([4], 4, None)
    timed = evenly_spaced_round(line, 1, travel_times=[1, 3], unit=5.0)
    assert (timed.steps, timed.seconds.tolist(), timed.seconds_between) == (None, [40], 40)


def test_round_of_true_lengths_captures_the_share_of_the_tour_that_an_attack_lasts():
    """A square with sides of 14 s: attacks of 40 s at a random time, and as long as a tour."""
    square, sides = cycle(4), np.full(4, 14.0)
    found = evenly_spaced_round(square, 1, 40, travel_times=sides, unit=1.0)
    assert (found.seconds.tolist(), found.seconds_between, found.watched_capture) == ([56], 56, 0)
    assert found.least_capture == pytest.approx(40 / 56)
    assert evenly_spaced_round(square, 1, 56, travel_times=sides, unit=1.0).watched_capture == 1
    assert evenly_spaced_round(square, 3, travel_times=sides, unit=1.0).longest == (
        pytest.approx(56 / 3)
    )


def test_round_on_a_map_is_that_of_two_robots_moved_step_by_step():
    """A corridor of nine cells, in which a robot sees its neighbours."""
    cells = 9
    corridor = Graph([(v, v + 1) for v in range(cells - 1)])
    visible = np.abs(np.subtract.outer(np.arange(cells), np.arange(cells))) <= 1
    for attack in (3, 5, 6):
        found = round_on_map(corridor, visible, 2, attack, np.arange(cells))
        # The shortest tour that sees both ends goes back and forth between cells 1 and 7.
        tour = np.array([*range(1, 8), *range(6, 1, -1)])
        walks = tour, np.roll(tour, -(len(tour) // 2))
        blind, watched = 1.0, 1.0
        for place in range(cells):
            seen = visible[walks[0], place] | visible[walks[1], place]
            hidden = np.flatnonzero(~seen)
            wait = [int(np.roll(seen, -time).argmax()) for time in hidden]
            if wait:
                blind = min(blind, np.mean(np.array(wait) <= attack))
                watched = min(watched, float(max(wait) <= attack))
        assert found.least_capture == pytest.approx(blind)
        assert found.watched_capture == watched
    assert round_on_map(corridor, np.ones((cells, cells), bool), 1, 3, np.arange(cells)) is None


@pytest.mark.parametrize("name", ["depot", "cafe", "harbour", "complex"])
def test_two_robots_on_a_round_capture_every_attack_of_20_steps(name):
    """Robots half a tour apart see each cell that is not always seen; cells see their sight."""
    study = PatrolMap(map=f"@{name}")
    cells = study.cells()
    graph, visible = study._graph(cells), study._visible(cells, 6.0)
    contested = np.flatnonzero(~visible.all(axis=0) & visible.any(axis=0))
    found = round_on_map(graph, visible, 2, 20, contested)
    walk, steps = found.walk, {frozenset(edge) for edge in graph.edges.tolist()}
    assert {frozenset(step) for step in zip(walk, np.roll(walk, 1), strict=True)} <= steps
    other = np.roll(walk, -(walk.size // 2))
    seen = visible[walk] | visible[other]
    for place in contested:
        hidden = max(
            len(run) for run in "".join(".x"[int(s)] for s in [*seen[:, place]] * 2).split("x")
        )
        assert hidden <= 20
    assert found.watched_capture == found.least_capture == 1


def test_robot_walks_around_a_tour_with_its_memory():
    walk = np.array([3, 2, 1, 2, 4, 2])
    image, chance = walk_around(walk, 5)
    state, cells = 3, []
    for _ in range(12):
        cells.append(state % 5)
        state = image[0, state]
    assert cells == [*walk, *walk]
    assert (chance == 1).all()
