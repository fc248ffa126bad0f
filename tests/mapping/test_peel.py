import tracemalloc

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from jaxcell.mapping import peel, periodic_groups
from jaxcell.mapping.groups import doubled_groups
from jaxcell.mapping.walk import walked_groups


def assert_equal(groups, expected):
    for field, other in zip(jax.tree.leaves(groups), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(field, other, strict=True)


def assert_same_groups(image):
    doubled = doubled_groups(jnp.asarray(image))
    assert_equal(peel.peeled_groups(image), doubled)
    assert_equal(walked_groups(jnp.asarray(image)), doubled)


@given(st.lists(st.integers(0, 63), min_size=64, max_size=64))
def test_peeling_and_walking_equal_doubling(images):
    assert_same_groups(np.array(images, np.int32))


@pytest.mark.parametrize("front", [0, 200])
def test_peeling_by_fronts_equals_doubling(monkeypatch, front):
    monkeypatch.setattr("jaxcell.mapping.peel.FRONT", front)
    rng = np.random.default_rng(1)
    assert_same_groups(rng.integers(0, 3000, 3000).astype(np.int32))
    assert_same_groups(rng.permutation(3000).astype(np.int32))
    assert_same_groups(np.maximum(np.arange(3000, dtype=np.int32) - 1, 0))
    # Runs of 30 cells, which end in other runs.
    cells = np.arange(3000)
    assert_same_groups(
        np.where(cells % 30 < 29, cells + 1, rng.integers(0, 3000, 3000)).astype(np.int32)
    )


def test_only_maps_that_lose_many_cells_are_peeled(monkeypatch):
    rng = np.random.default_rng(2)
    random, permuted = rng.integers(0, 64_000, 64_000), rng.permutation(64_000)
    peeled = []

    def of_peeled(image):
        peeled.append(image)
        return walked_groups(image)

    monkeypatch.setattr("jaxcell.mapping.peel.MANY", 64_000)
    monkeypatch.setattr("jaxcell.mapping.peel.peeled_groups", of_peeled)
    for image in (random, permuted):
        periodic_groups(image)
        jax.jit(periodic_groups)(image)
    (once,) = peeled
    np.testing.assert_array_equal(once, random)


@pytest.mark.parametrize("of", [np.ones((4, 5000)), np.ones(5000)])
def test_walk_compiles_to_one_machine_code_function(of):
    # Otherwise arrays are copied, or passed from kernel to kernel, in each step of a loop.
    walk = walked_groups if of.ndim == 1 else jax.vmap(walked_groups)
    compiled = jax.jit(walk).lower(of.astype(np.int32)).compile().as_text()
    assert compiled.count("xla_cpu_small_call") >= 2
    loops = [line for line in compiled.split("ENTRY")[1].splitlines() if " while(" in line]
    # The loop over the maps of a batch, at most.
    assert len(loops) <= of.ndim - 1


def test_map_without_cells_has_no_groups():
    assert int(periodic_groups(np.zeros(0, np.int32)).count) == 0


def test_peeling_takes_16_bytes_per_cell_beside_map_and_groups(monkeypatch):
    monkeypatch.setattr("jaxcell.mapping.peel.PART", 1 << 12)
    cells = 1 << 18
    image = np.random.default_rng(4).integers(0, cells // 2, cells, np.int32)
    peel.groups_on_host(image)
    tracemalloc.start()
    try:
        groups = peel.groups_on_host(image)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak - groups.group.nbytes - groups.step.nbytes <= 16 * cells
