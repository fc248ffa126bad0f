"""Batches of maps that are divided among two devices."""

import json

import pytest
from helpers import python


SCRIPT = """
import json
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)
from jax.sharding import AxisType, NamedSharding, PartitionSpec as P
from jaxcell import bounce, examples, mapping

images = np.random.default_rng(0).integers(0, 30, (6, 30)).astype(np.int32)
groups = [mapping.periodic_groups(image) for image in images]
expected = jax.tree.map(lambda *one: np.stack(one), *groups)
batch = jax.vmap(mapping.periodic_groups)
auto = jax.make_mesh((2,), ("maps",), axis_types=(AxisType.Auto,))
explicit = jax.make_mesh((2,), ("maps",), axis_types=(AxisType.Explicit,))
cells = examples.corridor(directions=6)
angles = np.arange(6) * np.pi / 3


def periods(angle):
    return mapping.periodic_groups(bounce.bounce_map(cells, angle).image).period


expected_periods = [np.stack([periods(angle) for angle in angles])]
own = jax.shard_map(batch, mesh=auto, in_specs=P("maps"), out_specs=P("maps"))


def run(function, images, mesh, *axes, expected=expected):
    with jax.set_mesh(mesh):
        program = jax.jit(function)
        images = jax.device_put(images, NamedSharding(mesh, P(*axes)))
        found = program(images)
        text = program.lower(images).compile().as_text()
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(np.reshape(one, other.shape), other)
    shapes = [[shard.data.shape for shard in x.addressable_shards] for x in jax.tree.leaves(found)]
    return shapes, "all-gather" in text


print(json.dumps({
    "jit": run(batch, images, auto, "maps"),
    "shard_map": run(own, images, auto, "maps"),
    "explicit": run(batch, images, explicit, "maps"),
    "nested": run(jax.vmap(batch), images.reshape(3, 2, 30), auto, None, "maps"),
    "cells": run(batch, images, auto, None, "maps"),
    "angles": [
        run(jax.vmap(periods), angles, mesh, "maps", expected=expected_periods)
        for mesh in (auto, explicit)
    ],
}))
"""


@pytest.fixture(scope="module")
def found():
    return json.loads(python("-c", SCRIPT)[0])


@pytest.mark.parametrize("way", ["jit", "shard_map", "explicit"])
def test_each_device_finds_the_groups_of_its_maps_and_keeps_them(way, found):
    shapes, gathered = found[way]
    assert shapes == [[[3, 30]] * 2] * 3 + [[[3]] * 2]
    assert not gathered


def test_nested_batches_stay_divided(found):
    assert found["nested"] == [[[[3, 1, 30]] * 2] * 3 + [[[3, 1]] * 2], False]


def test_maps_that_are_divided_by_cells_are_gathered(found):
    assert found["cells"][1]


def test_angles_are_divided_from_the_map_to_the_periods(found):
    (shapes, gathered), other = found["angles"]
    cells = shapes[0][0][1]
    assert shapes == other[0] == [[[3, cells]] * 2]
    assert not gathered
    assert not other[1]
