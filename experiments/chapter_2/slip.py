"""Compare estimators of the place of a robot that slips, on the physics of the emulator.

    python -m experiments.chapter_2.slip

A point robot with one bouncing angle makes `--observations` observations, starting from a random
cell. Each straight piece and each turn has a random relative error, and the heading changes by the
same error in radians per metre. The emulator moves its body in continuous time and space; with
`--driver` through the driver, its commands and frames, which is a hundred times slower. No
estimator knows the start or the errors. Three estimators follow the same runs:

- `combinatorial`: the filter of section 2.4, whose model has no slip;
- `belief`: the 95 % credible set of a belief among fine cells; with `--models`, on `--few` runs,
  also for models whose errors differ from those of the robot by a factor;
- `particles`: Monte Carlo localization with `--particles` particles, on `--few` runs.

The columns are the share of runs whose answer contains the robot at the end, with its 95 % Wilson
interval (a refuted run does not count); the probability that the estimator gives to its answer; the
size of the answer in cells; the share of refuted runs; the share of runs whose answer had at most
`--small` cells at some bump, and the mean number of bumps until then; and the time of an
observation with its answer on one core. Runs that begin with the same observations share their
computation. Runs and answers are kept in a folder per case and are not computed again.

The results below are for 500 runs: the percentage of answers that contain the robot, the mean
number of cells of runs that are not refuted, and the mean number of bumps until the answer has at
most four cells, if half of the runs come so far. None of these runs was used to make the models.

The filter:

| errors | lab_a | lab_b | complex | depot |
| --- | --- | --- | --- | --- |
| 0 % | 100 1.1 4.2 | 100 1.0 2.9 | 100 1.1 2.6 | 100 1.0 3.2 |
| 1 % | 71.6 1.2 4.2 | 24.4 1.0 2.9 | 40.0 1.1 2.6 | 27.6 1.1 3.2 |
| 2 % | 22.8 1.2 4.1 | 6.2 1.0 2.9 | 10.4 1.1 2.6 | 7.6 1.2 3.2 |
| 5 % | 0.6 1.5 4.1 | 0.0 1.0 3.0 | 0.4 1.1 2.5 | 0.4 1.2 3.2 |
| 10 % | 0.0 - | 0.0 - 2.9 | 0.0 1.0 2.5 | 0.0 - 3.0 |

The belief; in brackets is the probability of its 95 % credible sets, which is larger if a single
cell has more than 95 %:

| errors | lab_a | lab_b | complex | depot |
| --- | --- | --- | --- | --- |
| 0 % | 100 (100) 1.2 4.2 | 100 (99.8) 1.0 3.1 | 100 (97.1) 2.0 2.7 | 100 (97.6) 1.3 3.4 |
| 1 % | 98.4 (98.7) 1.4 4.6 | 99.6 (98.3) 1.4 3.2 | 99.0 (96.5) 5.4 4.0 | 98.0 (97.2) 2.9 4.8 |
| 2 % | 98.2 (97.2) 3.1 6.2 | 97.8 (97.2) 2.7 3.6 | 95.8 (95.9) 10.6 4.8 | 97.6 (96.5) 5.2 6.7 |
| 5 % | 96.4 (96.1) 10.4 12.2 | 95.2 (96.2) 6.5 10.8 | 96.0 (95.1) 106 | 94.8 (95.1) 67.5 |
| 10 % | 95.0 (95.2) 45.6 | 95.2 (95.4) 21.4 | 96.6 (95.0) 369 | 98.4 (95.0) 526 |

The probability of the sets lies in the interval of the runs, at most 2.4 % to either side, for
errors of 2 and 5 %, and of 10 % except on `depot`. There, and at 1 % on `lab_b` and `complex`, the
sets contain the robot 1.3 to 3.4 % more often than their probability, because fine cells of 14 and
33 cm at 1 %, and of a metre at 10 %, scatter a robot more than its errors do. With 284,000 fine
cells of 33 cm, the sets of `depot` at 10 % contain it in 97.0 % of 100 runs (91.5 to 99.0), and
have 258 cells in place of 526. At 0 % the model of the belief has errors of 0.2 %.

A belief whose model has half of the errors, on 100 runs:

| errors | lab_a | lab_b | complex | depot |
| --- | --- | --- | --- | --- |
| 2 % | 82.0 (97.6) 1.7 5.1 | 91.0 (98.4) 1.5 3.2 | 87.0 (96.6) 5.9 4.1 | 93.0 (97.3) 3.4 5.4 |
| 5 % | 78.0 (96.9) 5.4 11.4 | 76.0 (97.1) 4.0 5.3 | 72.0 (95.6) 18.6 | 87.0 (95.7) 11.7 |

A belief whose model has twice the errors, on 100 runs:

| errors | lab_a | lab_b | complex | depot |
| --- | --- | --- | --- | --- |
| 2 % | 100 (96.6) 5.1 9.4 | 100 (96.6) 4.9 7.5 | 99.0 (95.4) 39.7 | 96.0 (95.4) 24.3 |
| 5 % | 99.0 (95.4) 35.7 | 98.0 (95.4) 17.8 | 100 (95.0) 365 | 99.0 (95.0) 443 |

A thousand particles, on 500 runs, which are too few for maps of 1,464 and 1,504 cells:

| errors | lab_a | lab_b | complex | depot |
| --- | --- | --- | --- | --- |
| 0 % | 100 1.1 4.2 | 100 1.0 2.9 | 69.6 1.1 2.5 | 67.6 1.0 2.9 |
| 1 % | 95.2 1.3 4.3 | 98.8 1.2 3.1 | 60.8 2.7 2.7 | 60.6 1.9 3.1 |
| 2 % | 90.8 2.4 5.5 | 96.0 2.1 3.2 | 51.2 4.5 3.4 | 49.4 2.8 3.6 |
| 5 % | 74.2 5.7 11.9 | 81.6 4.9 7.7 | 42.2 13.2 | 31.8 6.2 7.4 |
| 10 % | 60.0 19.1 | 76.0 13.3 | 30.6 49.1 | 18.0 27.4 |

Ten thousand particles at 2 %, on 100 runs, contain the robot in 96, 100, 90 and 85 % of runs, at
probabilities of 97 or 98 %, with 2.5, 2.1, 5.3 and 3.2 cells, and take 6 to 12 ms per observation.
This is some ten times as long as the belief, whose sets are up to twice as large but contain the
robot as often as their probability.

On a shared machine, an observation with its answer takes the belief a mean of 0.9 to 1.1 ms of the
processor, with 92,000 to 97,000 fine cells; a thousand particles take 0.8 to 3.1 ms, and the filter
0.01 ms.

With `--driver`, a wall behind the robot stops 8 of 160 runs at 2 %, 40 on each map. The belief
contains the robot in 150 of the other 152 runs, 98.7 % (95.3 to 99.6): 97.1 % on `lab_a`, 97.4 % on
`lab_b` and 100 % on the others, with as many cells as without the driver. The filter does in 26.
"""

import argparse
import dataclasses
import functools
import itertools
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxcell.automata import Belief, Estimate
from jaxcell.automata.belief import NOWHERE
from jaxcell.bounce import FineCells, bounce_map, localization_filter, slip_map
from jaxcell.robot import Particles
from jaxcell.robot.emulation.body import bumper_give
from jaxcell.space import CellSpace, Slip, nearest_cell

from ..shared.data import MAPS
from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import Rows, emit, interval, say
from .slip_runs import Run, run


NAMES = ("lab_a", "lab_b", "complex", "depot")
ERRORS = (0.0, 0.01, 0.02, 0.05, 0.1)
ESTIMATORS = ("combinatorial", "belief", "particles")
TABLES = {
    "truth": ("runs", "holds, %", "interval", "says, %", "refuted, %"),
    "size": ("cells, median", "cells, mean", "small, %", "bumps, mean", "ms"),
}
# Without slip, a model still needs errors, because of rounding.
_LEAST = 0.002


@dataclasses.dataclass
class Answers:
    """The final answer of an estimator in each run of a case, and the time of each observation."""

    held: list[bool] = dataclasses.field(default_factory=list)
    said: list[float] = dataclasses.field(default_factory=list)
    "The probability that the estimator gives to its answer."
    size: list[int] = dataclasses.field(default_factory=list)
    refuted: list[bool] = dataclasses.field(default_factory=list)
    bumps: list[float] = dataclasses.field(default_factory=list)
    "The number of bumps until the answer was small, or infinity."
    seconds: list[float] = dataclasses.field(default_factory=list)

    def row(self) -> dict[str, Any]:
        low, high = interval(sum(self.held), len(self.held))
        reached = [b for b in self.bumps if math.isfinite(b)]
        kept = [s for s, r in zip(self.size, self.refuted, strict=True) if not r]
        return {
            "runs": len(self.held),
            "holds, %": 100 * float(np.mean(self.held)),
            "interval": f"{100 * low:.1f} to {100 * high:.1f}",
            "says, %": 100 * float(np.mean(self.said)),
            "cells, median": float(np.median(kept)) if kept else math.nan,
            "cells, mean": float(np.mean(kept)) if kept else math.nan,
            "refuted, %": 100 * float(np.mean(self.refuted)),
            "small, %": 100 * len(reached) / len(self.bumps),
            "bumps, mean": float(np.mean(reached)) if reached else math.nan,
            "ms": 1e3 * float(np.mean(self.seconds)),
        }


def follow(estimator: Any, cells: CellSpace, runs: list[Run], small: int) -> Answers:
    """Collect the answers of an estimator in runs.

    **Arguments:**

    - `estimator`: an object with the methods `start`, `observe` and `estimate`.
    - `small`: most cells of a small answer.
    """
    found, states, estimates = Answers(), [estimator.start()], []
    before: list[int] = []
    # States and estimates are reused for the first observations, if two runs have the same ones.
    for one in sorted(runs, key=lambda one: [observation for observation, _ in one]):
        word = [observation for observation, _ in one]
        pairs = enumerate(zip(word, before, strict=False))
        alike = next((i for i, (a, b) in pairs if a != b), len(before))
        del states[1 + alike :], estimates[alike:]
        before = word
        for observation in word[alike:]:
            began = time.process_time()
            states.append(estimator.observe(states[-1], observation))
            estimates.append(estimator.estimate(states[-1]))
            found.seconds.append(time.process_time() - began)
        bumps = itertools.accumulate(word)
        few = (b for b, e in zip(bumps, estimates, strict=True) if 0 < e.cells.size <= small)
        truth = int(nearest_cell(cells, *one[-1][1]))
        refuted = estimates[-1].nowhere > NOWHERE
        found.held.append(truth in estimates[-1].cells and not refuted)
        found.said.append(float(estimates[-1].probability.sum()))
        found.size.append(estimates[-1].cells.size)
        found.refuted.append(refuted)
        found.bumps.append(next(few, math.inf))
    return found


class Combinatorial:
    """A filter with the methods of the other estimators."""

    def __init__(self, filter: Any) -> None:
        self.filter = filter

    def start(self) -> int:
        return 0

    def observe(self, state: int, observation: int) -> int:
        return -1 if state < 0 else int(self.filter.transition[state, observation])

    def estimate(self, state: int) -> Estimate:
        cells = np.empty(0, np.int32) if state < 0 else self.filter.cells(state)
        return Estimate(cells, np.full(cells.size, 1 / max(1, cells.size)), float(state < 0))


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_2/slip", seed=60_000)
    parser.add_argument("--maps", nargs="+", default=NAMES)
    parser.add_argument("--errors", nargs="+", type=float, default=ERRORS)
    parser.add_argument("--estimators", nargs="+", choices=ESTIMATORS, default=ESTIMATORS)
    parser.add_argument("--bounce", type=float, default=135.0, help="bouncing angle, degrees")
    parser.add_argument("--runs", type=at_least(1), default=500)
    parser.add_argument(
        "--few", type=at_least(1), default=100, help="runs for other models, sets and particles"
    )
    parser.add_argument("--observations", type=at_least(1), default=40)
    parser.add_argument("--particles", type=at_least(1), default=1_000)
    parser.add_argument(
        "--models", type=float, nargs="+", default=[1.0, 0.5, 2.0], help="factors of the errors"
    )
    parser.add_argument("--small", type=at_least(1), default=4, help="most cells of a small answer")
    parser.add_argument("--driver", action="store_true", help="move the robot through the driver")
    options = read_options(parser)
    jax.config.update("jax_enable_x64", True)
    rows: Rows = []
    for error, name in itertools.product(options.errors, options.maps):
        cells = CellSpace.load(MAPS / f"{name}.json")
        case = {"map": name, "error, %": 100 * error}
        about = f"{name}_{error:g}_{options.seed}_{options.runs}{'_driver' * options.driver}"
        for what, found in estimated(cells, error, options, options.out / about):
            rows.append({**case, "estimator": what, **found.row()})
    for title, columns in TABLES.items():
        part = [{name: row[name] for name in (*case, "estimator", *columns)} for row in rows]
        emit(title, part, options.out / f"slip_{title}.csv", spec=".1f")
    say("A refuted run never counts as an answer that contains the robot.")


def estimated(
    cells: CellSpace, error: float, options: argparse.Namespace, out: Path
) -> Iterator[tuple[str, Answers]]:
    """Yield each estimator of a case with its answers."""
    bounce, give = math.radians(options.bounce), bumper_give(cells.cell)
    seeds = range(options.seed, options.seed + options.runs)
    runs = kept(
        out / "runs.json",
        lambda: [
            run(cells, bounce, error, seed, limit=options.observations, driver=options.driver)
            for seed in seeds
        ],
    )
    # The driver stops a robot that backs into a wall, and such runs are not used.
    runs = [one for one in runs if len(one) == options.observations]

    def answers(name: str, make: Callable[[], Any], count: int) -> tuple[str, Answers]:
        def followed() -> dict[str, Any]:
            return dataclasses.asdict(follow(make(), cells, runs[:count], options.small))

        return name, Answers(**kept(out / f"{name}, {count} runs.json", followed))

    def slipping(factor: float) -> Slip:
        return Slip.of(max(_LEAST, min(1.0, factor * error)), give=give)

    def among_fine(name: str, make: Callable[[FineCells, Slip], Any], factor: float) -> Any:
        slip, count = slipping(factor), len(runs) if factor == 1 else options.few
        fine = FineCells.within(cells, slip)
        return answers(f"{name}, {fine.size:,} cells", functools.partial(make, fine, slip), count)

    if "combinatorial" in options.estimators:
        yield answers(
            "combinatorial",
            lambda: Combinatorial(localization_filter(bounce_map(cells, bounce))),
            len(runs),
        )
    if "belief" in options.estimators:
        for factor in options.models if error else [1.0]:
            model = "" if factor == 1 else f", x {factor:g}"
            yield among_fine(
                f"belief{model}", lambda fine, slip: Belief(slip_map(fine, [bounce], slip)), factor
            )
    if "particles" in options.estimators:
        cloud = functools.partial(Particles, cells, bounce, slipping(1.0), count=options.particles)
        yield answers(f"particles, {options.particles:,}", cloud, options.few)


def kept(path: Path, make: Callable[[], Any]) -> Any:
    """Read a result from its file, or compute it and write the file."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        made = json.dumps(make())
        path.write_text(made, encoding="utf-8")
    return json.loads(path.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
