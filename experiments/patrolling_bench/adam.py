"""Search for a walk with memory by Adam alone, on a graph whose ways all take one step."""

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxcell.patrol import Graph


STEPS, STARTS, RATE = 4000, 4, 0.003
# Inverse temperature of the soft minimum, at first and at last.
COLD = 8.0, 1500.0
# Moves with a smaller probability are left out.
LITTLE = 1e-4


def best_walk(graph: Graph, attack: int, memory: int) -> np.ndarray:
    """Search from random starts for a walk that moves in each step.

    **Returns:** array `[states, states]`, whose states are pairs of a state of the memory and a
    vertex; the vertex varies fastest.
    """
    near = [[] for _ in range(graph.vertices)]
    for a, b in np.concatenate([graph.edges, graph.edges[:, ::-1]]).tolist():
        near[a].append(b)
    most = max(map(len, near))
    ways = np.array([row + [0] * (most - len(row)) for row in near])
    exists = np.arange(most) < np.array([[len(row)] for row in near])
    there = jnp.asarray(np.eye(graph.vertices)[ways], jnp.float32)
    shape = memory, graph.vertices, most, memory

    def chances(free: jax.Array) -> jax.Array:
        masked = jnp.where(exists[None, :, :, None], free, -1e9)
        return jax.nn.softmax(masked.reshape(memory, graph.vertices, -1)).reshape(shape)

    def reached(free: jax.Array) -> jax.Array:
        chance = chances(free)
        found = jnp.zeros((memory, graph.vertices, graph.vertices), jnp.float32)
        for _ in range(attack):
            then = there + (1 - there) * found[:, ways]
            found = jnp.einsum("mnde,endj->mnj", chance, then)
        return found

    optimizer = optax.adam(RATE)

    @jax.jit
    def step(free: jax.Array, state: optax.OptState, cold: float) -> tuple[jax.Array, object]:
        slope = jax.grad(lambda free: jax.nn.logsumexp(-cold * reached(free)) / cold)(free)
        change, state = optimizer.update(slope, state)
        return optax.apply_updates(free, change), state

    best, least = None, -1.0
    for seed in range(STARTS):
        free = jax.random.normal(jax.random.key(seed), shape, jnp.float32)
        state = optimizer.init(free)
        for cold in np.geomspace(*COLD, STEPS):
            free, state = step(free, state, jnp.float32(cold))
        if (now := float(reached(free).min())) > least:
            best, least = np.asarray(chances(free), float), now
    matrix = np.zeros((memory, graph.vertices, memory, graph.vertices))
    for vertex, row in enumerate(near):
        matrix[:, vertex][:, :, row] = best[:, vertex, : len(row)].transpose(0, 2, 1)
    matrix = matrix.reshape(memory * graph.vertices, -1)
    matrix = np.where(matrix > LITTLE, matrix, 0.0)
    return matrix / matrix.sum(axis=1, keepdims=True)
