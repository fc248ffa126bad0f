"""Time an observation of the estimators of a robot that slips.

Run `python experiments/benchmarks/bench_slip.py`; it takes half a minute.

The belief has at most 50,000 fine cells of `lab_a`. The estimators follow runs of 40 observations
of an emulated body with errors of 2 %. Each time includes the estimate after the observation. The
table has wall-clock times and times of the processor, because on a busy machine only the latter are
meaningful.
"""

import math
import sys
import time
from typing import Any

import numpy as np
from rows import Row, options, write_rows
from timing import begin, header, line

from experiments.chapter_2.slip_runs import run
from experiments.shared.data import MAPS
from jaxcell.automata import Belief
from jaxcell.bounce import FineCells, slip_map
from jaxcell.robot import Particles
from jaxcell.robot.emulation.body import bumper_give
from jaxcell.space import CellSpace, Slip


BOUNCE, ERROR, MAX_CELLS = math.radians(135), 0.02, 50_000
MAX_S = 0.005


def estimators(cells: CellSpace) -> dict[str, tuple[str, Any]]:
    """Make the estimators, each with its size as text."""
    give = bumper_give(cells.cell)
    slip = Slip.of(ERROR, give=give)
    fine = FineCells.within(cells, slip, MAX_CELLS)
    return {
        "belief": (f"{fine.size:,} cells", Belief(slip_map(fine, [BOUNCE], slip))),
        "particles": ("1,000 particles", Particles(cells, BOUNCE, slip, count=1_000)),
    }


def observed(estimator: Any, words: list[list[int]]) -> np.ndarray:
    """Time each observation with its estimate, by the clock and by the processor, in seconds.

    The result is an array `[observations, 2]`.
    """
    found = []
    for word in words:
        state = estimator.start()
        for observation in word:
            began = time.perf_counter(), time.process_time()
            state = estimator.observe(state, observation)
            estimator.estimate(state)
            found.append((time.perf_counter() - began[0], time.process_time() - began[1]))
    return np.array(found)


def main() -> None:
    arguments = options(__doc__, repeats=10).parse_args()
    begin("numpy", "scipy")
    cells = CellSpace.load(MAPS / "lab_a.json")
    runs = [
        run(cells, BOUNCE, ERROR, seed, limit=40, driver=False) for seed in range(arguments.repeats)
    ]
    words = [[observation for observation, _ in one] for one in runs]
    names = ("median, ms", "99 %", "worst", "processor: median", "99 %", "worst")
    header("estimator", "size", *names, words=2)
    rows = []
    for name, (size, estimator) in estimators(cells).items():
        # The first calls fill caches.
        observed(estimator, [[0], [1]])
        wall, processor = observed(estimator, words).T
        shown = [f"{1e3 * f(one):.2f}" for one in (wall, processor) for f in (np.median, p99, max)]
        line(name, size, *shown)
        rows.append(Row("slip", f"an observation, {name}", size, float(np.median(wall))))
        verdict = "under" if p99(processor) < MAX_S else "NOT UNDER"
        print(f"{name}: 99 % are {verdict} {1e3 * MAX_S:g} ms of the processor", file=sys.stderr)
    write_rows(arguments.rows, rows)


def p99(seconds: np.ndarray) -> float:
    return float(np.quantile(seconds, 0.99))


if __name__ == "__main__":
    main()
