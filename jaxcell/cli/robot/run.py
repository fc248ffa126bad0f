import contextlib
import dataclasses
import json
import math
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from ...base.optional_modules import has_module
from ...base.paths import name_in_results
from ...study.parameters import check
from ..output import write_text
from ..terminal import note, note_results, say, status
from ..view import shown_live
from .emulation import emulate
from .heading import check_heading, direction_at
from .options import RobotOptions
from .recording import cells_of, recording_of
from .replay import replayed, show
from .resume import (
    Standing,
    StandingStill,
    place_in_words,
    resume_command,
    run_before,
    start_after,
)
from .runners import patrol_start, runner_of


if TYPE_CHECKING:
    from ...robot.calibration import Calibration
    from ...robot.outcome import RunOutcome
    from ...robot.run_log import LoggedRun
    from ...robot.tasks.files import AnyTask
    from ...robot.walker import Drivable, Walker
    from .emulation import Emulation
    from .resume import Place
    from .runners import Runner

    Listener: TypeAlias = Callable[[str, Mapping[str, Any]], None]


_LOG, _RECORDING = "run.jsonl", "run.rrd"


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotRun(RobotOptions):
    """Run a filter, a plan, or a robot of a team or a patrol, on a robot or an emulated one.

    The robot stops, and the run ends, at Ctrl-C."""

    example: ClassVar[str] = "runs/lab/filter.jxf --simulate @lab_a --heading 0 --out runs/emulated"
    one_of: ClassVar[tuple[str, ...]] = ("port", "ros", "simulate")

    def run(self) -> int:
        with contextlib.ExitStack() as kept:
            return self._run_with(kept)

    def _run_with(self, kept: contextlib.ExitStack) -> int:
        import numpy as np

        from ...robot import RobotStopped, read_log
        from ...robot.tasks.anywhere_task import AnywhereTask
        from ...robot.tasks.files import load_task

        check(self)
        if self.out is not None and (self.out / _LOG).exists():
            raise FileExistsError(
                f"--out {self.out}: it has the {_LOG} of another run, and no log is replaced; "
                "expected another folder"
            )
        task = load_task(self.file, self.robot)
        before, calibration = self._before(task), self._calibration()
        emulation = None
        if self.simulate is not None:
            emulation = emulate(self.simulate, task, self, np.random.default_rng(self.seed))
        direction = self._direction(task, emulation, before)
        runner = runner_of(task, self, emulation, direction, before)
        pose = None if emulation is None else emulation.pose
        if before is not None:
            pose = before.header.get("pose")
            self._ask_for_place(task, emulation, direction, before)
        # Before the connection to the robot, because the imports take seconds.
        viewer = None if self.live is None else kept.enter_context(shown_live(self.live))
        place = self.out or Path(kept.enter_context(tempfile.TemporaryDirectory()))
        place.mkdir(parents=True, exist_ok=True)
        recording = None
        if has_module("rerun") and (self.out or viewer):
            recording = recording_of(
                task, place / _RECORDING, start=pose, emulation=emulation, viewer=viewer
            )
        runner[0].update(
            pose=pose,
            resumed=None if before is None else self._resumed(before),
            calibration=None if calibration is None else dataclasses.asdict(calibration),
        )
        code = None
        try:
            with contextlib.ExitStack() as stack:
                robot, listeners = self._robot(stack, task, emulation)
                moving = self._moving(robot, emulation, calibration)
                walker = self._walker(moving, task, emulation, direction, before)
                if recording is not None:
                    listeners.append(stack.enter_context(recording).event)
                outcome = self._run(walker, runner, place / _LOG, listeners)
        except (RobotStopped, KeyboardInterrupt, SystemExit) as error:
            outcome, code = _stopped(error, place / _LOG)
            note(f"jaxcell robot run: {outcome.reason}")
            resumable = outcome.result == "stopped" and outcome.observations
            if self.out is not None and resumable and not isinstance(task, AnywhereTask):
                after = read_log(self.out / _LOG)
                start = None
                if emulation is not None:
                    places = (
                        self._place(task, emulation, direction, run) for run in (before, after)
                    )
                    start = start_after(emulation.pose, *places)
                note(f"To resume:\n{resume_command(self, self.out / _LOG, start)}")
        self._report(outcome, emulation)
        if code is not None:
            return code
        return 0 if outcome.result in ("localized", "arrived", "patrolled", "reported") else 1

    def _report(self, outcome: "RunOutcome", emulation: "Emulation | None") -> None:
        """Print the summary of a run, and write it to `out`."""
        summary = {
            "command": "jaxcell robot run",
            "file": name_in_results(self.file),
            "port": self.port if self.ros is None else f"ROS 2, {self.ros}",
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
        if self.out is not None and not has_module("rerun"):
            note(
                f"No recording is written without Rerun. Elsewhere: jaxcell robot replay "
                f"{self.out / _LOG} --file {self.file.name} --out {self.out}"
            )

    def _before(self, task: "AnyTask") -> "LoggedRun | None":
        """Read the run to resume, if any."""
        if self.resume is None:
            return None
        if self.simulate is not None and self.start is None:
            raise ValueError("--resume: expected --start too, the place of the emulated robot")
        return run_before(self.resume, task)

    def _resumed(self, before: "LoggedRun") -> dict[str, Any]:
        """Describe the run before this one, for the log."""
        from ...robot.tasks.task import digest

        assert self.resume is not None
        return {
            "log": str(self.resume.absolute()),
            "sha256": digest(self.resume),
            "observations": len(before.observations),
        }

    def _ask_for_place(
        self,
        task: "AnyTask",
        emulation: "Emulation | None",
        direction: int | None,
        before: "LoggedRun",
    ) -> None:
        """Print the place where the robot must stand, and wait for Enter on a terminal."""
        place = self._place(task, emulation, direction, before)
        note(f"The robot must stand {place_in_words(place)}")
        if self.simulate is None and not self.json and sys.stdin.isatty():
            input("Press Enter when it stands there: ")

    def _place(
        self,
        task: "AnyTask",
        emulation: "Emulation | None",
        direction: int | None,
        run: "LoggedRun | None",
    ) -> "Place":
        """Compute the place of the robot after a logged run; without a run it is the start."""
        _, follow = runner_of(task, self, emulation, direction, run)
        walker = self._walker(Standing(), task, emulation, direction, run)
        with contextlib.suppress(StandingStill):
            follow(walker, None)
        return walker.place

    def _direction(
        self, task: "AnyTask", emulation: "Emulation | None", before: "LoggedRun | None"
    ) -> int | None:
        """Return the direction in which the robot starts, as far as it knows, or `None`.

        It is the same on an emulated robot as on a real one.

        **Raises:** `ValueError` if the task needs a direction, and none is known.
        """
        from ...robot.tasks.anywhere_task import AnywhereTask
        from ...robot.tasks.patrol_task import PatrolTask

        if isinstance(task, AnywhereTask):
            if self.heading is not None:
                raise ValueError("--heading: a robot that starts anywhere has no use for it")
            return None
        if before is not None:
            direction = before.direction
        elif self.heading is not None:
            direction = direction_at(self.heading, task.directions)
        elif isinstance(task, PatrolTask):
            direction = patrol_start(task, self.start, emulation) // task.cells.positions
        else:
            direction = task.start_direction
        if direction is None:
            check_heading(task)
        return direction

    def _calibration(self) -> "Calibration | None":
        """Read the calibration of the robot's encoders, if there is one."""
        from ...robot.calibration import Calibration, calibration_file

        if self.calibration is not None:
            return Calibration.load(self.calibration)
        path = calibration_file()
        if self.port is None or self.steps == "clock" or not path.exists():
            return None
        note(f"The robot uses the calibration in {path}")
        return Calibration.load(path)

    def _robot(
        self, stack: contextlib.ExitStack, task: "AnyTask", emulation: "Emulation | None"
    ) -> "tuple[Any, list[Listener]]":
        """Connect to the robot and arm it; return it with the listeners to its events."""
        from ...robot import Create

        if self.ros is not None:
            from ...robot import ros

            kind = ros.Create3 if self.ros == "create3" else ros.Base
            robot = stack.enter_context(kind(remap=self.remap))
            robot.arm()
            return robot, [ros.Candidates(robot, task, cells_of(task)).event]
        if emulation is not None:
            from ...robot.emulation.simulated import SimulatedCreate

            create: Create = stack.enter_context(SimulatedCreate(emulation.robot))
        else:
            assert self.port is not None
            create = stack.enter_context(Create.open(self.port))
            create.arm()
        create.speed = self.speed or create.speed
        return create, []

    def _moving(
        self, robot: Any, emulation: "Emulation | None", calibration: "Calibration | None"
    ) -> "Drivable":
        """Give the robot its source of distances: encoders, calibration, or clock."""
        from ...robot.calibration import Calibrated
        from ...robot.create.clock import ByClock

        if calibration is not None:
            return Calibrated(robot, calibration)
        if self.steps == "encoder":
            return robot
        if emulation is None:
            return ByClock(robot)
        return ByClock(robot, clock=lambda: emulation.robot.seconds, sleep=robot.sleep)

    def _walker(
        self,
        robot: "Drivable",
        task: "AnyTask",
        emulation: "Emulation | None",
        direction: int | None,
        before: "LoggedRun | None",
    ) -> "Walker":
        from ...robot.walker import Walker

        return Walker(
            robot,
            task.step,
            # Without a direction the strides are equal in all directions.
            strides=task.strides,
            direction=direction or 0,
            recalled="" if before is None else before.observations,
            tolerance=self.tolerance,
            turn_tolerance=math.radians(self.turn_tolerance),
        )

    def _run(
        self, walker: "Walker", runner: "Runner", path: Path, listeners: "list[Listener]"
    ) -> "RunOutcome":
        from ...robot.run_log import RunLog

        def tell(name: str, fields: Mapping[str, Any]) -> None:
            for listener in listeners:
                listener(name, fields)

        header, run = runner
        with RunLog(path, header) as log, status(f"running {self.file.name}"):
            log.on_event = tell
            return run(walker, log)


def _stopped(error: BaseException, log: Path) -> "tuple[RunOutcome, int]":
    """Return the outcome of a stopped run, from its log if there is one, and the exit status."""
    from ...robot.outcome import RunOutcome
    from ...robot.run_log import read_log, why_stopped

    code = 130 if isinstance(error, KeyboardInterrupt) else 1
    if isinstance(error, SystemExit):
        code = int(error.code or 0)
    if log.exists():
        return replayed(read_log(log)), code
    return RunOutcome("stopped", "", why_stopped(error)), code
