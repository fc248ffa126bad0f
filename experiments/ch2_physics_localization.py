"""Filter, policy and belief on a Create 2 in a physics engine: right, wrong or lost.

    python experiments/ch2_physics_localization.py --maps lab_b --runs 20

What a user learns before buying a robot. On each map, with the true radius of a Create 2, `jaxcell
localize` makes a filter of one bouncing angle, a policy and a belief of two, and a belief that
knows by how much a bump turns the robot. Each then localizes a robot in MuJoCo, through the driver,
from centres of random cells with the heading known to the walker. A run ends

- `right`: localized, with the cell where it is among those that are left;
- `wrong`: localized, and it is elsewhere;
- `lost`: it observed what cannot be on the map, or the driver stopped it;
- `unfinished`: neither after `--limit` observations.

Bumps and seconds of the robot are means over the runs that were localized. Writes
`localization.csv`.
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
from pathlib import Path
from typing import Any

import numpy as np
from report import Rows, emit

from jaxcell.robot import Walker, cell_strides, load_task, run_belief, run_filter, run_policy
from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.emulation.emulator import Emulator, Line
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.physics import LATENCY, RADIUS, PhysicsBody
from jaxcell.space import CellSpace, Workspace


MAPS = Path(__file__).parent.parent / "data" / "maps"
SLIP, BUMP_TURN = 0.01, 2.0
ESTIMATORS = {
    "filter, 135°": (["--bounce", "135"], "filter.jxf"),
    "policy, 45° and 135°": (["--bounces", "45", "135"], "policy.jxf"),
    "belief, 45° and 135°": (["--bounces", "45", "135", "--slip", str(SLIP)], "belief.jxb"),
    "belief, bumps turn it": (
        ["--bounces", "45", "135", "--slip", str(SLIP), "--bump-turn", str(BUMP_TURN)],
        "belief.jxb",
    ),
}
ENDS = ("right", "wrong", "lost", "unfinished")


def make(name: str, estimator: str, out: Path) -> Path:
    """The file of an estimator of a map, made by the command unless it is there."""
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
    """A task and the cells of its map."""
    task = load_task(path)
    workspace = dataclasses.replace(Workspace.load(MAPS / f"{name}.json"), robot_radius=RADIUS)
    return task, CellSpace.of(workspace, task.cell, task.directions)


def run(path: Path, name: str, seed: int, limit: int) -> tuple[str, int, float]:
    """How a run ended, its bumps, and its seconds."""
    task, cells = problem(path, name)
    rng = np.random.default_rng([23, seed])
    start = int(rng.integers(cells.size))
    body = PhysicsBody(cells.workspace, tuple(map(float, cells.centre(start))), rng=rng)
    robot = SimulatedCreate(Emulator(body, line=Line(latency=LATENCY, speedup=1e9)))
    strides = cell_strides(cells.directions, cells.cell, cells.cell)
    walker = Walker(robot, cells.cell, strides=strides, direction=start // cells.positions)
    try:
        if hasattr(task, "belief"):
            outcome = run_belief(walker, task.belief, task.bounces, limit=limit)
        elif hasattr(task, "policy"):
            outcome = run_policy(walker, task.policy, task.bounces, limit=limit)
        else:
            outcome = run_filter(walker, task.filter, task.bounce, limit=limit)
    except RobotStopped:
        return "lost", walker.observations.count("1"), robot.robot.seconds
    right = place(cells, body) in outcome.cells
    end = {"localized": "right" if right else "wrong", "refuted": "lost"}.get(
        outcome.result, "unfinished"
    )
    return end, outcome.observations.count("1"), robot.robot.seconds


def place(cells: CellSpace, body: PhysicsBody) -> int | None:
    try:
        return int(cells.index(*body.pose))
    except ValueError:
        return None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/ch2_physics_localization"))
    parser.add_argument("--maps", nargs="+", default=["lab_a", "lab_b", "complex", "cafe", "depot"])
    parser.add_argument("--runs", type=int, default=200, help="runs of each map and estimator")
    parser.add_argument("--limit", type=int, default=300)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    table: Rows = []
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(options.processes, spawn) as pool:
        for name, estimator in itertools.product(options.maps, ESTIMATORS):
            path = make(name, estimator, options.out)
            if not path.exists():
                continue
            jobs = [pool.submit(run, path, name, i, options.limit) for i in range(options.runs)]
            found = [job.result() for job in jobs]
            shares = {
                f"{end}, %": 100 * sum(one[0] == end for one in found) / len(found) for end in ENDS
            }
            ended = [one for one in found if one[0] in ("right", "wrong")]
            bumps = float(np.mean([one[1] for one in ended])) if ended else math.nan
            seconds = float(np.mean([one[2] for one in ended])) if ended else math.nan
            table.append({"map": name, "by": estimator, **shares, "bumps": bumps, "s": seconds})
            print(table[-1], file=sys.stderr, flush=True)
    emit("Localized in the physics engine", table, options.out / "localization.csv", spec=".1f")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
