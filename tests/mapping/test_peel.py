import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from jaxcell.mapping import periodic_groups
from jaxcell.mapping.peel import peeled_groups


def same(image):
    found, whole = peeled_groups(image), jax.device_get(periodic_groups(image))
    count = int(whole.count)
    assert int(found.count) == count
    np.testing.assert_array_equal(found.group, whole.group)
    np.testing.assert_array_equal(found.step, whole.step)
    np.testing.assert_array_equal(found.group_period, whole.group_period[:count])
    np.testing.assert_array_equal(found.period, whole.period)


@given(st.lists(st.integers(0, 63), min_size=64, max_size=64))
def test_peeling_changes_nothing(images):
    same(np.array(images, np.int32))


@pytest.mark.parametrize("front", [0, 200])
def test_one_front_after_another_changes_nothing(monkeypatch, front):
    monkeypatch.setattr("jaxcell.mapping.peel._FRONT", front)
    rng = np.random.default_rng(1)
    same(rng.integers(0, 3000, 3000).astype(np.int32))
    same(rng.permutation(3000).astype(np.int32))
    same(np.maximum(np.arange(3000, dtype=np.int32) - 1, 0))
    # Runs of 30 cells, which come together in others.
    cells = np.arange(3000)
    same(np.where(cells % 30 < 29, cells + 1, rng.integers(0, 3000, 3000)).astype(np.int32))


def test_large_maps_are_peeled_and_small_or_traced_ones_doubled(monkeypatch):
    image = jnp.asarray(np.random.default_rng(2).integers(0, 3000, 3000).astype(np.int32))
    doubled = periodic_groups(image)
    monkeypatch.setattr("jaxcell.mapping.peel._MANY", 3000)
    monkeypatch.setattr("jaxcell.mapping.peel.doubled_groups", None)
    peeled = periodic_groups(image)
    for one, other in zip(jax.tree.leaves(doubled), jax.tree.leaves(peeled), strict=True):
        np.testing.assert_array_equal(one, other, strict=True)
    with pytest.raises(TypeError):
        jax.jit(periodic_groups)(image)


def test_a_map_without_cells_has_no_groups():
    assert int(peeled_groups(np.zeros(0, np.int32)).count) == 0
