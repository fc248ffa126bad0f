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

# Values and gradients of quantities of a small chain, with 2 members on each of 2 devices.
GRADIENTS = """
import json
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)
from jax.sharding import NamedSharding, PartitionSpec as P
from jaxcell import bounce, examples, mapping, markov, optimize, patrol

image = np.array([[1, 2, 0], [0, 1, 2]])
weights = np.array([1.0, 0.5, 0.3])
cells = examples.corridor(directions=8)
rooms = patrol.Graph([(0, 1), (1, 2), (2, 0), (2, 3)])
near = rooms.matrix(np.ones(4)).toarray() > 0
even = near / near.sum(axis=1, keepdims=True)
key = jax.random.key(0)
dense = markov.dense


def chain(p):
    return mapping.Chain(image, jnp.stack([p * weights, 1 - p * weights]))


def model(p):
    return markov.DecisionModel.of([chain(p), chain(p / 2)], p * np.array([weights, weights**2]))


def chosen(p):
    return markov.policy_chain(model(p), jnp.where(p * weights > 0.4, 1, 0))


def sized(p):
    return (markov.limiting_distribution(chain(p), weights="size").value ** 2).sum()


def seeded(p):
    key = jax.random.key((100 * p).astype(int))
    return markov.simulate_arrival(key, [chain(p)], [0], 2, runs=9).time.sum()


def both(p):
    found = markov.limiting_distribution(chain(p))
    return found.value[0] + p * found.weights.sum() + found.leaving


def coverage(p):
    return bounce.coverage_policy(cells, [jnp.pi / 2, jnp.pi], jnp.pi / 4, p).distance


def capture(p):
    walk = p * even + (1 - p) * np.eye(4)
    return patrol.walks.walk_capture_probabilities(rooms, walk, attack_time=4)[0, 3]


def blind(p):
    return patrol.walks.blind_capture(rooms, [p * even + (1 - p) * np.eye(4)], 2).min()


def weighted(p):
    return patrol.random_walk(rooms, p * np.arange(4.0) + 1).push(np.eye(4)[0])[1]


def mixed(p):
    columns = jnp.stack([p * weights, 1 - p * weights], axis=1)
    return optimize.mixture(columns, np.array([0.2, 0.4, 0.1])).distance


def pair(p, starts):
    # The second robot begins in cell 1, the first in a cell that depends on the member.
    return [jnp.stack([p, 1 - p, 0 * p]), 1] if starts == "own" else starts


def mean(starts):
    return lambda p: markov.mean_first_arrival([chain(p)] * 2, pair(p, starts), 2).value


def simulated(starts):
    return lambda p: markov.simulate_arrival(
        key, [chain(p)] * 2, pair(p, starts), 2, runs=9
    ).time.sum()


def arrival(starts, chain=chain):
    return lambda p: (markov.first_arrival([chain(p)] * 2, pair(p, starts), 2, 5) ** 2).sum()


apart = markov.Distinct([0, 1])
functions = {
    "first_passage": lambda p: (markov.first_passage(chain(p), 0, 2, 5) ** 2).sum(),
    "first_passage of a policy": lambda p: markov.first_passage(chosen(p), 0, 2, 5).sum(),
    "first_arrival": arrival([0, 1]),
    "first_arrival, distinct": arrival(apart),
    "first_arrival, own starts": arrival("own"),
    "first_arrival of a policy": arrival([0, 1], chosen),
    "limiting_distribution": lambda p: (markov.limiting_distribution(chain(p)).value ** 2).sum(),
    "limiting_distribution, all": both,
    "limiting_distribution, sizes": sized,
    "limiting_distribution of a policy": lambda p: markov.limiting_distribution(chosen(p)).value[0],
    "hitting_times of a policy": lambda p: markov.hitting_times(chosen(p), 2).value.sum(),
    "entropy_rate": lambda p: markov.entropy_rate(chain(p)),
    "coverage_policy": coverage,
    "mixture": mixed,
    "kemeny_constant": lambda p: markov.kemeny_constant(chain(p)),
    "commute_times": lambda p: markov.commute_times(chain(p)).value.sum(),
    "hitting_matrix": lambda p: (markov.hitting_matrix(chain(p)).value ** 2).sum(),
    "value_iteration": lambda p: markov.value_iteration(model(p), 0.9).value.sum(),
    "value_iteration, discount": lambda p: markov.value_iteration(model(0.5), p).value.sum(),
    "shortest_path": lambda p: markov.stochastic_shortest_path(model(p), 2).time.sum(),
    "walk_capture_probabilities": capture,
    "blind_capture": blind,
    "random_walk": weighted,
    "mean_first_arrival": mean([0, 1]),
    "mean_first_arrival, distinct": mean(apart),
    "mean_first_arrival, own starts": mean("own"),
    "simulate_arrival": simulated([0, 1]),
    "simulate_arrival, distinct": simulated(apart),
    "simulate_arrival, own starts": simulated("own"),
    "simulate_arrival, own keys": seeded,
    "push": lambda p: chosen(p).push(weights).sum(),
    "pull": lambda p: chosen(p).pull(weights).sum(),
    "dense.stationary": lambda p: dense.stationary(dense.matrix(chain(p)))[0],
    "dense.hitting": lambda p: dense.hitting(dense.matrix(chain(p))).sum(),
    "dense.kemeny": lambda p: dense.kemeny(dense.matrix(chain(p))),
    "dense.entropy_rate": lambda p: dense.entropy_rate(dense.matrix(chain(p))),
}
numbers = np.array([0.55, 0.65, 0.75, 0.85])
rows = P("members")
mesh = jax.make_mesh((2,), ("members",))
found = {}
for name, function in functions.items():
    slope = jax.value_and_grad(function)
    alone = jax.jit(slope)
    expected = np.array([alone(p) for p in numbers]).T
    with jax.set_mesh(mesh):
        batch = jax.vmap(slope)
        given = jax.device_put(numbers, NamedSharding(mesh, rows))
        each = jax.shard_map(batch, in_specs=rows, out_specs=rows)
        for way, program in (("jit", batch), ("shard_map", each)):
            result = jax.jit(program)(given)
            np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-14, err_msg=name)
            shares = {shard.data.shape[0] for x in result for shard in x.addressable_shards}
            found[f"{name} {way}"] = sorted(shares)
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


def test_values_and_gradients_are_those_of_single_calls_if_types_tell_how_a_batch_is_divided():
    found = json.loads(python("-c", GRADIENTS)[0])
    assert len(found) == 72
    assert set(map(tuple, found.values())) == {(2,)}
