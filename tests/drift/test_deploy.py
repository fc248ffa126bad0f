import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_chains import matrices, reachable as closure

from jaxcell import drift
from jaxcell.examples import water
from jaxcell.mapping import Chain, persistent_groups
from jaxcell.optimize import greedy_cover


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
    behaviour = drift.long_term_behaviour(Chain.from_scipy(matrix), 1)
    deployment = drift.deployment_cells(behaviour)
    part, reach = np.asarray(behaviour.transient.group), closure(matrix)
    assert deployment.cells.tolist() == by_definition(matrix, behaviour)
    assert reach[deployment.cells].any(axis=0).all()
    np.testing.assert_array_equal(
        deployment.group, np.asarray(behaviour.groups.group)[deployment.cells]
    )
    np.testing.assert_array_equal(deployment.transient_group, part[deployment.cells])
    assert deployment.gained.sum() == len(matrix)
    # Each transient group is covered by its own cells.
    for label in range(behaviour.transient.count):
        own = deployment.transient_group == label
        assert deployment.gained[own].sum() == (part == label).sum()
        assert reach[deployment.cells[own]][:, part == label].any(axis=0).all()


@given(matrices())
def test_no_smaller_deployment_reaches_all_cells(matrix):
    reach = closure(matrix)
    cells = range(len(matrix))
    found = drift.minimum_deployment(Chain.from_scipy(matrix))
    assert reach[found].any(axis=0).all()
    smaller = itertools.combinations(cells, found.size - 1)
    assert not any(reach[list(chosen)].any(axis=0).all() for chosen in smaller)


@given(matrices())
def test_the_curve_is_greedy(matrix):
    reach = closure(matrix)
    chain = Chain.from_scipy(matrix)
    fewest = drift.minimum_deployment(chain)
    curve = drift.coverage_curve(chain)
    expected = greedy_cover(reach[fewest])
    assert curve.cells.tolist() == fewest[expected.chosen].tolist()
    assert curve.covered.tolist() == np.cumsum(expected.gained).tolist()
    assert curve.covered[-1] == len(matrix)
    assert set(curve.cells) == set(fewest)


def staying(cells, group_of):
    """Persistent groups of a chain that goes around in each of the given groups."""
    image = np.arange(cells)
    for group in group_of:
        image[group] = np.roll(group, -1)
    return persistent_groups(Chain(image[None], np.ones((1, cells))))


@given(st.integers(0, 2**32 - 1), st.floats(0.8, 3.5))
def test_cameras_see_cells_wholly_within_their_disc(seed, reach):
    draw = np.random.default_rng(seed)
    wet = draw.random((5, 6)) < 0.8
    wet[2, 3] = True
    dy = draw.uniform(0.7, 1.1, (5, 1)) * 1000
    here = dataclasses.replace(water(wet), dy=np.broadcast_to(dy, wet.shape).copy())
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
    deployment = drift.visible_deployment(here, reach * 1000, staying(cells, []))
    assert deployment.cover.tolist() == greedy_cover(sees).chosen.tolist()
    assert sees[deployment.cover].any(axis=0).all()
    # Every cell is a group of its own: none is left out.
    np.testing.assert_array_equal(deployment.cells, deployment.cover)


def test_the_fewest_views_are_found_in_time():
    here = water(np.ones((7, 7), bool))
    groups = staying(49, [])
    greedy = drift.visible_deployment(here, 1600.0, groups)
    deployment = drift.visible_deployment(here, 1600.0, groups, seconds=20)
    assert greedy.least is None
    # A disc of 1600 m holds a cell and the four beside it: the domination number of a 7 x 7 grid
    # (OEIS A104519).
    assert deployment.least == deployment.cover.size == 12 < greedy.cover.size


def test_a_group_keeps_its_first_cell():
    here = water(np.ones((6, 6), bool))
    cover = drift.visible_deployment(here, 1600.0, staying(36, [])).cover
    inside = np.sort(cover[2:5])
    deployment = drift.visible_deployment(here, 1600.0, staying(36, [inside]))
    np.testing.assert_array_equal(deployment.cover, cover)
    np.testing.assert_array_equal(deployment.cells, np.delete(cover, [3, 4]))
    # Transient cells stay.
    image = np.full((1, 36), 35)
    leads = persistent_groups(Chain(image, np.ones((1, 36))))
    np.testing.assert_array_equal(drift.visible_deployment(here, 1600.0, leads).cells, cover)


@pytest.mark.parametrize(
    ("shape", "reach", "cells", "message"),
    [
        ((3, 3), 700.0, 9, r"707\.107 m or more, the distance to the corners of cell"),
        ((3, 3), np.nan, 9, "reach: expected"),
        ((3, 3), 2000.0, 16, "groups: expected those of 9 cells"),
        ((257, 256), 2000.0, 257 * 256, "more than 4 GiB"),
    ],
)
def test_views_out_of_range_are_refused(shape, reach, cells, message):
    with pytest.raises(ValueError, match=message):
        drift.visible_deployment(water(np.ones(shape, bool)), reach, staying(cells, []))
