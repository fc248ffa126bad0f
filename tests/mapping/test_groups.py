import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from oracles.simple_maps import simple_map_groups

from jaxcell.mapping import Section, periodic_groups, section_cycles
from jaxcell.mapping.groups import follow, periodic_cells


# The same number as in the tests of peeling, so that programs are compiled once.
CELLS = 64


@st.composite
def functional_graphs(draw):
    # Of one size, since each is compiled once. Few images make short transients and many groups.
    images = st.integers(0, draw(st.sampled_from([0, 2, CELLS - 1])))
    drawn = draw(st.lists(images | st.none(), min_size=CELLS, max_size=CELLS))
    return np.array([z if image is None else image for z, image in enumerate(drawn)], np.int32)


def assert_groups_of(image, groups):
    group, step, period = simple_map_groups(image)
    np.testing.assert_array_equal(groups.group, group)
    np.testing.assert_array_equal(groups.step, step)
    np.testing.assert_array_equal(groups.period, period[group])
    np.testing.assert_array_equal(groups.periodic, step == 0)
    assert int(groups.count) == period.size


@given(functional_graphs())
def test_groups_equal_alg_2_1_and_stay_on_the_host(image):
    group, step, _ = simple_map_groups(image)
    smallest = np.array([np.flatnonzero((group == g) & (step == 0))[0] for g in group])
    periodic = periodic_cells(image)
    leader, steps = follow(image, periodic, np.ones_like(image))
    assert {type(x) for x in (periodic, leader, steps)} == {np.ndarray}
    np.testing.assert_array_equal(periodic, step == 0)
    np.testing.assert_array_equal(leader, smallest)
    np.testing.assert_array_equal(steps, step)
    groups = jax.device_get(periodic_groups(image))
    assert type(groups.period) is np.ndarray
    assert_groups_of(image, groups)


@pytest.mark.parametrize("cells", [1, 2, 3000])
def test_one_long_cycle_and_one_long_transient(cells):
    around = np.roll(np.arange(cells), -1).astype(np.int32)
    assert np.asarray(periodic_groups(around).period)[0] == cells
    chain = np.maximum(np.arange(cells) - 1, 0).astype(np.int32)
    np.testing.assert_array_equal(periodic_groups(chain).step, np.arange(cells))


def test_groups_work_under_vmap():
    rng = np.random.default_rng(0)
    images = rng.integers(0, 30, (7, 30)).astype(np.int32)
    batch = jax.device_get(jax.vmap(periodic_groups)(images))
    for i, image in enumerate(images):
        assert_groups_of(image, jax.tree.map(lambda x, i=i: np.asarray(x[i]), batch))


def section_of(image, chosen, slots):
    """The first-return map to chosen cells; the first slot of every cell, and the way to it."""
    slot_of = {int(z): s for s, z in enumerate(chosen)}

    def walk(z):
        lowest, mappings = z, 0
        while z not in slot_of:
            z, mappings = int(image[z]), mappings + 1
            lowest = min(lowest, z)
        return slot_of[z], mappings, lowest

    returns = [walk(int(image[z])) for z in chosen]
    successor, duration, lowest = np.arange(slots), np.ones(slots), np.zeros(slots)
    for s, (to, mappings, low) in enumerate(returns):
        successor[s], duration[s], lowest[s] = to, mappings + 1, low
    section = Section(
        *jax.device_put([x.astype(np.int32) for x in (successor, duration, lowest)]),
        live=jax.device_put(np.arange(slots) < len(chosen)),
    )
    entries = np.array([walk(z)[:2] for z in range(len(image))])
    return section, entries[:, 0], entries[:, 1]


@given(functional_graphs(), st.data())
def test_section_gives_the_groups_of_all_cells(image, data):
    group, step, group_period = simple_map_groups(image)
    periodic = np.flatnonzero(step == 0)
    more = data.draw(st.sets(st.sampled_from(range(len(image)))))
    # Every cycle has to meet the section, and outside it the map has to be one-to-one.
    chosen = more | {int(periodic[group[periodic] == g][-1]) for g in range(group_period.size)}
    for z in range(len(image)):
        chosen |= set(np.flatnonzero(image == z)[1:].tolist())
    # Few sizes, since each is compiled once.
    slots = CELLS + 3
    section, slot, wait = section_of(image, sorted(chosen), slots)
    fields = jax.tree.leaves(section_cycles(section))
    leader, leads, lead, period, lowest = map(np.asarray, fields)
    leaders = np.flatnonzero(leads)
    leaders = leaders[np.argsort(lowest[leaders])]
    number = np.full(slots, -1)
    number[leaders] = np.arange(leaders.size)
    np.testing.assert_array_equal(number[leader[slot]], group)
    np.testing.assert_array_equal(np.maximum(0, wait + lead[slot]), step)
    np.testing.assert_array_equal(period[leaders], group_period)


def test_batch_of_sections_equals_one_by_one():
    rng = np.random.default_rng(1)
    images = rng.integers(0, 30, (5, 30)).astype(np.int32)
    sections = [section_of(image, range(30), 32)[0] for image in images]
    batch = jax.vmap(section_cycles)(jax.tree.map(lambda *x: jnp.stack(x), *sections))
    for i, section in enumerate(sections):
        for stacked, alone in zip(
            *map(jax.tree.leaves, (batch, section_cycles(section))), strict=True
        ):
            np.testing.assert_array_equal(stacked[i], alone)
