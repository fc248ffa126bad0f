import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from jaxcell.mapping import periodic_groups
from jaxcell.mapping.peel import peeled_groups


def same(image):
    found, whole = peeled_groups(image), jax.device_get(periodic_groups(jnp.asarray(image)))
    count = int(whole.count)
    assert int(found.count) == count
    np.testing.assert_array_equal(found.group, whole.group)
    np.testing.assert_array_equal(found.step, whole.step)
    np.testing.assert_array_equal(found.group_period, whole.group_period[:count])
    np.testing.assert_array_equal(found.period, whole.period)


@given(st.lists(st.integers(0, 63), min_size=64, max_size=64))
def test_peeling_changes_nothing(images):
    same(np.array(images, np.int32))


@pytest.mark.parametrize("few", [0, 1 << 20])
def test_both_ways_of_doubling_give_the_same(monkeypatch, few):
    monkeypatch.setattr("jaxcell.mapping.peel._FEW", few)
    rng = np.random.default_rng(1)
    same(rng.integers(0, 3000, 3000).astype(np.int32))
    same(rng.permutation(3000).astype(np.int32))
    same(np.maximum(np.arange(3000, dtype=np.int32) - 1, 0))


def test_a_map_without_cells_has_no_groups():
    assert int(peeled_groups(np.zeros(0, np.int32)).count) == 0
