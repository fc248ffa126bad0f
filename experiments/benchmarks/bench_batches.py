"""Time batches of chains, as `vmap` computes them, beside a loop over the same chains.

    python experiments/benchmarks/bench_batches.py

The chains are noisy bounce maps with different reliabilities. Every program computes persistent
groups, the limiting distribution and the hitting times of a cell. README.md explains the rest.
"""

import math
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rows import Row, options, rows_of, write_rows
from timing import begin, table, take_turns

from jaxcell.bounce import noisy_bounce_map
from jaxcell.mapping import Chain, persistent_groups
from jaxcell.markov import dense, hitting_times, limiting_distribution
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


def agree(found: Any, truth: Any) -> None:
    for one, other in zip(found, truth, strict=True):
        scale = np.abs(other).max()
        if not np.abs(np.asarray(one) - np.asarray(other)).max() <= AGREEMENT * scale:
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
    timings = {
        program: type(timing)(*(seconds / count for seconds in timing))
        for (program, timing), count in zip(
            take_turns(programs, repeats, check).items(), (members, few.size), strict=True
        )
    }
    size = f"{cells.size:,} cells x {members:,}"
    table(f"Limiting distribution and hitting times per member, {size}", timings)
    what = "limiting distribution and hitting times per member of a batch"
    return rows_of("batches", what, size, timings)


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
    begin("jax", "numpy", "scipy")
    rows = [row for size in MAPS for row in reliabilities(*size, arguments.repeats)]
    rows += dense_chains(arguments.repeats) + gradient(arguments.repeats)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
