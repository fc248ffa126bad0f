"""Measure how often estimators localize a Create 2 in a physics engine rightly.

    python -m experiments.chapter_2.physics_localization --maps lab_b --runs 20

The results predict what a user may expect from a real robot. On each map, with the true radius of a
Create 2, `jaxcell localize` makes a filter of one bouncing angle, a policy and a belief of two, a
belief that models the effect of a bump on the robot, and sets on walls, without and with this
effect, for a robot that starts anywhere with any heading. Particles slip as that belief does, with
the angle of the filter. Each estimator then localizes a robot in MuJoCo, through the driver; filter
and particles follow the same robot. Except for the sets on walls, a robot starts from the centre of
a random cell, and the walker knows its heading. A run ends

- `right`: localized, and the robot is in one of the remaining places;
- `wrong`: localized, but the robot is elsewhere;
- `lost`: an observation was impossible on the map, or the driver stopped the robot;
- `unfinished`: none of these after `--limit` observations.

Bumps and seconds of the robot are means over the localized runs. The answer is the cells of a
filter or a policy, the 95 % credible set of a belief or of particles, or the sets on walls. `holds`
is the share of observations after which the answer contains the robot. A credible set consists of
whole cells, so its probability exceeds 95 %; if a cell has 99 %, no set has exactly 95 %.
`exactly` corrects for this: the last cell of a set counts by the part of its probability that
completes 95 %. For a correct belief this is 95 % whatever the robot does. `±` is the standard
error. `at the end` is the same share for the last observation of each run.

The turn and the skid by a bump are those of measurements 3 and 1 of `physics_protocol.csv`, at
0.2 m/s, and the slip is the drift of the heading per metre, rounded up. All three were fixed before
these runs. `belief, calibrated, fine` has four times as many fine cells.

`runs.csv` has each run as it ends. The same command continues an interrupted script.
"""

import argparse
import concurrent.futures
import csv
import dataclasses
import functools
import itertools
import math
import multiprocessing
import os
import subprocess
import sys
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


SLIP, BUMP_TURN, BUMP_SKID = 0.003, 2.0, 0.012
BOUNDS = "run=0.01 distance=0.05 turn=3 displacement=0.06"
KNOWN_BOUNDS = f"run=0.01 distance=0.05 turn=1 bump_turn={BUMP_TURN} displacement=0.06"
FILTER, PARTICLES, POLICY = "filter, 135°", "particles, 135°", "policy, 45° and 135°"
PLAIN, BELIEF, ANYWHERE = "belief, slip only", "belief, calibrated", "sets, from anywhere"
FINE, KNOWING = "belief, calibrated, fine", "sets, from anywhere, calibrated"
ANGLES = ["--bounce", "45", "135"]
PLAINLY = [*ANGLES, "--errors", f"slip={SLIP}"]
CALIBRATED = [*PLAINLY, f"bump_turn={BUMP_TURN}", f"bump_skid={BUMP_SKID}"]
FROM_ANYWHERE = "anywhere --bounce 45 100 135 --heading unknown --measured --robots 1 --radius 0.5"
ESTIMATORS = {
    FILTER: (["--bounce", "135"], "filter.jxf"),
    PARTICLES: (["--bounce", "135"], "filter.jxf"),
    POLICY: (ANGLES, "policy.jxf"),
    PLAIN: (PLAINLY, "belief.jxb"),
    BELIEF: (CALIBRATED, "belief.jxb"),
    FINE: ([*CALIBRATED, "--max-fine-cells", "1600000"], "belief.jxb"),
    ANYWHERE: (f"{FROM_ANYWHERE} --errors {BOUNDS}".split(), "anywhere.json"),
    KNOWING: (f"{FROM_ANYWHERE} --errors {KNOWN_BOUNDS}".split(), "anywhere.json"),
}
# Estimators that choose no angles can follow the same robot.
TOGETHER = (FILTER, PARTICLES), (POLICY,), (PLAIN,), (BELIEF,), (FINE,), (ANYWHERE,), (KNOWING,)
SHARE = 0.95
ENDS = ("right", "wrong", "lost", "unfinished")


class Run(NamedTuple):
    """The end of a run, and how often its answers contained the robot."""

    map: str
    by: str
    seed: int
    end: str
    bumps: int
    seconds: float
    observations: int
    held: int
    "Number of observations after which the answer contained the robot."
    exactly: float
    "Number of observations after which a set of exactly 95 % contained the robot."
    last: float
    "Contribution of the last observation to `exactly`, 0 to 1."


class Listener:
    """An estimator that follows a robot, with a record of its answers."""

    def __init__(self, follower: Any) -> None:
        self.follower = follower
        self.bumps, self.seconds = 0, 0.0
        self.held: list[bool] = []
        self.parts: list[float] = []

    def add(self, bump: int, seconds: float, held: bool, part: float) -> None:
        """Record an observation: 1 for a bump, the time, and if its answer contains the robot.

        `part` replaces `held` for a set of exactly 95 %.
        """
        self.bumps, self.seconds = self.bumps + bump, seconds
        self.held.append(held)
        self.parts.append(part)

    def judge(self, observation: int, at: int, seconds: float) -> None:
        """Record an observation after which the robot is in the cell `at`."""
        cells = [] if self.follower.result == "refuted" else list(self.follower.cells)
        part = float(at in cells)
        if part and isinstance(self.follower, BeliefFollower) and at == cells[-1]:
            mass = self.follower.estimate.probability
            part = max(0.0, (SHARE - float(mass[:-1].sum())) / float(mass[-1]))
        self.add(observation, seconds, at in cells, part)

    def run(self, name: str, by: str, seed: int, *, stopped: bool) -> Run:
        """Summarize the run; `stopped` if the driver stopped the robot."""
        ends = {"localized": "right" if self.held and self.held[-1] else "wrong", "refuted": "lost"}
        result = self.follower.result
        end = ends.get(result, "lost" if stopped else "unfinished")
        count, held = len(self.held), sum(self.held)
        last = self.parts[-1] if self.parts else math.nan
        return Run(
            name, by, seed, end, self.bumps, self.seconds, count, held, sum(self.parts), last
        )


class ParticleFollower(BeliefFollower):
    """Particles that follow a robot with one bouncing angle."""

    @property
    def turn(self) -> int | None:
        bumped = self.observations[-1:] == "1"
        return 0 if bumped and self.result != "refuted" else None


def make(name: str, estimator: str, out: Path) -> Path:
    """Make the file of an estimator with `jaxcell localize`, unless the file exists."""
    options, file = ESTIMATORS[estimator]
    folder = out / "files" / f"{name}, {estimator}"
    if not (folder / file).exists():
        kind = {"belief.jxb": ["slip"], "anywhere.json": ["anywhere"]}.get(file, [])
        command = [sys.executable, "-m", "jaxcell", "localize", *kind, str(MAPS / f"{name}.json")]
        command += [*options, "--robot-radius", str(RADIUS), "--out", str(folder)]
        # The exit status is 1 for a policy that cannot distinguish all cells.
        subprocess.run(command, check=False, capture_output=True)
    return folder / file


@functools.cache
def problem(path: Path, name: str) -> tuple[Any, CellSpace]:
    """Read a task, and make the cells of its map."""
    task = load_task(path)
    workspace = dataclasses.replace(Workspace.load(MAPS / f"{name}.json"), robot_radius=RADIUS)
    return task, CellSpace.of(workspace, task.cell, task.directions)


def run(paths: dict[str, Path], name: str, seed: int, limit: int) -> list[Run]:
    """Localize one robot by one estimator, or by several that choose no angles."""
    for by in (ANYWHERE, KNOWING):
        if by in paths:
            return [run_anywhere(paths[by], name, by, seed, limit)]
    tasks = {by: problem(path, name)[0] for by, path in paths.items()}
    _, cells = problem(next(iter(paths.values())), name)
    rng = np.random.default_rng([23, seed])
    start = int(rng.integers(cells.size))
    body = PhysicsBody(room(cells), tuple(map(float, cells.centre(start))), rng=rng)
    robot = SimulatedCreate(Emulator(body, line=Line(latency=LATENCY, speedup=1e9)))
    strides = cell_strides(cells.directions, cells.cell, cells.cell)
    walker = Walker(robot, cells.cell, strides=strides, direction=start // cells.positions)
    listeners, stopped = (
        {by: Listener(follower_of(by, tasks[by], cells, seed)) for by in tasks},
        False,
    )
    bounces = angles(next(iter(tasks.values())))
    try:
        for _ in range(limit):
            running = [each for each in listeners.values() if each.follower.result is None]
            if not running:
                break
            observation = int(walker.step())
            for listener in running:
                listener.follower.observe(observation)
            turn = running[0].follower.turn if len(tasks) == 1 else 0 if observation else None
            if turn is not None:
                walker.rotate(bounces[turn])
            at = int(nearest_cell(cells, *body.pose))
            for listener in running:
                listener.judge(observation, at, robot.robot.seconds)
    except RobotStopped:
        stopped = True
    return [one.run(name, by, seed, stopped=stopped) for by, one in listeners.items()]


def angles(task: Any) -> tuple[float, ...]:
    """List the angles from which a follower chooses, or the single angle of a filter."""
    return (task.bounce,) if hasattr(task, "filter") else tuple(task.bounces)


def follower_of(by: str, task: Any, cells: CellSpace, seed: int) -> Any:
    """Make the follower that runs an estimator."""
    if by == PARTICLES:
        slip = Slip.of(
            SLIP,
            give=bumper_give(cells.cell),
            bump_turn=math.radians(BUMP_TURN),
            bump_skid=BUMP_SKID,
        )
        return ParticleFollower(Particles(cells, task.bounce, slip, seed=seed), confirm=0)  # type: ignore[arg-type]
    if hasattr(task, "belief"):
        return BeliefFollower(task.belief, confirm=0)
    if hasattr(task, "policy"):
        return PolicyFollower(task.policy, confirm=0)
    return FilterFollower(task.filter, confirm=0)


def run_anywhere(path: Path, name: str, by: str, seed: int, limit: int) -> Run:
    """Localize one robot that starts anywhere with any heading."""
    task, cells = problem(path, name)
    settings = dataclasses.replace(task.settings, confirm=0)
    rng = np.random.default_rng([29, seed])
    x, y = places_anywhere(room(cells), 1, rng)[0].tolist()
    body = PhysicsBody(room(cells), (x, y, float(rng.uniform(0, math.tau))), rng=rng)
    robot = SimulatedCreate(Emulator(body, line=Line(latency=LATENCY, speedup=1e9)))
    walker, follower = Walker(robot, cells.cell), SetFollower(settings)
    filter, errors = task.settings.filter, task.settings.filter.errors
    listener, stopped = Listener(follower), False
    try:
        while follower.result is None and follower.bumps < limit:
            follower.observe(
                walker.run_to_wall(2 * filter.boundary.diameter, errors.displacement / 2)
            )
            held = is_held(follower, body.pose, errors.displacement)
            listener.add(1, robot.robot.seconds, held, float(held))
            if follower.result is None:
                turn = follower.choose()
                follower.turn(turn)
                walker.rotate(turn)
    except RobotStopped:
        stopped = True
    return listener.run(name, by, seed, stopped=stopped)


def is_held(follower: SetFollower, pose: tuple[float, float, float], reach: float) -> bool:
    """Test whether a robot that backed off is as close to its set as its errors allow."""
    state, filter = follower.state, follower.settings.filter
    boundary = filter.boundary
    # The set has the heading before the bump, which turned the robot.
    turn = filter.errors.turn + filter.errors.bump_turn
    slices = np.unique(filter.slice_of(pose[2] + turn * np.linspace(-1, 1, 61)))
    near = state.take(np.isin(state.slice, slices))
    begin, end = (boundary.point(near.wall, arc) for arc in (near.begin, near.end))
    along = end - begin
    square = np.maximum((along**2).sum(axis=1), 1e-18)
    part = np.clip(((pose[:2] - begin) * along).sum(axis=1) / square, 0, 1)
    apart = np.hypot(*(pose[:2] - begin - part[:, None] * along).T)
    return bool(apart.min(initial=np.inf) <= reach)


def room(cells: CellSpace) -> Workspace:
    assert cells.workspace is not None
    return cells.workspace


def row(name: str, by: str, runs: list[Run]) -> dict[str, Any]:
    """Summarize the runs of an estimator on a map."""
    shares = {f"{end}, %": 100 * float(np.mean([one.end == end for one in runs])) for end in ENDS}
    ended = [one for one in runs if one.end in ("right", "wrong")]
    bumps = float(np.mean([one.bumps for one in ended])) if ended else math.nan
    seconds = float(np.mean([one.seconds for one in ended])) if ended else math.nan
    count = np.array([one.observations for one in runs])
    held, exactly, last = (
        np.array([float(getattr(one, field)) for one in runs])
        for field in ("held", "exactly", "last")
    )
    percent = 100 / max(count.sum(), 1)
    summary = {"map": name, "by": by, "runs": len(runs), **shares, "bumps": bumps, "s": seconds}
    # A policy has an answer at bumps only.
    summary["holds, %"] = math.nan if by == POLICY else percent * held.sum()
    if "belief" in by or by == PARTICLES:
        # Robots are independent, but the observations of one robot are not.
        share = exactly.sum() / max(count.sum(), 1)
        error = percent * float(np.sqrt(((exactly - share * count) ** 2).sum()))
        summary |= {"exactly, %": percent * exactly.sum(), "±": error}
        summary |= {"at the, end, %": 100 * float(np.nanmean(last))}
    return summary


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/chapter_2/physics_localization"))
    parser.add_argument("--maps", nargs="+", default=["lab_a", "lab_b", "complex", "cafe", "depot"])
    parser.add_argument("--by", nargs="+", choices=ESTIMATORS, default=list(ESTIMATORS))
    parser.add_argument("--runs", type=int, default=200, help="runs per map and estimator")
    parser.add_argument("--limit", type=int, default=300, help="most observations of a run")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    chosen = [group for group in TOGETHER if set(group) & set(options.by)]
    paths = {
        (name, by): make(name, by, options.out)
        for name, group in itertools.product(options.maps, chosen)
        for by in group
    }
    path = options.out / "runs.csv"
    runs = read(path)
    done = {(one.map, one.by, one.seed) for one in runs}
    jobs = [
        (
            {by: paths[name, by] for by in group if paths[name, by].exists()},
            name,
            seed,
            options.limit,
        )
        for seed, name, group in itertools.product(range(options.runs), options.maps, chosen)
        if (name, group[-1], seed) not in done
    ]
    spawn = multiprocessing.get_context("spawn")
    with (
        path.open("a", newline="", encoding="utf-8") as file,
        concurrent.futures.ProcessPoolExecutor(options.processes, spawn) as pool,
    ):
        writer = csv.writer(file)
        if not runs:
            writer.writerow(Run._fields)
        for number, ended in enumerate(pool.map(run, *zip(*jobs, strict=True))):
            writer.writerows(ended)
            file.flush()
            runs += ended
            if number % 25 == 24:
                print(f"{number + 1} of {len(jobs)} robots", file=sys.stderr, flush=True)
    write_table(runs, options.out)
    return 0


def read(path: Path) -> list[Run]:
    """Read the runs of a file; none if there is no file."""
    if not path.exists():
        return []
    kinds = Run.__annotations__
    with path.open(newline="", encoding="utf-8") as file:
        return [
            Run(**{field: kinds[field](text) for field, text in values.items()})
            for values in csv.DictReader(file)
        ]


def write_table(runs: list[Run], out: Path) -> None:
    """Print the table of all runs, and write it as CSV."""
    table: Rows = []
    for name, by in itertools.product(dict.fromkeys(one.map for one in runs), ESTIMATORS):
        if some := [one for one in runs if (one.map, one.by) == (name, by)]:
            table.append(row(name, by, some))
    columns = dict.fromkeys(name for one in table for name in one)
    table = [{name: one.get(name, math.nan) for name in columns} for one in table]
    emit("In the physics engine", table, out / "localization.csv", spec=".1f")


if __name__ == "__main__":
    raise SystemExit(main())
