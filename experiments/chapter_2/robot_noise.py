"""Measure how often a robot that slips is localized, by the size of its errors.

    python -m experiments.chapter_2.robot_noise

The robot of section 2.4 of Alam 2018 follows its model exactly. A real robot slips: here each step
and each turn has a random relative error, and the heading changes while the robot drives. The
encoders and the filter do not see these errors. A run ends in one of four ways:

- `right`: localized, and the robot is in one of the remaining cells;
- `wrong`: localized, but the robot is elsewhere;
- `refuted`: an observation was impossible on the map, so the robot knows that it is lost;
- `unfinished`: none of these after 300 observations, or the robot backed into a wall after a bump.

Runs begin at `--starts` random configurations of each map. The whole driver, with its commands and
its odometry, moves the emulated robot. On the maps of two labs the robot is a point among cells of
1 m. On `cafe` it is a disc of the size of a Create among cells of 25 cm, so the same slip leads it
into another cell sooner.

The script writes `robot_noise.csv`, `robot_noise.nc` and `robot_noise.png`. The exit status is 1 if
a robot that does not slip is not localized rightly.
"""

import concurrent.futures
import functools
import itertools
import math
import multiprocessing
import os
from pathlib import Path

import numpy as np
import xarray as xr

from jaxcell.automata import Filter, subset_construction
from jaxcell.record import save_dataset
from jaxcell.robot import FilterFollower, Walker, cell_strides, run_follower
from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.space import CellSpace, free_steps

from ..shared.data import MAPS
from ..shared.figures import plt, save
from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import Rows, emit, interval, say, tracked


CASES = [("lab_a", 45), ("lab_a", 135), ("lab_b", 45), ("lab_b", 135), ("cafe", 67.5)]
NOISE = (0.0, 0.0025, 0.005, 0.01, 0.02, 0.03, 0.05)
ENDS = ("right", "wrong", "refuted", "unfinished")
LIMIT = 300


@functools.cache
def problem(name: str, bounce_deg: float) -> tuple[CellSpace, Filter]:
    """Load the cells of a map, and make their filter by Eq. 2.4."""
    cells = CellSpace.load(MAPS / f"{name}.json")
    target = free_steps(cells)
    direction = np.arange(cells.directions)[:, None]
    turned = (direction + round(bounce_deg * cells.directions / 360)) % cells.directions
    bumped = target == np.arange(cells.positions)
    image = np.where(bumped, turned, direction) * cells.positions + target
    return cells, Filter.of(subset_construction(image.ravel().astype(np.int32), bumped.ravel()))


def run(name: str, bounce_deg: float, noise: float, start: int) -> tuple[str, int]:
    """Simulate a run, and return how it ends and its number of observations."""
    cells, filter = problem(name, bounce_deg)
    body = Body.in_cell(cells, start, noise, np.random.default_rng([0, start]))
    strides = cell_strides(cells.directions, cells.cell, cells.cell)
    direction = start // cells.positions
    walker = Walker(SimulatedCreate(body), cells.cell, strides=strides, direction=direction)
    try:
        outcome = run_follower(
            walker,
            FilterFollower(filter, "cycle", confirm=0),
            [math.radians(bounce_deg)],
            limit=LIMIT,
        )
    except RobotStopped:
        return "unfinished", len(walker.observations)
    if outcome.result != "localized":
        return outcome.result, len(outcome.observations)
    try:
        right = int(cells.index(*body.pose)) in outcome.cells
    except ValueError:
        right = False
    return "right" if right else "wrong", len(outcome.observations)


def runs(name: str, bounce_deg: float, noise: float, starts: int) -> tuple[np.ndarray, float]:
    """Count the runs by their ends, and average the observations of the localized runs."""
    size = problem(name, bounce_deg)[0].size
    drawn = np.random.default_rng(0).choice(size, min(starts, size), replace=False)
    ends = [run(name, bounce_deg, noise, start) for start in drawn.tolist()]
    count = np.array([sum(end == one for end, _ in ends) for one in ENDS])
    lengths = [length for end, length in ends if end in ("right", "wrong")]
    return count, float(np.mean(lengths)) if lengths else math.nan


def compute(starts: int, processes: int) -> xr.Dataset:
    """Simulate the runs of all maps and errors."""
    jobs = list(itertools.product(CASES, NOISE))
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(processes, spawn) as pool:
        # The longest jobs first, so that no process waits for one at the end.
        order = sorted(jobs, key=lambda job: -job[1])
        tasks = {(case, noise): pool.submit(runs, *case, noise, starts) for case, noise in order}
        results = [tasks[job].result() for job in tracked(jobs, "runs")]
    shape = len(CASES), len(NOISE)
    count = np.array([count for count, _ in results]).reshape(*shape, len(ENDS))
    length = np.array([length for _, length in results]).reshape(shape)
    right, total = count[..., 0].ravel().tolist(), count.sum(axis=-1).ravel().tolist()
    ends = np.array([interval(*one) for one in zip(right, total, strict=True)]).reshape(*shape, 2)
    mean = {"long_name": "mean number of observations of localized runs"}
    return xr.Dataset(
        {
            "runs": (("case", "noise", "end"), count, {"long_name": "number of runs by their end"}),
            "success": (("case", "noise", "bound"), ends, {"long_name": "95 % Wilson interval"}),
            "observations": (("case", "noise"), length, mean),
        },
        coords={
            "case": [f"{name}, {angle}°" for name, angle in CASES],
            "noise": ("noise", list(NOISE), {"long_name": "relative error, veer in rad/m"}),
            "end": list(ENDS),
            "bound": ["low", "high"],
        },
        attrs={"title": "Localization of a robot that slips", "starts": starts, "limit": LIMIT},
    )


def rows(results: xr.Dataset) -> Rows:
    """Tabulate the ends of runs by map and error."""
    table: Rows = []
    for case, noise in itertools.product(results.case.values, results.noise.values):
        one = results.sel(case=case, noise=noise)
        count = one.runs.values
        total = count.sum()
        low, high = (100 * one.success.values).tolist()
        right, *others = (100 * count / total).tolist()
        table.append(
            {
                "map and bounce": str(case),
                "noise, %": float(100 * noise),
                "runs": int(total),
                "right, %": right,
                "95 %, interval": f"{low:.1f} to {high:.1f}",
                **{f"{end}, %": share for end, share in zip(ENDS[1:], others, strict=True)},
                "observations": float(one.observations),
            }
        )
    return table


def draw(results: xr.Dataset, path: Path) -> None:
    """Draw the shares of the ends of runs against the error."""
    figure, panels = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained", sharey=True)
    colors, marks = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000"), "osD^v"
    noise = 100 * results.noise.values
    for index, case in enumerate(results.case.values):
        count = results.runs.sel(case=case).values
        share = 100 * count / count.sum(axis=1, keepdims=True)
        low, high = 100 * results.success.sel(case=case).values.T
        style = {"color": colors[index], "marker": marks[index], "markersize": 5}
        panels[0].fill_between(noise, low, high, color=colors[index], alpha=0.2, linewidth=0)
        panels[0].plot(noise, share[:, 0], label=str(case), **style)
        panels[1].plot(noise, share[:, 2], label=f"{case}, refuted", **style)
        panels[1].plot(noise, share[:, 1], label=f"{case}, wrong", **style, linestyle=":")
    panels[0].set_title("Localized rightly, with 95 % Wilson intervals", fontsize=10)
    panels[1].set_title("Refuted, and localized wrongly", fontsize=10)
    panels[0].set_ylabel("% of runs")
    for axes in panels:
        axes.set_xlabel("standard deviation of the relative error of steps and turns, %")
        axes.grid(color="0.9")
        axes.set_ylim(-2, 102)
        axes.legend(frameon=False, fontsize=8)
    save(figure, path)


def main() -> int:
    parser = experiment_parser(__doc__, "runs/chapter_2/robot_noise")
    parser.add_argument("--starts", type=at_least(1), default=40, help="runs per map and error")
    parser.add_argument("--processes", type=at_least(1), default=os.cpu_count())
    options = read_options(parser)

    results = compute(options.starts, options.processes)
    path = options.out / "robot_noise.csv"
    emit("Ends of runs", rows(results), path, spec=".1f", **{"noise, %": ".2f"})
    say(
        """For most errors, a robot that slips is refuted more often than it is localized wrongly:
        its observations fit no configuration of the map, so it knows that it is lost and can begin
        again. Wrong answers are not rare, because the filter has no model of the errors."""
    )
    save_dataset(results, options.out / "robot_noise.nc")
    draw(results, options.out / "robot_noise.png")
    print(f"Data and figure in {options.out}")
    still = results.runs.sel(noise=0.0)
    return 0 if bool((still.sel(end="right") == still.sum("end")).all()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
