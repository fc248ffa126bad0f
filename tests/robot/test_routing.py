import networkx as nx
import numpy as np
import pytest
from hypothesis import given, strategies as st

from jaxcell.robot.routing import grid_steps, next_way, wave


SIDES = [(0, 1), (1, 0), (0, -1), (-1, 0)]


def graph_of(free, closed=()) -> nx.Graph:
    """The graph of a grid, made square by square."""
    rows, columns = free.shape
    squares = [(r, c) for r in range(rows) for c in range(columns) if free[r, c]]
    number = {square: i for i, square in enumerate(squares)}
    graph = nx.Graph()
    graph.add_nodes_from(number.values())
    for (r, c), i in number.items():
        graph.add_edges_from((i, number[n]) for n in [(r, c + 1), (r + 1, c)] if n in number)
    for position, way in closed:
        r, c = squares[position]
        there = number.get((r + SIDES[way][0], c + SIDES[way][1]))
        if graph.has_edge(position, there):
            graph.remove_edge(position, there)
    return graph


@st.composite
def grids(draw):
    rows, columns = draw(st.integers(1, 7)), draw(st.integers(1, 7))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    free = rng.random((rows, columns)) < draw(st.sampled_from([0.5, 0.7, 0.9, 1.0]))
    free.flat[rng.integers(free.size)] = True
    positions = int(free.sum())
    count = draw(st.integers(0, 5))
    closed = [(int(p), int(w)) for p, w in rng.integers((positions, 4), size=(count, 2))]
    return free, closed


@given(grids(), st.integers(0, 10**6), st.integers(0, 10**6), st.integers(0, 3))
def test_routes_are_shortest(grid, start, goal, ahead):
    free, closed = grid
    steps, graph = grid_steps(free, closed), graph_of(free, closed)
    start, goal = start % steps.shape[1], goal % steps.shape[1]
    known = nx.single_source_shortest_path_length(graph, goal)
    distance = wave(steps, goal)
    assert distance.tolist() == [known.get(i, -1) for i in range(steps.shape[1])]
    at = start
    for _ in range(known.get(start, 0)):
        ahead = next_way(steps, distance, at, ahead)
        assert graph.has_edge(at, int(steps[ahead, at]))
        at = int(steps[ahead, at])
    assert start not in known or at == goal


def test_the_ways_are_east_north_west_south():
    # Position 4 is the middle of nine.
    assert grid_steps(np.ones((3, 3), bool))[:, 4].tolist() == [5, 7, 3, 1]
    assert grid_steps(np.ones((3, 3), bool), [(4, 0)])[:, [4, 5]].tolist() == [
        [4, 5],
        [7, 8],
        [3, 5],
        [1, 2],
    ]


def test_a_route_prefers_to_go_straight():
    steps = grid_steps(np.ones((4, 4), bool))
    # From position 0, a corner, East and North are equally near to position 15.
    assert [next_way(steps, wave(steps, 15), 0, ahead) for ahead in range(4)] == [0, 1, 0, 0]
    assert next_way(steps, wave(steps, 0), 15, ahead=3) == 3


def test_wrong_positions_and_directions_are_refused():
    steps = grid_steps(np.ones((2, 2), bool))
    with pytest.raises(ValueError, match="goal: position 4 does not exist; positions are 0 to 3"):
        wave(steps, 4)
    with pytest.raises(ValueError, match="closed: position 7 does not exist"):
        grid_steps(np.ones((2, 2), bool), [(7, 0)])
    with pytest.raises(ValueError, match="closed: expected a direction from 0 to 3, got 4"):
        grid_steps(np.ones((2, 2), bool), [(0, 4)])
