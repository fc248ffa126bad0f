import contextlib
import dataclasses
import json
import math
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import tyro

from ...base.files import name_in_results
from ...study.map_study import cell_at
from ..options import direction_at, write_text
from ..terminal import note, note_results, say, status
from .emulation import emulate, seen_from
from .replay import replayed, show


if TYPE_CHECKING:
    from ...automata import Filter, Policy
    from ...record import RobotRecording
    from ...robot.marker import CrossLook
    from ...robot.outcome import RunOutcome
    from ...robot.run_log import RunLog
    from ...robot.tasks.files import AnyTask
    from ...robot.tasks.patrol_task import PatrolTask
    from ...robot.walker import Walker
    from ...space import CellSpace
    from .emulation import Emulation

    _Runner: TypeAlias = tuple[dict[str, Any], Callable[[Walker, RunLog | None], RunOutcome]]


_LOG = "run.jsonl"


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotRun:
    """Run a filter, a plan, or a robot of a team or a patrol, on a robot or an emulated one.

    The robot stops, and the run ends, at Ctrl-C."""

    file: tyro.conf.Positional[Path]
    """What to run: the filter.jxf, policy.jxf or belief.jxb of `jaxcell localize --out`, the
    summary.json of `jaxcell navigate --out`, the team.json of `jaxcell team --out`, or the
    patrol.json of `jaxcell patrol map --out`."""
    robot: int | None = None
    """Which robot of a team or of those that patrol this is, by default 0. Each runs by itself, in
    a process of its own."""
    port: str | None = None
    """Serial line of the robot, such as /dev/ttyUSB0 or socket://host:port."""
    simulate: Path | None = None
    """Map in which to emulate the robot instead; it may be another than that of the file."""
    start: str | None = None
    """Start of the emulated robot, and of any that patrols: "x,y,heading" in m and degrees, or a
    cell; by default that of what is run, or random."""
    heading: float | None = None
    """Heading of the robot at the start in degrees, where steps in some directions are longer than
    in others; the filter is not told. By default that of what is run or the emulated robot; without
    any, all steps are of one length."""
    steps: Literal["encoder", "clock"] = "encoder"
    """Whether the encoders of the wheels tell how far the robot has gone, or the time that it took
    at a known speed."""
    tolerance: float | None = None
    """How near the end of a step is near enough by the encoders, in metres; by default 4 mm, or
    less for steps below 1 m."""
    turn_tolerance: float = 0.4
    """How near the end of a turn is near enough by the encoders, in degrees."""
    noise: float = 0.0
    """Standard deviation of the relative error of the emulated robot's steps and turns, and of its
    veer in radians a metre."""
    speedup: float = 10.0
    """Seconds of the emulated robot in a second."""
    seed: int = 0
    """Seed of the random start, of the noise, and of the draws of a patrol."""
    limit: int = 10_000
    """Observations after which to give up."""
    visits: int = 100
    """Drawn cells after which a patrol is over."""
    bumps: int = 20
    """Bumps where the map is free after which a patrol is given up."""
    intruder: str | None = None
    """Where the emulated map has an intruder, "x,y" in metres, whom a robot on patrol reports."""
    camera: str | None = None
    """What a robot on patrol looks for the cross marker with: the number of a camera, or a folder
    of pictures."""
    out: Path | None = None
    """Directory for the log, which must not be there yet, the recording and summary.json."""
    live: str | None = None
    """Viewer that shows the recording as the run goes: "here", or the address of one, such as
    rerun+http://laptop:9876/proxy."""
    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""

    def run(self) -> int:
        import numpy as np

        from ...robot import Create, RobotStopped
        from ...robot.tasks.files import load_task

        if (self.port is None) == (self.simulate is None):
            raise ValueError("expected one of --port and --simulate")
        if self.live is not None and self.out is None:
            raise ValueError("--live: expected --out as well, for the recording")
        if self.out is not None and (self.out / _LOG).exists():
            raise FileExistsError(
                f"--out {self.out}: {_LOG} of another run is there, and no log is replaced; "
                "expected another directory"
            )
        task = load_task(self.file, self.robot)
        emulation = None
        if self.simulate is not None:
            emulation = emulate(self.simulate, task, self, np.random.default_rng(self.seed))
        direction = self._direction(task, emulation)
        runner = self._runner(task, emulation, direction)
        # Before the robot is there: what it needs takes seconds to load.
        recording = None if self.out is None else self._recording(task, emulation)
        code = None
        with contextlib.ExitStack() as kept:
            place = self.out or Path(kept.enter_context(tempfile.TemporaryDirectory()))
            try:
                with contextlib.ExitStack() as stack:
                    port = self.port
                    if emulation is not None:
                        port = stack.enter_context(emulation.robot).port
                    assert port is not None
                    robot = stack.enter_context(Create.open(port))
                    robot.arm()
                    walker = self._walker(robot, task, emulation, direction)
                    outcome = self._run(walker, runner, place / _LOG, recording)
            except (RobotStopped, KeyboardInterrupt, SystemExit) as error:
                outcome, code = _stopped(error, place / _LOG)
                note(f"jaxcell robot run: {outcome.reason}")
        summary = {
            "command": "jaxcell robot run",
            "file": name_in_results(self.file),
            "port": self.port,
            **dataclasses.asdict(outcome),
        }
        if emulation is not None:
            summary["emulated"] = emulation.describe(outcome)
        if self.out is not None:
            write_text(self.out / "summary.json", json.dumps(summary, indent=2) + "\n")
        if self.json:
            say(json.dumps(summary))
        else:
            show(self.file.name, summary, emulation)
            if self.out is not None:
                note_results(self.out)
        if code is not None:
            return code
        return 0 if outcome.result in ("localized", "arrived", "patrolled", "reported") else 1

    def _direction(self, task: "AnyTask", emulation: "Emulation | None") -> int | None:
        """The direction that the robot faces at the start, where it is known."""
        from ...robot.tasks.files import PlanTask
        from ...robot.tasks.patrol_task import PatrolTask
        from ...robot.team import MemberTask

        if self.heading is not None:
            return direction_at(self.heading, task.directions)
        if emulation is not None:
            return emulation.start // emulation.cells.positions
        match task:
            case PatrolTask():
                return self._patrol_start(task) // task.cells.positions
            case MemberTask():
                return round(task.start[2] * task.directions / (2 * math.pi)) % task.directions
            case PlanTask():
                raise ValueError("--heading: a plan needs the heading that its robot starts with")
        return None

    def _patrol_start(self, task: "PatrolTask", emulation: "Emulation | None" = None) -> int:
        """The cell where a patrol begins, among those of its map."""
        if emulation is not None:
            x, y, theta = emulation.cells.centre(emulation.start)
            try:
                return int(task.cells.index(x, y, theta))
            except ValueError as error:
                raise ValueError(f"--start: {task.path} has no such place: {error}") from None
        return task.start if self.start is None else cell_at(task.cells, self.start, "--start")

    def _recording(self, task: "AnyTask", emulation: "Emulation | None") -> "RobotRecording":
        from ...record import RecordedRobot, RobotRecording
        from ...robot.tasks.files import BeliefTask, FilterTask, PolicyTask

        assert self.out is not None
        self.out.mkdir(parents=True, exist_ok=True)
        filter: Filter | Policy | None = None
        belief = task.belief if isinstance(task, BeliefTask) else None
        match task:
            case FilterTask():
                filter = task.filter
            case PolicyTask():
                filter = task.policy
        about = {} if filter is None else filter.metadata
        if belief is not None:
            about = belief.hidden.metadata
        cells = _cells_of(task, about) if emulation is None else emulation.cells
        robot = RecordedRobot()
        if emulation is not None:
            robot = RecordedRobot(start=emulation.pose, trace=emulation.robot.trace)
        return RobotRecording(
            self.out / "run.rrd",
            [robot],
            cells=cells,
            filter=filter,
            belief=belief,
            filter_of_cells=cells is not None and _is_map(cells, about),
            viewer=self.live,
            spec={"file": name_in_results(self.file), **about},
        )

    def _walker(
        self, robot: Any, task: "AnyTask", emulation: "Emulation | None", direction: int | None
    ) -> "Walker":
        from ...robot.create.clock import ByClock
        from ...robot.walker import Walker

        if self.steps == "clock":
            if emulation is None:
                robot = ByClock(robot)
            else:
                robot = ByClock(robot, clock=lambda: emulation.robot.seconds)
        return Walker(
            robot,
            task.step,
            strides=None if direction is None else task.strides,
            direction=direction or 0,
            tolerance=self.tolerance,
            turn_tolerance=math.radians(self.turn_tolerance),
        )

    def _runner(
        self, task: "AnyTask", emulation: "Emulation | None", direction: int | None
    ) -> "_Runner":
        """What runs the task, and the header of its log."""
        from ...robot.believer import run_belief
        from ...robot.patrol import Patrol, run_patrol
        from ...robot.policy import run_policy
        from ...robot.runner import run_filter, run_plan
        from ...robot.tasks.files import BeliefTask, FilterTask, PlanTask, PolicyTask
        from ...robot.team import MemberTask, run_member

        header, limit = task.header, self.limit
        if self.intruder is not None and (emulation is None or header["kind"] != "patrol"):
            raise ValueError("--intruder has a meaning only for an emulated robot on patrol")
        if self.camera is not None and (self.intruder is not None or header["kind"] != "patrol"):
            raise ValueError("--camera has a meaning only on patrol, and without --intruder")
        match task:
            case FilterTask():
                return header, lambda walker, log: run_filter(
                    walker, task.filter, task.bounce, log=log, limit=limit
                )
            case PolicyTask():
                return header, lambda walker, log: run_policy(
                    walker, task.policy, task.bounces, log=log, limit=limit
                )
            case BeliefTask():
                return header, lambda walker, log: run_belief(
                    walker, task.belief, task.bounces, log=log, limit=limit
                )
            case PlanTask():
                return header, lambda walker, log: run_plan(walker, task.actions, log=log)
            case MemberTask():
                return header, lambda walker, log: run_member(walker, task, log=log)
        patrol = Patrol(
            task,
            start=self._patrol_start(task, emulation) % task.cells.positions,
            facing=direction or 0,
            seed=self.seed,
            visits=self.visits,
            most_bumps=self.bumps,
            limit=limit,
        )
        look: Callable[[int], Any] | None = None
        if self.intruder is not None and emulation is not None:
            look = seen_from(emulation.cells, task, self.intruder)
        elif self.camera is not None:
            look = _cross_look(self.camera)
        header |= {"patrol": patrol.settings}
        return header, lambda walker, log: run_patrol(walker, patrol, look=look, log=log)

    def _run(
        self, walker: "Walker", runner: "_Runner", path: Path, recording: "RobotRecording | None"
    ) -> "RunOutcome":
        from ...robot.run_log import RunLog

        header, run = runner
        with contextlib.ExitStack() as stack:
            if recording is not None:
                stack.enter_context(recording)
            log = stack.enter_context(RunLog(path, header))
            if recording is not None:
                log.on_event = recording.event
            stack.enter_context(status(f"running {self.file.name}"))
            return run(walker, log)


def _stopped(error: BaseException, log: Path) -> "tuple[RunOutcome, int]":
    """How a run stands that was stopped, by its log if there is one, and the exit status."""
    from ...robot.outcome import RunOutcome
    from ...robot.run_log import read_log, why_stopped

    code = 130 if isinstance(error, KeyboardInterrupt) else 1
    if isinstance(error, SystemExit):
        code = int(error.code or 0)
    if log.exists():
        return replayed(read_log(log)), code
    return RunOutcome("stopped", "", why_stopped(error)), code


def _cross_look(source: str) -> "CrossLook":
    from ...robot import CrossLook, camera, pictures

    try:
        return CrossLook(camera(int(source)) if source.isdecimal() else pictures(source))
    except (ValueError, OSError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"--camera {source}: {reason}") from None


def _cells_of(task: "AnyTask", about: Mapping[str, Any]) -> "CellSpace | None":
    """The cells of the map that a filter is of, if the map is where it was."""
    from ...space import CellSpace, Workspace

    with contextlib.suppress(OSError, ValueError, KeyError):
        workspace = dataclasses.replace(Workspace.load(about["map"]), robot_radius=task.radius)
        cells = CellSpace.of(workspace, task.cell, task.directions)
        return cells if _is_map(cells, about) else None
    return None


def _is_map(cells: "CellSpace", about: Mapping[str, Any]) -> bool:
    """Whether cells are those of the map that a filter is of, by what it says."""
    assert cells.workspace is not None
    found = {
        "name": cells.workspace.name,
        "positions": cells.positions,
        "robot_radius_m": cells.workspace.robot_radius,
    }
    return all(about.get(key, value) == value for key, value in found.items())
