"""Run a task on a robot, with the options of `jaxcell robot run`."""

import contextlib
import dataclasses
import json
import math
import shlex
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ...base.optional_modules import has_module
from ...base.paths import digest, name_in_results
from ...base.process import exit_status, keep_running
from ...robot import Create, RobotStopped, RunLog, Walker, load_task, read_log
from ...robot.calibration import Calibrated, Calibration, calibration_file
from ...robot.create.clock import ByClock
from ...robot.emulation.simulated import SimulatedCreate
from ...robot.outcome import RunOutcome
from ...robot.run_log import LoggedRun, why_stopped
from ...robot.tasks.anywhere_task import AnywhereTask
from ...robot.tasks.files import AnyTask, FilterTask, PolicyTask, other_rooms
from ...robot.tasks.patrol_task import PatrolTask
from ...robot.walker import Drivable
from ...space import CellSpace
from ..output import write_text
from ..terminal import note, note_results, say, status
from ..view import shown_live
from .emulation import Emulation, emulate
from .evidence import note_evidence
from .options import RunOptions, check_heading, direction_at
from .outcome import LOG, RECORDING, SUMMARY, describe, replayed, show
from .recording import cells_of, own_cells, recording_of
from .resume import (
    Place,
    Standing,
    StandingStill,
    place_in_words,
    resume_command,
    run_before,
    start_after,
)
from .runners import patrol_start, runner_of


Listener: TypeAlias = Callable[[str, Mapping[str, Any]], None]


def run_robot(options: RunOptions) -> int:
    out = options.out
    if out is not None and (out / LOG).exists():
        raise FileExistsError(
            f"--out {out}: it has the {LOG} of another run, and no log is replaced; "
            "expected another folder"
        )
    task = load_task(options.file, options.robot)
    before = None
    if options.resume is not None:
        if options.simulate is not None and options.start is None:
            raise ValueError(
                "--resume: expected --start too, the current pose of the emulated robot"
            )
        before = run_before(options.resume, task)
    emulation = None
    if options.simulate is not None:
        emulation = emulate(options.simulate, task, options, np.random.default_rng(options.seed))
    direction = _direction(options, task, emulation, before)
    with contextlib.ExitStack() as cleanup:
        return _Run(options, task, emulation, direction).start(before, cleanup)


@dataclasses.dataclass(frozen=True)
class _Run:
    options: RunOptions
    task: AnyTask
    emulation: Emulation | None
    direction: int | None

    def start(self, before: LoggedRun | None, cleanup: contextlib.ExitStack) -> int:
        """Run the task or continue the run `before`, and return the exit status."""
        options, task, emulation = self.options, self.task, self.emulation
        calibration = self._calibration()
        header, follow = runner_of(task, options, emulation, self.direction, before)
        if isinstance(task, FilterTask | PolicyTask):
            note_evidence(task, options, emulation)
        pose = None if emulation is None else emulation.pose
        resumed = None
        if before is not None and options.resume is not None:
            resumed = {
                "log": str(options.resume.absolute()),
                "sha256": digest(options.resume),
                "observations": len(before.observations),
            }
            pose, at = before.header.get("pose"), self._place(before)
            if self.direction is not None and emulation is not None:
                turned = round(at[2] * task.directions / math.tau)
                known, true = (
                    (self.direction + turned),
                    emulation.start // emulation.cells.positions,
                )
                _check_start(options, known % task.directions, true, task.directions)
            note(f"The robot must stand {place_in_words(at)}")
            if options.simulate is None and not options.json and sys.stdin.isatty():
                input("Press Enter when it stands there: ")
        # Import before the connection to the robot, because the imports take seconds.
        viewer = None if options.live is None else cleanup.enter_context(shown_live(options.live))
        place = options.out or Path(cleanup.enter_context(tempfile.TemporaryDirectory()))
        place.mkdir(parents=True, exist_ok=True)
        recording = None
        if has_module("rerun") and (options.out or viewer):
            recording = recording_of(
                task, place / RECORDING, start=pose, emulation=emulation, viewer=viewer
            )
        header |= {
            "pose": pose,
            "resumed": resumed,
            "calibration": None if calibration is None else dataclasses.asdict(calibration),
        }
        code = None
        try:
            with contextlib.ExitStack() as stack:
                robot, listeners = self._robot(stack)
                walker = self._walker(self._moving(robot, calibration), before)
                if recording is not None:
                    listeners.append(stack.enter_context(recording).event)

                def tell(name: str, fields: Mapping[str, Any]) -> None:
                    for listener in listeners:
                        listener(name, fields)

                doing = f"running {options.file.name}"
                with RunLog(place / LOG, header) as log, status(doing):
                    log.on_event = tell
                    outcome = follow(walker, log)
        except (RobotStopped, KeyboardInterrupt, SystemExit) as error:
            keep_running()
            outcome, code = _stopped(error, place / LOG)
            note(f"jaxcell robot run: {outcome.reason}")
            resumable = outcome.result == "stopped" and outcome.observations
            if options.out is not None and resumable and not isinstance(task, AnywhereTask):
                log_file, start = options.out / LOG, None
                if emulation is not None:
                    places = map(self._place, (before, read_log(log_file)))
                    start = start_after(emulation.pose, *places)
                note(f"To resume:\n{resume_command(options, log_file, start)}")
        lost = self._report(outcome, header)
        if code is not None:
            return code
        done = outcome.result in ("localized", "arrived", "patrolled", "reported")
        return 0 if done and not lost else 1

    def _report(self, outcome: RunOutcome, header: Mapping[str, Any]) -> bool:
        """Print the summary of a run, write it to `out`, and return whether the truth is lost.

        `header` is that of the log.
        """
        options = self.options
        summary = {
            "command": "jaxcell robot run",
            "file": name_in_results(options.file),
            "port": options.port if options.ros is None else f"ROS 2, {options.ros}",
            **dataclasses.asdict(outcome),
        }
        if outcome.result == "localized" and isinstance(self.task, FilterTask | PolicyTask):
            summary |= other_rooms(self.task, header["confirm"])
        truth: dict[str, Any] = {}
        cells: CellSpace | None = None
        if self.emulation is not None:
            task = self.task
            back = 0.0
            if isinstance(task, AnywhereTask):
                back = task.settings.filter.errors.displacement
            cells = own_cells(task, self.emulation.cells)
            truth = summary["emulated"] = self.emulation.describe(outcome, cells, back)
        if options.out is not None:
            write_text(options.out / SUMMARY, json.dumps(summary, indent=2) + "\n")
            inputs = options.file, options.simulate, options.calibration, options.resume
            used = {name: header[name] for name in ("confirm",) if name in header}
            describe(options, options.out, *inputs, used=used)
        if options.json:
            say(json.dumps(summary))
        else:
            show(options.file.name, summary, self.emulation, cells)
            if options.out is not None:
                note_results(options.out)
        if options.out is not None and not has_module("rerun"):
            replayed = options.out / LOG, "--file", options.file.name, "--out", options.out
            note(
                "No recording is written without Rerun. Elsewhere: "
                + shlex.join(map(str, ("jaxcell", "robot", "replay", *replayed)))
            )
        return truth.get("truth_is_a_candidate") is False

    def _place(self, run: LoggedRun | None) -> Place:
        """Return the place of the robot after a logged run, or at its start if there was none."""
        _, follow = runner_of(self.task, self.options, self.emulation, self.direction, run)
        walker = self._walker(Standing(), run)
        with contextlib.suppress(StandingStill):
            follow(walker, None)
        return walker.place

    def _calibration(self) -> Calibration | None:
        """Read the calibration of the encoders of the robot, or return `None` if there is none."""
        if self.options.calibration is not None:
            return Calibration.load(self.options.calibration)
        path = calibration_file()
        if self.options.port is None or self.options.steps == "clock" or not path.exists():
            return None
        note(f"The robot uses the calibration in {path}")
        return Calibration.load(path)

    def _robot(self, stack: contextlib.ExitStack) -> tuple[Any, list[Listener]]:
        """Connect to the robot and enable its drive; return it and the listeners to its events."""
        if self.options.ros is not None:
            from ...robot import ros

            kind = ros.Create3 if self.options.ros == "create3" else ros.Base
            robot = stack.enter_context(kind(remap=self.options.remap))
            robot.arm()
            return robot, [ros.Candidates(robot, self.task, cells_of(self.task)).event]
        if self.emulation is not None:
            create: Create = stack.enter_context(SimulatedCreate(self.emulation.robot))
        else:
            assert self.options.port is not None
            create = stack.enter_context(Create.open(self.options.port))
            create.arm()
        create.speed = self.options.speed or create.speed
        return create, []

    def _moving(self, robot: Any, calibration: Calibration | None) -> Drivable:
        """Return the robot with its source of distances: a clock, or (calibrated) encoders."""
        if calibration is not None:
            return Calibrated(robot, calibration)
        if self.options.steps == "encoder":
            return robot
        if self.emulation is None:
            return ByClock(robot)
        emulated = self.emulation.robot
        return ByClock(robot, clock=lambda: emulated.seconds, sleep=robot.sleep)

    def _walker(self, robot: Drivable, before: LoggedRun | None) -> Walker:
        return Walker(
            robot,
            self.task.step,
            # Without a direction the strides are equal in all directions.
            strides=self.task.strides,
            direction=self.direction or 0,
            recalled="" if before is None else before.observations,
            tolerance=self.options.tolerance,
            turn_tolerance=math.radians(self.options.turn_tolerance),
        )


def _direction(
    options: RunOptions, task: AnyTask, emulation: Emulation | None, before: LoggedRun | None
) -> int | None:
    """Return the index of the start direction, or `None` if the robot does not know it.

    The direction of an emulated robot is taken from `emulation` only on a patrol.
    """
    if isinstance(task, AnywhereTask):
        if options.heading is not None:
            raise ValueError("--heading: it has no effect for a robot that starts anywhere")
        return None
    if before is not None:
        direction = before.direction
    elif options.heading is not None:
        direction = direction_at(options.heading, task.directions)
    elif isinstance(task, PatrolTask):
        direction = patrol_start(task, options.start, emulation) // task.cells.positions
    else:
        direction = task.start_direction
    if direction is None:
        check_heading(task)
    elif before is None and options.start is not None:
        if isinstance(task, PatrolTask):
            cells, start = task.cells, patrol_start(task, options.start, emulation)
        else:
            assert emulation is not None
            cells, start = emulation.cells, emulation.start
        _check_start(options, direction, start // cells.positions, task.directions)
    return direction


def _check_start(options: RunOptions, known: int, true: int, directions: int) -> None:
    """Raise if the direction that the robot knows is not the direction of the option `--start`."""
    if known != true:
        option = "--start" if options.heading is None else "--heading"
        knows, looks = (360 / directions * direction for direction in (known, true))
        raise ValueError(
            f"{option}: the robot knows that its heading is {knows:g} degrees, but at --start "
            f"{options.start} it looks to {looks:g} degrees; expected equal headings"
        )


def _stopped(error: BaseException, log: Path) -> tuple[RunOutcome, int]:
    """Return the outcome of a stopped run, from its log if there is one, and the exit status."""
    code = exit_status(error) if isinstance(error, (KeyboardInterrupt, SystemExit)) else 1
    if log.exists():
        return replayed(read_log(log)), code
    return RunOutcome("stopped", "", why_stopped(error)), code
