"""Five estimators on a Create 2 in a physics engine: right, wrong or lost.

    python -m experiments.chapter_2.physics_localization --maps lab_b --runs 20

What a user learns before buying a robot. On each map, with the true radius of a Create 2, `jaxcell
localize` makes a filter of one bouncing angle, a policy and a belief of two, a belief that knows by
how much a bump turns the robot, and sets on walls for a robot that starts anywhere at any heading.
A cloud of particles slips as that belief does, with the angle of the filter. Each then localizes a
robot in MuJoCo, through the driver. All but the sets start from the centre of a random cell, with
the heading known to the walker. A run ends

- `right`: localized, with the place of the robot among those that are left;
- `wrong`: localized, and it is elsewhere;
- `lost`: it observed what cannot be on the map, or the driver stopped it;
- `unfinished`: neither after `--limit` observations.

Bumps and seconds of the robot are means over the runs that were localized. `holds` is the share of
all observations after which the answer (the cells of a filter or a policy, the 95 % credible set of
a belief or of particles, the sets on walls) has the robot in it; each run counts once. The runs of
all maps and estimators take turns, and `localization.csv` is written after each turn of `--turn`
runs, so that a run of this script that is cut off leaves a table.
"""

import argparse
import concurrent.futures
import dataclasses
import functools
import itertools
import math
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxcell.robot import Particles, Walker, cell_strides, load_task
from jaxcell.robot.anywhere import SetFollower
from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.emulation.body import bumper_give
from jaxcell.robot.emulation.emulator import Emulator, Line
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.followers import BeliefFollower, FilterFollower, PolicyFollower
from jaxcell.robot.physics import LATENCY, RADIUS, PhysicsBody
from jaxcell.space import CellSpace, Slip, Workspace, nearest_cell
from jaxcell.walls import places_anywhere

from ..shared.data import MAPS
from ..shared.report import Rows, emit


SLIP, BUMP_TURN = 0.01, 2.0
BOUNDS = "run=0.01 distance=0.05 turn=3 displacement=0.06"
PARTICLES, ANYWHERE = "particles, bumps turn them", "sets on walls, from anywhere"
ESTIMATORS = {
    "filter, 135°": (["--bounce", "135"], "filter.jxf"),
    "policy, 45° and 135°": (["--bounces", "45", "135"], "policy.jxf"),
    "belief, 45° and 135°": (["--bounces", "45", "135", "--slip", str(SLIP)], "belief.jxb"),
    "belief, bumps turn it": (
        ["--bounces", "45", "135", "--slip", str(SLIP), "--bump-turn", str(BUMP_TURN)],
        "belief.jxb",
    ),
    PARTICLES: (["--bounce", "135"], "filter.jxf"),
    ANYWHERE: (
        "--bounces 45 100 135 --anywhere --heading unknown --measured --robots 1 --radius 0.5 "
        f"--errors {BOUNDS}".split(),
        "anywhere.json",
    ),
}
ENDS = ("right", "wrong", "lost", "unfinished")


class Run(NamedTuple):
    """The end of a run."""

    end: str
    bumps: int
    seconds: float
    holds: float


class ParticleFollower(BeliefFollower):
    """Particles along a run with one bouncing angle."""

    @property
    def turn(self) -> int | None:
        bumped = self.observations[-1:] == "1"
        return 0 if bumped and self.result != "refuted" else None


def make(name: str, estimator: str, out: Path) -> Path:
    """Make the file of an estimator of a map by the command, unless the file exists."""
    options, file = ESTIMATORS[estimator]
    folder = out / "files" / f"{name}, {estimator}"
    if not (folder / file).exists():
        command = [sys.executable, "-m", "jaxcell", "localize", str(MAPS / f"{name}.json")]
        command += [*options, "--robot-radius", str(RADIUS), "--out", str(folder)]
        # A policy that cannot tell all cells apart has status 1.
        subprocess.run(command, check=False, capture_output=True)
    return folder / file


@functools.cache
def problem(path: Path, name: str) -> tuple[Any, CellSpace]:
    """Read a task, and make the cells of its map."""
    task = load_task(path)
    workspace = dataclasses.replace(Workspace.load(MAPS / f"{name}.json"), robot_radius=RADIUS)
    return task, CellSpace.of(workspace, task.cell, task.directions)


def run(path: Path, name: str, estimator: str, seed: int, limit: int) -> Run:
    """Localize one robot."""
    task, cells = problem(path, name)
    if estimator == ANYWHERE:
        return run_anywhere(task, cells, seed, limit)
    rng = np.random.default_rng([23, seed])
    start = int(rng.integers(cells.size))
    body = PhysicsBody(room(cells), tuple(map(float, cells.centre(start))), rng=rng)
    robot = SimulatedCreate(Emulator(body, line=Line(latency=LATENCY, speedup=1e9)))
    strides = cell_strides(cells.directions, cells.cell, cells.cell)
    walker = Walker(robot, cells.cell, strides=strides, direction=start // cells.positions)
    follower, bounces = follower_of(task, cells, estimator, seed)
    held: list[bool] = []
    try:
        while follower.result is None and len(follower.observations) < limit:
            follower.observe(int(walker.step()))
            if follower.turn is not None:
                walker.rotate(bounces[follower.turn])
            at = int(nearest_cell(cells, *body.pose))
            held.append(follower.result != "refuted" and at in follower.cells)
    except RobotStopped:
        return Run("lost", walker.observations.count("1"), robot.robot.seconds, share(held))
    ends = {"localized": "right" if held[-1] else "wrong", "refuted": "lost"}
    end = ends.get(str(follower.result), "unfinished")
    return Run(end, follower.observations.count("1"), robot.robot.seconds, share(held))


def follower_of(
    task: Any, cells: CellSpace, estimator: str, seed: int
) -> tuple[Any, Sequence[float]]:
    """Make the follower of a run, and list the angles that it chooses from."""
    if estimator == PARTICLES:
        slip = Slip.of(SLIP, give=bumper_give(cells.cell), bump_turn=math.radians(BUMP_TURN))
        particles = Particles(cells, task.bounce, slip, seed=seed)
        return ParticleFollower(particles), [task.bounce]  # type: ignore[arg-type]
    if hasattr(task, "belief"):
        return BeliefFollower(task.belief), task.bounces
    if hasattr(task, "policy"):
        return PolicyFollower(task.policy), task.bounces
    return FilterFollower(task.filter, "known"), [task.bounce]


def run_anywhere(task: Any, cells: CellSpace, seed: int, limit: int) -> Run:
    """Localize one robot that starts anywhere at any heading."""
    rng = np.random.default_rng([29, seed])
    x, y = places_anywhere(room(cells), 1, rng)[0].tolist()
    body = PhysicsBody(room(cells), (x, y, float(rng.uniform(0, math.tau))), rng=rng)
    robot = SimulatedCreate(Emulator(body, line=Line(latency=LATENCY, speedup=1e9)))
    walker, follower = Walker(robot, cells.cell), SetFollower(task.settings)
    filter, errors = task.settings.filter, task.settings.filter.errors
    held: list[bool] = []
    try:
        while follower.result is None and follower.bumps < limit:
            ran = walker.run_to_wall(2 * filter.boundary.diameter, errors.displacement / 2)
            follower.observe(ran)
            held.append(is_held(follower, body.pose, errors.displacement))
            if follower.result is None:
                turn = follower.choose()
                follower.turn(turn)
                walker.rotate(turn)
    except RobotStopped:
        return Run("lost", follower.bumps, robot.robot.seconds, share(held))
    ends = {"localized": "right" if held[-1] else "wrong", "refuted": "lost"}
    end = ends.get(str(follower.result), "unfinished")
    return Run(end, follower.bumps, robot.robot.seconds, share(held))


def is_held(follower: SetFollower, pose: tuple[float, float, float], reach: float) -> bool:
    """Check that a robot which has backed off is as near to its set as its errors allow."""
    state, filter = follower.state, follower.settings.filter
    boundary = filter.boundary
    slices = np.unique(filter.slice_of(pose[2] + filter.errors.turn * np.linspace(-1, 1, 61)))
    near = state.take(np.isin(state.slice, slices))
    begin, end = (boundary.point(near.wall, arc) for arc in (near.begin, near.end))
    along = end - begin
    square = np.maximum((along**2).sum(axis=1), 1e-18)
    part = np.clip(((pose[:2] - begin) * along).sum(axis=1) / square, 0, 1)
    apart = np.hypot(*(pose[:2] - begin - part[:, None] * along).T)
    return bool(apart.min(initial=np.inf) <= reach)


def share(held: list[bool]) -> float:
    return float(np.mean(held)) if held else math.nan


def room(cells: CellSpace) -> Workspace:
    assert cells.workspace is not None
    return cells.workspace


def row(name: str, estimator: str, runs: list[Run]) -> dict[str, Any]:
    """Summarize the runs of an estimator on a map."""
    shares = {f"{end}, %": 100 * float(np.mean([one.end == end for one in runs])) for end in ENDS}
    ended = [one for one in runs if one.end in ("right", "wrong")]
    bumps = float(np.mean([one.bumps for one in ended])) if ended else math.nan
    seconds = float(np.mean([one.seconds for one in ended])) if ended else math.nan
    holds = 100 * float(np.nanmean([one.holds for one in runs]))
    counts = {"map": name, "by": estimator, "runs": len(runs)}
    return {**counts, **shares, "bumps": bumps, "s": seconds, "holds, %": holds}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/chapter_2/physics_localization"))
    parser.add_argument("--maps", nargs="+", default=["lab_a", "lab_b", "complex", "cafe", "depot"])
    parser.add_argument("--runs", type=int, default=200, help="runs of each map and estimator")
    parser.add_argument("--turn", type=int, default=8, help="runs of each in a turn")
    parser.add_argument("--limit", type=int, default=300)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    cases = {case: make(*case, options.out) for case in itertools.product(options.maps, ESTIMATORS)}
    cases = {case: path for case, path in cases.items() if path.exists()}
    runs: dict[tuple[str, str], list[Run]] = {case: [] for case in cases}
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(options.processes, spawn) as pool:
        for first in range(0, options.runs, options.turn):
            seeds = range(first, min(first + options.turn, options.runs))
            for (name, estimator), path in cases.items():
                arguments = [(path, name, estimator, seed, options.limit) for seed in seeds]
                runs[name, estimator] += pool.map(run, *zip(*arguments, strict=True))
                print(row(name, estimator, runs[name, estimator]), file=sys.stderr, flush=True)
            table: Rows = [row(*case, ended) for case, ended in runs.items()]
            emit("In the physics engine", table, options.out / "localization.csv", spec=".1f")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
