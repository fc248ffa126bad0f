"""Time the first arrival of several robots: simulations, beside NumPy, and the exact law.

Run `python experiments/benchmarks/bench_arrival.py`; it takes about 10 s.

Three robots patrol the graph of `bench_commute.py` with 188 vertices, each with an emphasis of its
own, as in Alam 2018, section 4.5.3. They start in random cells, and each of 5,000 runs lasts until
one robot is in a target: one cell, or one of ten. One program in NumPy moves all remaining runs
together, step by step. The other is a plain loop over runs, steps and robots, timed on fewer runs.
`off` is the difference of the mean from the exact mean in standard errors.
"""

import statistics
from typing import Any

import jax
import numpy as np
from bench_commute import grid
from rows import Row, options, write_rows
from timing import begin, header, line, timed

from jaxcell.mapping import Chain
from jaxcell.markov import first_arrival, mean_first_arrival, simulate_arrival
from jaxcell.optimize import minimum_commute
from jaxcell.patrol import random_walk


RUNS = 5000
PLAIN_RUNS = 50
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
    """Simulate all runs together."""
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


def by_loop(
    image: np.ndarray, total: np.ndarray, outside: np.ndarray, there: np.ndarray, seed: int
) -> np.ndarray:
    """Simulate one run after another."""
    draw = np.random.default_rng(seed)
    taken = np.zeros(PLAIN_RUNS)
    for run in range(PLAIN_RUNS):
        place, step = draw.choice(outside, ROBOTS), 0
        while not there[place].any():
            for robot in range(ROBOTS):
                slot = np.searchsorted(total[robot, place[robot]], draw.random(), side="right")
                place[robot] = image[robot, place[robot], slot]
            step += 1
        taken[run] = step
    return taken


def row(
    target: int, program: str, seconds: list[float], ratio: float, mean: float, off: str
) -> None:
    times = (f"{min(seconds):.3f}", f"{statistics.median(seconds):.3f}", f"{ratio:.3g}")
    line(target, program, *times, f"{mean:.2f}", off)


def side_by_side(chains: list[Chain], target: np.ndarray, repeats: int) -> Row:
    """Time all programs for one target."""
    cells = chains[0].cells
    there = np.isin(np.arange(cells), target)
    outside = np.flatnonzero(~there)
    starts = [outside] * ROBOTS
    image, total = tables(chains)

    def simulated(seed: int) -> Any:
        return simulate_arrival(jax.random.key(seed), chains, starts, target, RUNS).time

    cold, _ = timed(lambda: simulated(0))
    ours = [timed(lambda seed=seed: simulated(seed)) for seed in range(1, repeats + 1)]
    batch = [
        timed(lambda seed=seed: by_batch(image, total, outside, there, seed))
        for seed in range(min(repeats, 3))
    ]
    plain, few = timed(lambda: by_loop(image, total, outside, there, 0))
    exact = mean_first_arrival(chains, starts, target).value
    least = min(seconds for seconds, _ in ours)

    def simulations(program: str, seconds: list[float], times: np.ndarray) -> None:
        error = times.std(ddof=1) / np.sqrt(times.size)
        off = f"{(times.mean() - exact) / error:+.1f}"
        row(len(target), program, seconds, min(seconds) / least, times.mean(), off)

    warm, steps = zip(*ours, strict=True)
    simulations("jaxcell, warm", list(warm), np.concatenate(steps))
    row(len(target), "jaxcell, first call", [cold], cold / least, exact, "")
    batch_s, steps = zip(*batch, strict=True)
    simulations("NumPy, batch", list(batch_s), np.concatenate(steps))
    simulations(f"NumPy, loop (x {RUNS // PLAIN_RUNS})", [plain * RUNS / PLAIN_RUNS], few)
    last = int(20 * exact)
    for program, solve in (
        ("exact mean", lambda: mean_first_arrival(chains, starts, target).value),
        (f"exact law to {last}", lambda: first_arrival(chains, starts, target, last)),
    ):
        seconds = [timed(solve)[0] for _ in range(repeats)]
        row(len(target), program, seconds, min(seconds) / least, exact, "")
    where = "one cell" if len(target) == 1 else f"any of {len(target)} cells"
    what = f"first of {ROBOTS} robots in {where}, {RUNS:,} runs"
    median, theirs = statistics.median(warm), statistics.median(batch_s)
    return Row("arrival", what, f"{cells} cells", median, "NumPy, all runs at once", theirs)


def main() -> None:
    arguments = options(__doc__, repeats=5).parse_args()
    begin("jax", "numpy")
    chains = patrol()
    header("targets", "program", "min, s", "median, s", "to ours", "mean steps", "off", words=2)
    targets = (np.arange(1), np.arange(60, 70))
    rows = [side_by_side(chains, target, arguments.repeats) for target in targets]
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
