import dataclasses
import itertools
import math

import numpy as np
import pytest
import scipy.sparse
import zarr
from hypothesis import given, strategies as st
from random_rooms import grids

from jaxcell.bounce import (
    AllPlans,
    all_plans,
    bounce_map,
    localization_policy,
    plan,
    replay,
)
from jaxcell.space import ENDPOINT, CellSpace, Motion, Workspace


GRIDS = grids(15, (4, 5))
LAB = np.deg2rad([45, 90, 135])
ROUND = CellSpace.of(
    Workspace(
        [(0, 0), (6, 0), *((6 * math.cos(a), 5 * math.sin(a)) for a in (0.3, 0.8, 1.3)), (0, 5)],
        [[(2, 1), (3.3, 1.2), (2.5, 2.6)]],
        robot_radius=0.2,
    ),
    0.6,
    24,
)


def room(rows, columns, seed=0):
    """A room with small obstacles at random places."""
    free = np.ones((rows, columns), bool)
    for row, column in np.random.default_rng(seed).integers((rows - 1, columns - 2), size=(9, 2)):
        free[row : row + 2, column : column + 3] = False
    return CellSpace.of_grid(free, 8)


def two_rooms():
    return CellSpace.of_grid(np.array([[1, 1, 1, 0, 1, 1]] * 3, bool), 8)


def moves_of(cells, bounces, **options):
    """List all moves: the cell, the next cell, and the angle at a bump or `None` for a step."""
    for k, bounce in enumerate(bounces):
        simple = bounce_map(cells, bounce, **options)
        pairs = zip(np.asarray(simple.image).tolist(), np.asarray(simple.bumped), strict=True)
        for z, (image, bumped) in enumerate(pairs):
            if bumped:
                yield z, image, k
            elif k == 0:
                yield z, image, None


def literal_costs(cells, bounces, keep, change, method="exact", **options):
    """Compute the costs between all pairs of cells, -1 for no path, by Dijkstra's algorithm.

    The graph has a layer of cells for each angle. The exact search changes the layer with the angle
    in use, and starts in a last layer. Alg. 3.1 stays in the layer in which it starts.
    """
    layers = len(bounces) + (method == "exact")
    rows, columns, weights = [], [], []
    for z, image, k in moves_of(cells, bounces, **options):
        for layer in range(layers):
            to = k if method == "exact" and k is not None else layer
            rows.append(layer * cells.size + z)
            columns.append(to * cells.size + image)
            weights.append(keep if k in (None, layer) or layer == len(bounces) else change)
    shape = (layers * cells.size,) * 2
    graph = scipy.sparse.csr_array((np.array(weights, float), (rows, columns)), shape=shape)
    starts = np.arange(layers * cells.size).reshape(layers, -1)
    starts = starts[-1:] if method == "exact" else starts
    costs = scipy.sparse.csgraph.dijkstra(graph, indices=starts.ravel())
    costs = costs.reshape(-1, cells.size, layers, cells.size).min(axis=(0, 2))
    return np.where(np.isinf(costs), -1, costs)


def cost_of(actions, keep, change, method="exact"):
    bumps = actions[actions != 0]
    if method == "exact":
        changes = sum(a != b for a, b in itertools.pairwise(bumps))
    else:
        changes = min((int((bumps != base).sum()) for base in bumps), default=0)
    return keep * (len(actions) - changes) + change * changes


def check(cells, result, keep, change, method="exact", **options):
    """Check that a plan leads to its goal at its cost, or reports that no plan exists."""
    if result.found:
        path = replay(cells, result.start, result.actions, **options)
        np.testing.assert_array_equal(path, result.visited)
        assert path[-1] == result.goal
        assert result.cost == pytest.approx(
            cost_of(result.actions, keep, change, method), rel=1e-12
        )
        assert result.reaching[result.visited].all()
    else:
        assert result.cost == -1
        assert result.visited.tolist() == [result.start]
        assert not result.actions.size
        assert not result.reaching[result.start]


angle_sets = st.sets(st.integers(1, 7), min_size=1, max_size=4).map(sorted)
weights = st.tuples(st.integers(1, 4), st.integers(0, 20)).map(lambda w: (w[0], w[0] + w[1]))


@given(GRIDS, angle_sets, weights, st.sampled_from(["exact", "layered"]), st.randoms())
def test_plans_are_cheapest_paths_of_the_literal_graph(free, shifts, weights, method, random):
    cells = CellSpace.of_grid(free, 8)
    bounces = 2 * np.pi * np.array(shifts) / 8
    plans = all_plans(cells, bounces, *weights, method=method)
    costs, actions, used = plans.costs(), plans.actions(), plans.angles_used()
    np.testing.assert_array_equal(costs, literal_costs(cells, bounces, *weights, method))
    for start in random.sample(range(cells.size), min(6, cells.size)):
        for goal in random.sample(range(cells.size), min(6, cells.size)):
            result = plans.plan(start, goal)
            check(cells, result, *weights, method)
            np.testing.assert_array_equal(result.reaching, costs[:, goal] >= 0)
            assert result.cost == costs[start, goal]
            assert used[start, goal] == (result.angles_used if result.found else -1)
            first = -1
            if result.actions.size:
                matches = np.flatnonzero(bounces == result.actions[0])
                first = 1 + matches[0] if matches.size else 0
            assert actions[start, goal] == first


@pytest.mark.parametrize(
    ("cells", "bounces", "weights", "options"),
    [
        (room(9, 13), LAB, (2, 31), {}),
        (room(7, 20, seed=1), -LAB, (2, 31), {"motion": ENDPOINT}),
        (ROUND, np.deg2rad([30, 105, 225]), (2, 31), {"motion": Motion(0.65)}),
        (room(6, 9), LAB, (0.3, 7.7), {}),
    ],
)
def test_all_costs_are_those_of_dijkstra(cells, bounces, weights, options):
    plans = all_plans(cells, bounces, *weights, **options)
    costs = plans.costs()
    assert costs.dtype == (np.int32 if weights == (2, 31) else float)
    expected = literal_costs(cells, bounces, *weights, **options)
    np.testing.assert_allclose(costs, expected, rtol=1e-12)
    assert (costs >= 0).any()
    for start, goal in np.random.default_rng(0).integers(cells.size, size=(60, 2)).tolist():
        check(cells, plans.plan(start, goal), *weights, **options)
    alone = plan(cells, bounces, start, goal, *weights, **options)
    assert_same(alone, plans.plan(start, goal))


def assert_same(one, other):
    for name in {field.name for field in dataclasses.fields(one)} - {"cells", "roadmap"}:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_large_whole_costs_stay_exact():
    cells = room(6, 9)
    small, large = (all_plans(cells, LAB, 1, 10**n).costs().astype(np.int64) for n in (6, 12))
    steps, changes = small % 10**6, small // 10**6
    reached = small >= 0
    np.testing.assert_array_equal((steps + changes * 10**12)[reached], large[reached])
    assert changes.max() > 1


@pytest.mark.parametrize("keep", [1, 0.5])
def test_plans_are_the_same_when_read_from_their_store(tmp_path, keep):
    cells = room(6, 9)
    reports = []
    plans = all_plans(cells, LAB, keep, 9)
    direct = all_plans(
        cells, LAB, keep, 9, store=tmp_path / "a.zarr", progress=lambda *at: reports.append(at)
    )
    plans.save(tmp_path / "b.zarr")
    entries = plans.roadmap.entry.size
    assert reports[-1] == (entries, entries)
    stores = tmp_path / "a.zarr", tmp_path / "b.zarr"
    for loaded in (direct, *(AllPlans.load(store, cells) for store in stores)):
        np.testing.assert_array_equal(loaded.costs(), plans.costs())
        np.testing.assert_array_equal(loaded.actions(), plans.actions())
        some = np.array([40, 3, 3, 130])
        np.testing.assert_array_equal(loaded.angles_used(some), plans.angles_used()[:, some])
        assert vars(loaded.roadmap)["space"] == plans.roadmap.space
        for start, goal in np.random.default_rng(1).integers(cells.size, size=(20, 2)).tolist():
            result, expected = loaded.plan(start, goal), plans.plan(start, goal)
            check(cells, result, keep, 9)
            assert_same(result, expected)


def test_the_store_explains_how_to_read_a_cost(tmp_path):
    import xarray as xr

    cells = room(6, 9)
    plans = all_plans(cells, LAB, store=tmp_path / "plans.zarr")
    with xr.open_zarr(tmp_path / "plans.zarr", consolidated=False) as file:
        keep, wall, length = file.keep, file.wall.values, file.length.values
        s, g = np.divmod(np.arange(cells.size**2), cells.size)
        e = file.entry_of.values[g]
        way = file["cost"].values[e, wall[s]]
        total = keep * (length[s] + length[file.entry.values[e]] - length[g]) + way
        expected = np.where((e < 0) | (way < 0), -1, total)
        straight = (wall[s] == wall[g]) & (length[s] >= length[g])
        expected = np.where(straight, keep * (length[s] - length[g]), expected)
    np.testing.assert_array_equal(plans.costs().ravel(), expected)


def test_a_store_is_written_whole_or_not_at_all(tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        all_plans(room(6, 9), LAB, store=tmp_path / "plans.zarr", progress=stop)
    assert not list(tmp_path.iterdir())
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        all_plans(room(6, 9), LAB, store=tmp_path / "none" / "plans.zarr")


def test_other_stores_are_refused(tmp_path):
    def refused(name, message, error=ValueError, cells=None):
        with pytest.raises(error, match=message):
            AllPlans.load(tmp_path / name, cells or room(6, 9))

    refused("none.zarr", r"none\.zarr: there is no such file", FileNotFoundError)
    (tmp_path / "text.zarr").write_text("plans")
    refused("text.zarr", r"text\.zarr: expected a Zarr store of plans")
    zarr.create_group(tmp_path / "other.zarr")
    refused("other.zarr", r"other\.zarr: expected a store of plans; its format is not")
    all_plans(room(6, 9), LAB, store=tmp_path / "small.zarr")
    message = r"small\.zarr: positions: expected 15 as in the cells, got"
    refused("small.zarr", message, cells=two_rooms())
    small = zarr.open_group(tmp_path / "small.zarr", mode="r+")
    del small["length"]
    refused("small.zarr", r"small\.zarr: .*length")
    small.create_array("length", shape=(10**9,), dtype=np.int32)
    refused("small.zarr", r"small\.zarr: length: expected the shape")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"bounces": []}, "bounces: expected a list of at least one angle"),
        ({"bounces": [0.1]}, "bounces: 5.72958 deg is not a whole number of the 8 directions"),
        ({"bounces": [math.pi, 2 * math.pi]}, "bounces: 360 deg leaves the robot at its wall"),
        ({"bounces": [math.pi / 2, -1.5 * math.pi]}, "bounces: 90 and -270 deg are the same turn"),
        ({"start": 120}, "start: cell 120 does not exist; cells are 0 to 119"),
        ({"goal": -1}, "goal: cell -1 does not exist"),
        ({"start": (0.5,)}, "start: expected a cell, or a pose x, y, heading in metres"),
        ({"goal": (0.5, 0.5, 90)}, "goal: heading: 5156.62 deg is not a whole number of the 8"),
        ({"goal": (99, 0.5, 0)}, r"goal: the point \(99, 0.5\) is off the map"),
        ({"keep": 0}, "keep: expected a finite cost above 0, got 0"),
        ({"keep": math.nan}, "keep: expected a finite cost above 0, got nan"),
        ({"change": math.inf}, "change: expected a finite cost above 0, got inf"),
        ({"keep": 3, "change": 2}, "change: expected at least what keeping the angle costs, 3"),
        ({"change": 1e18}, "change: 1e.18 is too much beside keep 1"),
        ({"change": 10**18}, "change: 1e.18 is too much beside keep 1"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        plan(**{"cells": two_rooms(), "bounces": LAB, "start": 0, "goal": 1, **arguments})


@pytest.mark.parametrize("method", ["plan", "plan of all", "replay", "drive"])
def test_a_pose_stands_for_its_cell(method):
    cells = two_rooms()
    *place, heading = (float(one) for one in cells.centre(2 * cells.positions + 3))
    find = {
        "plan": lambda start: plan(cells, LAB, start, goal=5).visited,
        "plan of all": lambda start: all_plans(cells, LAB).plan(start, 5).visited,
        "replay": lambda start: replay(cells, start, []),
        "drive": lambda start: localization_policy(cells, LAB).drive(start).path,
    }[method]
    assert find((*place, heading)).tolist() == find(2 * cells.positions + 3).tolist()
    assert find(np.array(place)).tolist() == find(3).tolist()


@pytest.mark.parametrize(
    ("start", "actions", "message"),
    [
        (0, [0, 0, 0], r"actions\[2\]: in cell 2 the robot cannot go forward"),
        (0, [0, 1.0], r"actions\[1\]: in cell 1 the robot does not bump, so it cannot turn"),
        (0, [0, 0, 0.1], r"actions\[2\]: .* deg is not a whole number"),
        (0, [0, 0, math.nan], r"actions\[2\]: nan deg"),
        (-1, [], "start: cell -1 does not exist"),
    ],
)
def test_impossible_actions_are_refused(start, actions, message):
    with pytest.raises(ValueError, match=message):
        replay(two_rooms(), start, np.array(actions, float))
