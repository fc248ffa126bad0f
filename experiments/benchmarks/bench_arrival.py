"""Time the first arrival of several robots: simulations, beside NumPy, and the exact law.

Run `python experiments/benchmarks/bench_arrival.py`; it takes about 10 s.

Three robots patrol the graph of `bench_commute.py` with 188 vertices, each with an emphasis of its
own, as in Alam 2018, section 4.5.3. They start in random cells, and each of 5,000 runs lasts until
one robot is in a target: one cell, or one of ten. The program in NumPy moves all remaining runs
together, step by step.
"""

import itertools

import jax
import numpy as np
from bench_commute import grid
from rows import Row, options, rows_of, write_rows
from timing import begin, table, take_turns

from jaxcell.mapping import Chain
from jaxcell.markov import first_arrival, mean_first_arrival, simulate_arrival
from jaxcell.optimize import minimum_commute
from jaxcell.patrol import random_walk


RUNS = 5000
ROBOTS = 3


def patrol() -> list[Chain]:
    """Make a chain for each robot."""
    graph = grid(15, 37)
    emphases = np.random.default_rng(0).permutation(graph.vertices)[: 6 * ROBOTS]
    found = [minimum_commute(graph, list(part)) for part in emphases.reshape(ROBOTS, 6)]
    return [random_walk(graph, each.weights) for each in found]


def tables(chains: list[Chain]) -> tuple[np.ndarray, np.ndarray]:
    """Tabulate the images and the cumulative probabilities, `[robots, cells, branches]`."""
    branches = max(len(chain.image) for chain in chains)
    image = np.zeros((len(chains), chains[0].cells, branches), int)
    total = np.ones((len(chains), chains[0].cells, branches))
    for robot, chain in enumerate(chains):
        some = len(chain.image)
        image[robot, :, :some] = np.asarray(chain.image).T
        total[robot, :, :some] = np.cumsum(np.asarray(chain.probability), axis=0).T
        total[robot, :, some - 1 :] = 1
        image[robot, :, some:] = image[robot, :, some - 1 : some]
    return image, total


def by_batch(
    image: np.ndarray, total: np.ndarray, outside: np.ndarray, there: np.ndarray, seed: int
) -> np.ndarray:
    """Simulate all runs together, and return the steps of each run."""
    draw = np.random.default_rng(seed)
    place = draw.choice(outside, (RUNS, ROBOTS))
    robot = np.arange(ROBOTS)
    taken = np.zeros(RUNS)
    left, step = np.arange(RUNS), 0
    while left.size:
        step += 1
        bound = total[robot, place]
        slot = (bound <= draw.random((left.size, ROBOTS, 1))).sum(axis=2)
        place = image[robot, place, slot]
        arrived = there[place].any(axis=1)
        taken[left[arrived]] = step
        left, place = left[~arrived], place[~arrived]
    return taken


def side_by_side(chains: list[Chain], target: np.ndarray, repeats: int) -> list[Row]:
    """Time simulations and exact solutions for one target."""
    cells = chains[0].cells
    there = np.isin(np.arange(cells), target)
    outside = np.flatnonzero(~there)
    starts = [outside] * ROBOTS
    image, total = tables(chains)
    exact = mean_first_arrival(chains, starts, target).value
    last, seeds = int(20 * exact), itertools.count()
    samples: dict[str, list[np.ndarray]] = {"jaxcell": [], "NumPy, all runs together": []}
    ours, theirs = samples.values()

    def simulated() -> None:
        key = jax.random.key(next(seeds))
        ours.append(np.asarray(simulate_arrival(key, chains, starts, target, RUNS).time))

    programs = {
        "jaxcell": simulated,
        "NumPy, all runs together": lambda: theirs.append(
            by_batch(image, total, outside, there, next(seeds))
        ),
        "exact mean": lambda: mean_first_arrival(chains, starts, target).value,
        f"exact law to {last}": lambda: first_arrival(chains, starts, target, last),
    }
    timings = take_turns(programs, repeats)
    where = "one cell" if len(target) == 1 else f"any of {len(target)} cells"
    what = f"first of {ROBOTS} robots in {where}, {RUNS:,} runs"
    table(what, timings)
    print(f"\nThe exact mean is {exact:.2f} steps.")
    for name, times in samples.items():
        steps = np.concatenate(times)
        off = (steps.mean() - exact) / (steps.std(ddof=1) / np.sqrt(steps.size))
        print(f"{name}: mean {steps.mean():.2f}, {off:+.1f} standard errors from the exact mean")
    simulations = {name: timings[name] for name in samples}
    return rows_of("arrival", what, f"{cells} cells", simulations)


def main() -> None:
    arguments = options(__doc__, repeats=5).parse_args()
    begin("jax", "numpy")
    chains = patrol()
    rows = []
    for target in (np.arange(1), np.arange(60, 70)):
        rows += side_by_side(chains, target, arguments.repeats)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
