"""Time batches of chains, as `vmap` computes them, beside a loop over the same chains.

    python experiments/benchmarks/bench_batches.py

The chains are noisy bounce maps with different reliabilities. Every program computes persistent
groups, the limiting distribution and the hitting times of a cell. A batch of decision models has
different discounts: quantecon solves some of them, one after the other, and jaxdp, whose matrices
are dense, some of them together. README.md explains the rest.
"""

import math
import sys
from typing import Any

import chex
import jax
import jax.numpy as jnp
import jaxdp.mdp
import jaxdp.planning
import numpy as np
from bench_decision import TOLERANCE, with_quantecon
from rows import Row, options, rows_of, write_rows
from timing import Timing, begin, table, take_turns

from jaxcell.bounce import noisy_bounce_map
from jaxcell.mapping import Chain, persistent_groups
from jaxcell.markov import (
    DecisionModel,
    dense,
    hitting_times,
    limiting_distribution,
    value_iteration,
)
from jaxcell.space import CellSpace, Workspace


# Maps, numbers of directions, and numbers of chains.
MAPS = ("lab_a", 8, 1000), ("complex", 8, 300), ("complex", 24, 100)
# Number of members of a batch that the loop computes; times are per member.
MEMBERS = 20
# Largest relative difference of two results.
AGREEMENT = 1e-9


def noisy(cells: CellSpace, reliability: Any) -> Chain:
    return noisy_bounce_map(cells, math.pi / 2, 2 * math.pi / cells.directions, reliability)


def room(name: str, directions: int) -> tuple[CellSpace, int]:
    """Return the cells of a map, and a cell of a persistent group."""
    cells = CellSpace.of(Workspace.load(f"data/maps/{name}.json"), 1, directions)
    group = persistent_groups(noisy(cells, 0.8)).group
    return cells, int(np.flatnonzero(np.asarray(group) == 0)[0])


def agree(found: Any, truth: Any, agreement: float = AGREEMENT) -> None:
    for one, other in zip(found, truth, strict=True):
        scale = np.abs(other).max()
        if not np.abs(np.asarray(one) - np.asarray(other)).max() <= agreement * scale:
            sys.exit("a batch and a loop disagree")


def reliabilities(name: str, directions: int, members: int, repeats: int) -> list[Row]:
    cells, target = room(name, directions)

    def quantities(reliability: Any) -> tuple[jax.Array, jax.Array]:
        chain = noisy(cells, reliability)
        limit = limiting_distribution(chain, persistent_groups(chain))
        return limit.value, hitting_times(chain, target).value

    batch = jax.jit(jax.vmap(quantities))
    each = np.linspace(0.5, 0.95, members)
    few = each[:: members // MEMBERS]

    def check(results: dict[str, Any]) -> None:
        found, loop = results.values()
        for member, truth in enumerate(loop):
            agree([part[member * (members // MEMBERS)] for part in found], truth)

    programs = {
        "jaxcell, vmap": lambda: batch(each),
        "loop over members": lambda: [quantities(float(one)) for one in few],
    }
    timings = per_member(take_turns(programs, repeats, check), members, few.size)
    size = f"{cells.size:,} cells x {members:,}"
    table(f"Limiting distribution and hitting times per member, {size}", timings)
    what = "limiting distribution and hitting times per member of a batch"
    return rows_of("batches", what, size, timings)


def per_member(timings: dict[str, Timing], *members: int) -> dict[str, Timing]:
    return {
        program: Timing(*(seconds / count for seconds in timing))
        for (program, timing), count in zip(timings.items(), members, strict=True)
    }


def with_jaxdp(model: DecisionModel) -> Any:
    # Its checks refuse traced discounts.
    chex.disable_asserts()
    steps = np.stack([chain.to_scipy().toarray() for chain in model.chains])
    states = jnp.zeros(model.cells)
    reward = jnp.broadcast_to(model.reward[:, :, None], steps.shape)
    problem = jaxdp.mdp.MDP(
        transition=steps.transpose(0, 2, 1), reward=reward, initial=states, terminal=states
    )

    def values(discount: Any) -> Any:
        solver = jaxdp.planning.ValueIteration(gamma=discount)

        def go_on(carry: Any) -> Any:
            state, change = carry
            enough = TOLERANCE * jnp.maximum(1, jnp.abs(state.v_val).max())
            return jnp.abs(change).max() * discount / (1 - discount) > enough

        def sweep(carry: Any) -> Any:
            after = solver.update(problem, carry[0])
            return after, after.v_val - carry[0].v_val

        start = solver.init(problem), jnp.full(model.cells, jnp.inf)
        return discount * jax.lax.while_loop(go_on, sweep, start)[0].v_val

    return jax.jit(jax.vmap(values))


def discounts(repeats: int) -> list[Row]:
    """Time the best way of a robot to a cell, which turns by one of four angles at each wall."""
    cells, target = room("lab_a", 32)
    chains = [noisy_bounce_map(cells, k * math.pi / 4, math.pi / 8, 0.8) for k in range(1, 5)]
    reward = np.where(np.arange(cells.size) == target, 0.0, -1.0)
    model = DecisionModel.of(chains, np.tile(reward, (4, 1)))
    each = np.linspace(0.8, 0.99, 1000)
    few = each[:: each.size // MEMBERS]
    batch = jax.jit(jax.vmap(lambda one: value_iteration(model, one, TOLERANCE).value))
    solver, of_jaxdp = "modified_policy_iteration", with_jaxdp(model)

    def check(results: dict[str, Any]) -> None:
        found, *others = results.values()
        for other in others:
            agree(found[:: each.size // MEMBERS], other, TOLERANCE * 10)

    programs = {
        "jaxcell, vmap": lambda: batch(each),
        "quantecon, loop": lambda: [
            one * with_quantecon(model, None, float(one), solver)() for one in few
        ],
        "jaxdp, vmap": lambda: of_jaxdp(few),
    }
    timings = per_member(take_turns(programs, repeats, check), each.size, few.size, few.size)
    size = f"{cells.size} cells x {each.size:,}"
    table(f"Value iteration per member, {size}", timings)
    return rows_of("batches", "value iteration per member of a batch of discounts", size, timings)


def dense_chains(repeats: int) -> list[Row]:
    weights = np.random.default_rng(0).random((32, 256, 256))
    matrices = jnp.asarray(weights / weights.sum(axis=-1, keepdims=True))

    def quantities(P: jax.Array) -> tuple[jax.Array, jax.Array]:
        return dense.stationary(P), dense.hitting(P)

    one, batch = jax.jit(quantities), jax.jit(jax.vmap(quantities))
    programs = {
        "jaxcell, vmap": lambda: batch(matrices),
        "loop over members": lambda: [one(P) for P in matrices],
    }

    def check(results: dict[str, Any]) -> None:
        found, loop = results.values()
        agree(found, [np.stack(parts) for parts in zip(*loop, strict=True)])

    timings = take_turns(programs, repeats, check)
    table("Dense chains, 256 cells x 32", timings)
    what = "stationary distributions and hitting times of dense chains"
    return rows_of("batches", what, "256 cells x 32", timings)


def gradient(repeats: int) -> list[Row]:
    cells, target = room("complex", 240)
    chain = noisy(cells, 0.8)
    weight = jnp.asarray(np.random.default_rng(0).standard_normal(chain.cells))

    def total(probability: jax.Array) -> jax.Array:
        return weight @ hitting_times(Chain(chain.image, probability), target).value

    both = jax.jit(jax.value_and_grad(total))
    programs = {
        "jaxcell, value and gradient": lambda: both(chain.probability)[0],
        "the value alone": lambda: total(chain.probability),
    }
    timings = take_turns(programs, repeats, lambda found: agree(*([x] for x in found.values())))
    size = f"{chain.cells:,} cells"
    table(f"Value and gradient of hitting times, {size}", timings)
    return rows_of("batches", "value and gradient of hitting times", size, timings)


def main() -> None:
    arguments = options(__doc__, repeats=3).parse_args()
    begin("jax", "numpy", "scipy", "quantecon", "jaxdp")
    rows = [row for size in MAPS for row in reliabilities(*size, arguments.repeats)]
    for more in (discounts, dense_chains, gradient):
        rows += more(arguments.repeats)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
