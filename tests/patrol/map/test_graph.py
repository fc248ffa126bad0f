import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st

from jaxcell.patrol.map.graph import cell_graph
from jaxcell.space import CellSpace, Workspace


def box(xmin, ymin, xmax, ymax):
    return [(xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax)]


def room(blocked):
    rows, columns = blocked.shape
    obstacles = [box(x, y, x + 1, y + 1) for y, x in np.argwhere(blocked).tolist()]
    return CellSpace.of(Workspace(box(0, 0, columns, rows), obstacles), 1.0, 1)


def edges(graph):
    return {tuple(sorted(edge)) for edge in graph.edges.tolist()}


def edges_by_squares(free):
    """A step goes to a free square, and diagonally only past a free one."""
    squares = np.argwhere(free).tolist()
    number = {(r, c): i for i, (r, c) in enumerate(squares)}
    found = set()
    for (r, c), i in number.items():
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            beside = not (dr and dc) or (r + dr, c) in number or (r, c + dc) in number
            if (r + dr, c + dc) in number and beside:
                found.add((i, number[r + dr, c + dc]))
    return found


@given(st.integers(2, 6), st.integers(2, 6), st.integers(0, 10_000))
def test_squares(rows, columns, seed):
    blocked = np.random.default_rng(seed).random((rows, columns)) < 0.35
    expected = edges_by_squares(~blocked)
    if not expected:
        return
    cells = room(blocked)
    graph = cell_graph(cells)
    assert edges(graph) == expected
    assert graph.vertices == cells.positions
    np.testing.assert_array_equal(graph.xy[:, ::-1], np.argwhere(~blocked) + 0.5)


@pytest.mark.parametrize("cell", [0.5, 0.23])
def test_slanted_walls(cell):
    # No wall passes through a centre, so that a segment is free or crosses the inside of one.
    walls = [[(1.03, 0.71), (3.17, 1.93), (1.21, 2.04)], box(3.61, 2.23, 4.12, 3.37)]
    cells = CellSpace.of(Workspace(box(0, 0, 5, 4), walls), cell, 3)
    graph = cell_graph(cells)
    x, y, _ = cells.centre(np.arange(cells.positions))
    centre = np.stack([x, y], axis=1)
    np.testing.assert_array_equal(graph.xy, centre)
    first, second = np.triu_indices(cells.positions, 1)
    near = np.abs(centre[first] - centre[second]).max(axis=1) < 1.01 * cell
    pairs = np.stack([first, second], axis=1)[near]
    segments = shapely.linestrings(centre[pairs])
    free = shapely.covers(cells.workspace.free_space, segments)
    assert edges(graph) == {tuple(pair) for pair in pairs[free].tolist()}
    assert not free.all()


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        (room(np.eye(2, dtype=bool)), "cells: none of the 2 free cells"),
        (CellSpace.of_grid(np.ones((2, 2), bool), 1), "got cells of a grid"),
    ],
)
def test_cells_without_edges_or_walls_are_refused(cells, message):
    with pytest.raises(ValueError, match=message):
        cell_graph(cells)
