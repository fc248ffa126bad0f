"""Measure the filters that Table 2.3 of the source compares in words, under three noises.

    python -m experiments.chapter_2.filters_compared

A point robot with a bouncing angle of 135 degrees drives among the walls of the emulator, which
moves its body in continuous time and space. Each straight piece and each turn has a normal relative
error, and the heading changes by the same error in radians per root of a metre. No estimator sees
the errors. Three estimators follow the same robots cell by cell, from random cells, with the
heading known to the walker:

- `filter of cells`: the filter of section 2.4, whose model has no errors;
- `belief`: the 95 % credible set of a belief among fine cells, whose model has the errors;
- `particles`: Monte Carlo localization with `--particles` particles and the same errors.

`sets on walls` follow robots that drive from wall to wall, with a heading of the map at the start,
and measure their runs. Their bounds are three standard deviations.

A run ends as soon as the answer is small: at most `--small` cells, or for sets an extent of at most
two metres. It is `right` if the answer contains the robot, otherwise `wrong`. A run is `lost` if
the observations are impossible, and `unfinished` after `--observations` observations, or `--bumps`
bumps of a robot of the sets.

`bumps` is the mean number of bumps until a right or wrong answer, `bytes` the size of the arrays of
the estimator and its last state, and `us` the median time of the processor per observation with its
answer, after the first five observations.
"""

import math
import time
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxcell.automata import Belief
from jaxcell.automata.belief import NOWHERE
from jaxcell.bounce import FineCells, bounce_map, localization_filter, slip_map
from jaxcell.robot import AnywhereSettings, Particles, Walker
from jaxcell.robot.anywhere import SetFollower
from jaxcell.robot.emulation.body import Body, Noise, bumper_give
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.space import CellSpace, Slip, nearest_cell
from jaxcell.walls import Errors, WallFilter, places_anywhere

from ..shared.data import MAPS
from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import Rows, emit, interval
from .physics_localization import is_held
from .slip import Combinatorial
from .slip_runs import Run, run


BOUNCE = math.radians(135)
NOISES = (0.001, 0.003, 0.01)
ENDS = ("right", "wrong", "lost", "unfinished")
# The observations that are not timed, because functions are compiled in them.
UNTIMED = 5
# The push of the bumper in metres, and the bounds of a run and of its start that it causes.
GIVE, DISTANCE, DISPLACEMENT = 0.02, 0.05, 0.06


class Ended(NamedTuple):
    """The end of a run."""

    end: str
    bumps: int
    seconds: list[float]
    bytes: int


def bytes_of(thing: Any, seen: set[int] | None = None) -> int:
    """Add the bytes of all arrays that an object holds, each array once."""
    seen = set() if seen is None else seen
    if id(thing) in seen or callable(thing) or isinstance(thing, type):
        return 0
    seen.add(id(thing))
    if isinstance(thing, (np.ndarray, jax.Array)):
        return int(thing.nbytes)
    if isinstance(thing, dict):
        parts = list(thing.values())
    elif isinstance(thing, (list, tuple)):
        parts = list(thing)
    else:
        parts = list(getattr(thing, "__dict__", {}).values())
    return sum(bytes_of(part, seen) for part in parts)


def follow(estimator: Any, cells: CellSpace, one: Run, small: int) -> Ended:
    """Follow a robot cell by cell until the answer is small."""
    state, bumps, seconds = estimator.start(), 0, []
    for observation, pose in one:
        began = time.process_time()
        state = estimator.observe(state, observation)
        estimate = estimator.estimate(state)
        seconds.append(time.process_time() - began)
        bumps += observation
        if estimate.nowhere > NOWHERE:
            return Ended("lost", bumps, seconds, bytes_of((estimator, state)))
        if estimate.cells.size <= small:
            right = int(nearest_cell(cells, *pose)) in estimate.cells
            end = "right" if right else "wrong"
            return Ended(end, bumps, seconds, bytes_of((estimator, state)))
    return Ended("unfinished", bumps, seconds, bytes_of((estimator, state)))


def filter_of_sets(cells: CellSpace, noise: float) -> WallFilter:
    """Build the sets on walls for errors of at most three standard deviations."""
    diameter = float(np.hypot(*np.ptp(cells.room.boundary, axis=0)))
    errors = Errors(
        run=3 * noise,
        distance=DISTANCE,
        turn=3 * noise * (BOUNCE + math.sqrt(diameter)),
        displacement=DISPLACEMENT,
    )
    return WallFilter.of(cells.room, headings=cells.directions, errors=errors)


def run_sets(filter: WallFilter, cells: CellSpace, noise: float, seed: int, bumps: int) -> Ended:
    """Follow a robot from wall to wall until its sets are small."""
    rng = np.random.default_rng([31, seed])
    x, y = places_anywhere(cells.room, 1, rng)[0].tolist()
    heading = float(rng.integers(cells.directions)) * math.tau / cells.directions
    errors = Noise(distance=noise, rotation=noise, veer=noise)
    body = Body(cells.room, (x, y, heading), give=GIVE, noise=errors, rng=rng)
    walker = Walker(DirectBody(body), cells.cell)
    follower = SetFollower(AnywhereSettings(filter, (BOUNCE,), radius=1.0, confirm=0))
    seconds, end = [], "unfinished"
    for _ in range(bumps):
        length = walker.run_to_wall(2 * filter.boundary.diameter, DISPLACEMENT / 2)
        began = time.process_time()
        follower.observe(length)
        seconds.append(time.process_time() - began)
        if follower.result == "refuted":
            end = "lost"
            break
        if follower.result == "localized":
            end = "right" if is_held(follower, body.pose, DISPLACEMENT) else "wrong"
            break
        began = time.process_time()
        follower.turn(BOUNCE)
        seconds[-1] += time.process_time() - began
        walker.rotate(BOUNCE)
    return Ended(end, follower.bumps, seconds, bytes_of((filter, follower.state)))


def row(name: str, noise: float, by: str, runs: list[Ended]) -> dict[str, Any]:
    """Summarize the runs of an estimator."""
    count = {end: sum(one.end == end for one in runs) for end in ENDS}
    low, high = interval(count["right"], len(runs))
    ended = [one.bumps for one in runs if one.end in ("right", "wrong")]
    late = [second for one in runs for second in one.seconds[UNTIMED:]]
    return {
        "map": name,
        "noise, %": 100 * noise,
        "by": by,
        "bytes": max(one.bytes for one in runs),
        "us": 1e6 * float(np.median(late)) if late else math.nan,
        "runs": len(runs),
        "right, %": 100 * count["right"] / len(runs),
        "95 %, interval": f"{100 * low:.0f} to {100 * high:.0f}",
        **{f"{end}, %": 100 * count[end] / len(runs) for end in ENDS[1:]},
        "bumps": float(np.mean(ended)) if ended else math.nan,
    }


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_2/filters_compared", seed=70_000)
    parser.add_argument("--maps", nargs="+", default=["lab_b"])
    parser.add_argument("--noises", nargs="+", type=float, default=NOISES)
    parser.add_argument("--runs", type=at_least(1), default=100)
    parser.add_argument("--observations", type=at_least(1), default=80)
    parser.add_argument("--bumps", type=at_least(1), default=80)
    parser.add_argument("--small", type=at_least(1), default=4, help="most cells of a small answer")
    parser.add_argument("--particles", type=at_least(1), default=10_000)
    options = read_options(parser)
    jax.config.update("jax_enable_x64", True)
    rows: Rows = []
    seeds = range(options.seed, options.seed + options.runs)
    for name in options.maps:
        cells = CellSpace.load(MAPS / f"{name}.json")
        for noise in options.noises:
            limit = options.observations
            robots = [run(cells, BOUNCE, noise, seed, limit=limit, driver=False) for seed in seeds]
            slip = Slip.of(noise, give=bumper_give(cells.cell))
            fine = FineCells.within(cells, slip)
            estimators = {
                "filter of cells": Combinatorial(localization_filter(bounce_map(cells, BOUNCE))),
                "belief": Belief(slip_map(fine, [BOUNCE], slip)),
                "particles": Particles(cells, BOUNCE, slip, count=options.particles),
            }
            for by, estimator in estimators.items():
                ends = [follow(estimator, cells, one, options.small) for one in robots]
                rows.append(row(name, noise, by, ends))
            filter = filter_of_sets(cells, noise)
            ends = [run_sets(filter, cells, noise, seed, options.bumps) for seed in seeds]
            rows.append(row(name, noise, "sets on walls", ends))
            print(*rows[-4:], sep="\n", flush=True)
    emit(
        "Filters under three noises",
        rows,
        options.out / "filters_compared.csv",
        spec=".1f",
        us=".0f",
    )


if __name__ == "__main__":
    main()
