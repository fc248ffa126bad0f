"""Batches of chains that are divided among two devices."""

import json

import pytest
from helpers import python


SCRIPT = """
import json, sys
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)
from jax.sharding import AxisType, NamedSharding, PartitionSpec as P
from jaxcell import bounce, examples, mapping, markov

cells = examples.corridor(directions=24)
target = np.arange(cells.size) % cells.positions == 2
model = examples.line_model()
limits = np.array([0.4, 0.6, 0.8])


def chain_of(reliability):
    return bounce.noisy_bounce_map(cells, np.pi / 2, np.pi / 4, reliability)


def visits(reliability):
    chain = chain_of(reliability)
    groups = mapping.persistent_groups(chain)
    return markov.limiting_distribution(chain, groups).value, groups.period


def slope(reliability):
    mean = lambda r: markov.hitting_times(chain_of(r), target).value.mean()
    return jax.grad(mean)(reliability)


def policy(share):
    chain = markov.policy_chain(model, (limits < share).astype(np.int32))
    groups = mapping.persistent_groups(chain)
    return markov.limiting_distribution(chain, groups).value, markov.hitting_times(chain, 2).value


functions = {
    "visits": visits,
    "slope": slope,
    "policy": policy,
    "optimum": lambda discount: markov.value_iteration(model, discount).value,
    "slem": lambda share: markov.slem(mapping.Chain(
        np.array([[0, 0], [1, 1]]), jnp.array([[1 - share, 0.5], [share, 0.5]])
    )),
}
numbers = np.linspace(0.3, 0.95, 256)
rows = P("members")
found = {}
for name, function in functions.items():
    # Members are compared with a loop over a few of them, without a program on two devices.
    some = numbers[::51]
    expected = jax.tree.map(lambda *one: np.stack(one), *[jax.jit(function)(x) for x in some])
    for kind in (AxisType.Auto, AxisType.Explicit):
        mesh = jax.make_mesh((2,), ("members",), axis_types=(kind,))
        with jax.set_mesh(mesh):
            batch = jax.vmap(function)
            each = jax.shard_map(batch, in_specs=rows, out_specs=rows)
            given = jax.device_put(numbers, NamedSharding(mesh, rows))
            for way, program in (("jit", batch), ("shard_map", each)):
                result = jax.tree.leaves(jax.jit(program)(given))
                for one, other in zip(result, jax.tree.leaves(expected), strict=True):
                    np.testing.assert_allclose(np.asarray(one)[::51], other, rtol=1e-12)
                shares = {shard.data.shape[0] for x in result for shard in x.addressable_shards}
                found[f"{name} {way} {kind.name}"] = sorted(shares)
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def found():
    return json.loads(python("-c", SCRIPT)[0])


def test_each_device_keeps_its_chains_in_shard_map_or_if_types_tell(found):
    kept = {name: shares for name, shares in found.items() if "shard_map" in name or "Expl" in name}
    assert len(kept) == 15
    assert set(map(tuple, kept.values())) == {(128,)}


def test_batches_are_right_if_no_type_tells_how_they_are_divided(found):
    # The programs have been compared with single calls; every device has the whole result.
    assert found["visits jit Auto"] == [256]
