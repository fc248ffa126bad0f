import numpy as np
import pytest
import shapely
from hypothesis import example, given, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from jaxcell.base import memory
from jaxcell.space import Workspace
from jaxcell.space.outlines import free_polygons


grids = arrays(bool, array_shapes(min_dims=2, max_dims=2, max_side=9))
CHECKERS = np.indices((5, 6)).sum(axis=0) % 2 == 0
# A loop that meets itself in a corner, around two holes that meet in a corner.
LOOP = np.array([[1, 1, 1, 1], [1, 0, 1, 1], [1, 1, 0, 1], [1, 1, 1, 1]], bool)
PINCH = np.array([[1, 1, 0], [1, 0, 1], [1, 1, 1]], bool)


def flooded(free):
    """The sets of squares that are connected by their sides."""
    left, found = {tuple(square) for square in np.argwhere(free).tolist()}, set()
    while left:
        stack = [left.pop()]
        part = set(stack)
        while stack:
            row, column = stack.pop()
            for near in (
                (row + 1, column),
                (row - 1, column),
                (row, column + 1),
                (row, column - 1),
            ):
                if near in left:
                    left.remove(near)
                    part.add(near)
                    stack.append(near)
        found.add(frozenset(part))
    return found


@given(grids)
@example(CHECKERS)
@example(LOOP)
@example(PINCH)
@example(PINCH[:, ::-1])
@example(np.zeros((1, 1), bool))
def test_outlines_are_those_of_connected_squares(free):
    rows, columns = free.shape
    parts = shapely.get_parts(
        free_polygons(free, np.arange(columns + 1.0), np.arange(rows + 1.0))
    ).tolist()
    middles = {
        (row, column): shapely.Point(column + 0.5, row + 0.5)
        for row, column in np.ndindex(free.shape)
    }
    covered = {
        frozenset(square for square, middle in middles.items() if part.contains(middle))
        for part in parts
    }
    assert covered == flooded(free)
    assert sorted(part.area for part in parts) == sorted(map(len, covered))
    for part in parts:
        assert shapely.is_valid(part), shapely.is_valid_reason(part)
        for ring in (part.exterior, *part.interiors):
            steps = np.diff(shapely.get_coordinates(ring), axis=0)
            assert ((steps == 0) != (np.roll(steps, 1, axis=0) == 0)).all(), "collinear vertices"
            assert len(set(ring.coords)) == len(steps), "a ring that meets itself"


@st.composite
def boxes(draw):
    """Two whole numbers below 12, and two larger ones."""
    left, bottom = draw(st.integers(-2, 11)), draw(st.integers(-2, 9))
    return left, bottom, left + draw(st.integers(1, 6)), bottom + draw(st.integers(1, 6))


def squares_of(box):
    left, bottom, right, top = np.maximum(box, 0)
    return np.s_[bottom:top, left:right]


@given(st.lists(boxes(), max_size=8), st.sampled_from([1.0, 0.1, 1 / 3, 0.0254]), st.integers(0, 9))
def test_obstacles_may_overlap_each_other_and_the_boundary(obstacles, cell, far):
    floor = np.ones((10, 12), bool)
    floor[6:, 7:] = False
    obstacles = [box for box in obstacles if floor[squares_of(box)].any()]
    free = floor.copy()
    for box in obstacles:
        free[squares_of(box)] = False
    corner = np.array([10.0, -3.7]) * far
    boundary = corner + cell * np.array([(0, 0), (12, 0), (12, 6), (7, 6), (7, 10), (0, 10)])
    rings = [corner + cell * np.array(shapely.box(*box).exterior.coords) for box in obstacles]
    if not free.any():
        with pytest.raises(ValueError, match="they cover the whole boundary"):
            Workspace(boundary, rings)
        return
    parts = shapely.get_parts(Workspace(boundary, rings).environment)
    assert shapely.is_valid(parts).all()
    areas = [len(part) * cell**2 for part in flooded(free)]
    assert sorted(shapely.area(parts)) == pytest.approx(sorted(areas), rel=1e-6)


@pytest.fixture
def dithered(tmp_path):
    blocked = np.random.default_rng(0).random((150, 150)) < 0.5
    path = tmp_path / "dithered.txt"
    path.write_text("\n".join("".join(".#"[b] for b in row) for row in blocked[::-1].tolist()))
    return path, ~blocked


def test_grids_need_no_union_of_polygons(dithered, monkeypatch):
    path, free = dithered
    monkeypatch.delattr(shapely, "disjoint_subset_union_all")
    room = Workspace.load(path)
    assert room.environment.area == free.sum()
    assert room.pieces == len(flooded(free))


def test_outlines_that_do_not_fit_are_refused_in_one_line(dithered, monkeypatch):
    path, _ = dithered
    monkeypatch.setattr(memory, "free", lambda: 2 * 10**6)
    monkeypatch.setattr(memory, "NEGLIGIBLE", 10**6)
    with pytest.raises(MemoryError, match=r"^obstacles: the outline of 3,\d{3} obstacles needs"):
        Workspace.load(path)
