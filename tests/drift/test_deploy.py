import itertools

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_chains import matrices

from jaxcell.drift.behaviour import long_term_behaviour
from jaxcell.drift.deployment import (
    coverage_curve,
    deployment_cells,
    minimum_deployment,
    visible_deployment,
)
from jaxcell.drift.water import Water
from jaxcell.mapping import Chain, persistent_groups
from jaxcell.optimize import greedy_cover, minimum_cover


def sea(seed, side):
    """A random flow on a grid without land, with a disturbance to the East in some cells."""
    draw = np.random.default_rng(seed)
    y, x = np.divmod(np.arange(side * side), side)
    u, v = draw.integers(-1, 2, (2, side * side))
    image = np.clip(y + v, 0, side - 1) * side + np.clip(x + u, 0, side - 1)
    beside = np.clip(y + v, 0, side - 1) * side + np.clip(x + u + 1, 0, side - 1)
    rho = np.where(draw.random(side * side) < 0.5, 1, 0.8)
    return Chain(np.stack([image, beside]), np.stack([rho, 1 - rho]))


def closure(matrix):
    """Which cell leads to which, in 0 steps or more."""
    reach = (np.eye(len(matrix)) + matrix > 0).astype(float)
    for _ in range(len(matrix).bit_length()):
        reach = (reach @ reach > 0).astype(float)
    return reach > 0


def by_definition(matrix, behaviour):
    """The cells of Alg. 5.2, one after the other."""
    group, part = np.asarray(behaviour.groups.group), np.asarray(behaviour.transient.group)
    time = np.asarray(behaviour.absorption.value).astype(np.float32)
    chosen = [int(np.flatnonzero(group == g)[0]) for g in range(behaviour.groups.count)]
    for label in range(behaviour.transient.count):
        inside = part == label
        within = closure(matrix * np.outer(inside, inside))
        covered = np.zeros(len(matrix), bool)
        for cell in sorted(np.flatnonzero(inside), key=lambda z: (-time[z], z)):
            if not covered[cell]:
                chosen.append(int(cell))
                covered |= within[cell]
    return chosen


@given(matrices())
def test_deployment_covers_every_cell(matrix):
    behaviour = long_term_behaviour(Chain.from_scipy(matrix), 1)
    found = deployment_cells(behaviour)
    part, reach = np.asarray(behaviour.transient.group), closure(matrix)
    assert found.cells.tolist() == by_definition(matrix, behaviour)
    assert reach[found.cells].any(axis=0).all()
    np.testing.assert_array_equal(found.group, np.asarray(behaviour.groups.group)[found.cells])
    np.testing.assert_array_equal(found.transient_group, part[found.cells])
    assert found.gained.sum() == len(matrix)
    # Each transient group is covered by its own cells.
    for label in range(behaviour.transient.count):
        own = found.transient_group == label
        assert found.gained[own].sum() == (part == label).sum()
        assert reach[found.cells[own]][:, part == label].any(axis=0).all()


@pytest.mark.parametrize("seed", range(4))
def test_deployment_on_a_field(seed):
    chain = sea(seed, 12)
    behaviour = long_term_behaviour(chain, 1)
    found = deployment_cells(behaviour)
    matrix = chain.to_scipy().toarray()
    assert found.cells.tolist() == by_definition(matrix, behaviour)
    assert closure(matrix)[found.cells].any(axis=0).all()
    assert found.cells.size >= minimum_deployment(chain).size


@given(matrices())
def test_the_fewest_cells(matrix):
    reach = closure(matrix)
    cells = range(len(matrix))
    found = minimum_deployment(Chain.from_scipy(matrix))
    assert reach[found].any(axis=0).all()
    smaller = itertools.combinations(cells, found.size - 1)
    assert not any(reach[list(chosen)].any(axis=0).all() for chosen in smaller)


@pytest.mark.parametrize("seed", range(3))
def test_a_mixed_integer_program_needs_as_many(seed):
    chain = sea(seed, 9)
    graph = nx.DiGraph()
    graph.add_nodes_from(range(81))
    graph.add_edges_from(zip(*chain.to_scipy().nonzero(), strict=True))
    reach = np.array([np.isin(range(81), [z, *nx.descendants(graph, z)]) for z in range(81)])
    found = minimum_deployment(chain)
    assert reach[found].any(axis=0).all()
    assert found.size == minimum_cover(reach).chosen.size


@given(matrices())
def test_the_curve_is_greedy(matrix):
    reach = closure(matrix)
    chain = Chain.from_scipy(matrix)
    fewest = minimum_deployment(chain)
    found = coverage_curve(chain)
    expected = greedy_cover(reach[fewest])
    assert found.cells.tolist() == fewest[expected.chosen].tolist()
    assert found.covered.tolist() == np.cumsum(expected.gained).tolist()
    assert found.covered[-1] == len(matrix)
    assert set(found.cells) == set(fewest)


def test_the_curve_on_a_field():
    chain = sea(5, 15)
    reach = closure(chain.to_scipy().toarray())
    found = coverage_curve(chain)
    expected = greedy_cover(reach[minimum_deployment(chain)])
    assert found.covered.tolist() == np.cumsum(expected.gained).tolist()
    assert found.covered[0] == reach.sum(axis=1).max()


def water(wet, dx=1000.0, dy=1000.0):
    number = np.where(wet, np.cumsum(wet.ravel()).reshape(wet.shape) - 1, -1).astype(np.int32)
    plain = np.zeros(wet.shape)
    sides = [np.broadcast_to(side, wet.shape).astype(float) for side in (dx, dy)]
    return Water(number, *sides, plain, plain, plain, 0.0)


def staying(cells, group_of):
    """Persistent groups of a chain that goes around in each of the given groups."""
    image = np.arange(cells)
    for group in group_of:
        image[group] = np.roll(group, -1)
    return persistent_groups(Chain(image[None], np.ones((1, cells))))


@given(st.integers(0, 2**32 - 1), st.floats(0.8, 3.5))
def test_what_cameras_see(seed, reach):
    draw = np.random.default_rng(seed)
    wet = draw.random((5, 6)) < 0.8
    wet[2, 3] = True
    dy = draw.uniform(0.7, 1.1, (5, 1)) * 1000
    here = water(wet, 1000.0, dy)
    cells = here.cells
    sees = np.zeros((cells, cells), bool)
    for i, j in itertools.product(range(cells), repeat=2):
        corners = [
            (
                (here.column[j] + right - here.column[i]) * here.dx[here.row[i], here.column[i]],
                (here.row[j] + up - here.row[i]) * here.dy[here.row[i], here.column[i]],
            )
            for right, up in itertools.product((-0.5, 0.5), repeat=2)
        ]
        sees[i, j] = np.hypot(*np.transpose(corners)).max() <= reach * 1000
    found = visible_deployment(here, reach * 1000, staying(cells, []))
    assert found.cover.tolist() == greedy_cover(sees).chosen.tolist()
    assert sees[found.cover].any(axis=0).all()
    # Every cell is a group of its own: none is left out.
    np.testing.assert_array_equal(found.cells, found.cover)


def test_the_fewest_views_are_found_in_time():
    here = water(np.ones((7, 7), bool))
    groups = staying(49, [])
    greedy = visible_deployment(here, 1600.0, groups)
    found = visible_deployment(here, 1600.0, groups, seconds=20)
    assert greedy.least is None
    # A disc of 1600 m holds a cell and the four beside it: the domination number of a 7 x 7 grid
    # (OEIS A104519).
    assert found.least == found.cover.size == 12 < greedy.cover.size


def test_a_group_keeps_its_first_cell():
    here = water(np.ones((6, 6), bool))
    cover = visible_deployment(here, 1600.0, staying(36, [])).cover
    inside = np.sort(cover[2:5])
    found = visible_deployment(here, 1600.0, staying(36, [inside]))
    np.testing.assert_array_equal(found.cover, cover)
    np.testing.assert_array_equal(found.cells, np.delete(cover, [3, 4]))
    # Transient cells stay.
    image = np.full((1, 36), 35)
    leads = persistent_groups(Chain(image, np.ones((1, 36))))
    np.testing.assert_array_equal(visible_deployment(here, 1600.0, leads).cells, cover)


def test_refusals():
    groups = persistent_groups(sea(0, 3))
    here = water(np.ones((3, 3), bool))
    with pytest.raises(
        ValueError, match=r"707\.107 m or more, the distance to the corners of cell"
    ):
        visible_deployment(here, 700.0, groups)
    with pytest.raises(ValueError, match="reach: expected"):
        visible_deployment(here, np.nan, groups)
    with pytest.raises(ValueError, match="groups: expected those of 9 cells"):
        visible_deployment(here, 2000.0, persistent_groups(sea(0, 4)))
    large = water(np.ones((257, 256), bool))
    with pytest.raises(ValueError, match="more than 4 GiB"):
        visible_deployment(large, 2000.0, staying(257 * 256, []))
