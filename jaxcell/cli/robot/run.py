import contextlib
import dataclasses
import json
import math
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import tyro

from ...base.optional_modules import has_module
from ...base.paths import name_in_results
from ...study.study import Degrees
from ..options import Printing, check_heading, direction_at, write_text
from ..terminal import note, note_results, say, status
from ..view import shown_live
from .emulation import check_speed, emulate
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
class RobotRun(Printing):
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
    ros: Literal["create3", "base"] | None = None
    """Drive a robot on ROS 2 instead: a Create 3 or TurtleBot 4 by its actions, or any base by
    cmd_vel, odom and bumper. Where it may be is published as candidates and candidate_squares."""
    remap: tuple[str, ...] = ()
    """Rules for the names of ROS, such as __ns:=/robot1 or cmd_vel:=/base/cmd_vel."""
    simulate: Path | None = None
    """Map in which to emulate the robot instead; it may be another than that of the file."""
    start: str | None = None
    """Start of the emulated robot, and of any that patrols: "x,y,heading" in m and degrees, or a
    cell; by default that of what is run, or random."""
    heading: Degrees | None = None
    """Heading of the robot at the start in degrees, by default that of the plan, team or patrol. A
    filter, policy or belief does not use it, but steps along a diagonal are longer: where steps
    differ between directions, the robot needs it, and an emulated robot does too."""
    steps: Literal["encoder", "clock"] = "encoder"
    """Whether the encoders of the wheels tell how far the robot has gone, or the time that it took
    at a known speed."""
    tolerance: float | None = None
    """How near the end of a step is near enough by the encoders, in metres; by default 4 mm, or
    less for steps below 1 m."""
    turn_tolerance: float = 0.4
    """How near the end of a turn is near enough by the encoders, in degrees."""
    give: float | None = None
    """How far the bumper of the emulated robot goes in before it feels a wall, in metres; by
    default 0.02 times the square of the cell, at most 0.02 and at least 0.0005."""
    noise: float = 0.0
    """Standard deviation of the relative error of the emulated robot's steps and turns, and of its
    veer in radians a metre."""
    physics: bool = False
    """Let a physics engine move the emulated robot, a Create 2 of its true size among the walls of
    the map: a bump turns it, and its wheels may slip."""
    friction: float | None = None
    """Coefficient of friction between the wheels and the floor, with --physics; by default 0.8."""
    speed: float | None = None
    """Speed of the robot on straight ways in m/s, up to 0.5; by default 0.2."""
    speedup: float = 10.0
    """Seconds of the emulated robot in a second, at most."""
    seed: int = 0
    """Seed of the random start, of the noise, and of the draws of a patrol."""
    limit: int = 10_000
    """Observations after which to give up."""
    until: Literal["known", "cycle"] = "known"
    """End of the run of a filter: one configuration left or a knowledge cycle, or only the
    cycle."""
    visits: int = 100
    """Drawn cells after which a patrol is over."""
    bumps: int = 20
    """Bumps where the map is free after which a patrol is given up."""
    intruder: str | None = None
    """Where the emulated map has an intruder, "x,y" in metres, whom a robot on patrol reports."""
    camera: str | None = None
    """What a robot on patrol looks for the cross marker with: the number of a camera, or a folder
    of pictures."""
    calibration: Path | None = None
    """File of `jaxcell robot calibrate`; by default, for a robot on a line, calibration.json in
    ~/.config/jaxcell if it is there. Steps by the clock have none."""
    resume: Path | None = None
    """The run.jsonl of a run of this file that was stopped, to go on from there. The robot stands
    where its last step ended and faces the way of its next; an emulated one stands at --start."""
    out: Path | None = None
    """Directory for the log, which must not be there yet, the recording and summary.json."""
    live: str | None = None
    """Viewer that shows the recording as the run goes: "here" (without a display a page for a
    browser, until Ctrl-C), or the address of one, such as rerun+http://laptop:9876/proxy."""

    def run(self) -> int:
        with contextlib.ExitStack() as kept:
            return self._run_with(kept)

    def _run_with(self, kept: contextlib.ExitStack) -> int:
        import numpy as np

        from ...robot import RobotStopped, read_log
        from ...robot.tasks.anywhere_task import AnywhereTask
        from ...robot.tasks.files import load_task

        if sum(place is not None for place in (self.port, self.ros, self.simulate)) != 1:
            raise ValueError("expected one of --port, --ros and --simulate")
        if self.remap and self.ros is None:
            raise ValueError("--remap: it is for --ros")
        if self.ros is not None and self.steps == "clock":
            raise ValueError("--steps clock: a robot on ROS 2 goes by its odometry")
        if self.out is not None and (self.out / _LOG).exists():
            raise FileExistsError(
                f"--out {self.out}: {_LOG} of another run is there, and no log is replaced; "
                "expected another directory"
            )
        check_speed(self)
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
        # Before the robot is there: what it needs takes seconds to load.
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
            goes_on = outcome.result == "stopped" and outcome.observations
            if self.out is not None and goes_on and not isinstance(task, AnywhereTask):
                after = read_log(self.out / _LOG)
                start = None
                if emulation is not None:
                    places = (
                        self._place(task, emulation, direction, run) for run in (before, after)
                    )
                    start = start_after(emulation.pose, *places)
                note(f"To go on from there:\n{resume_command(self, self.out / _LOG, start)}")
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
                f"There is no Rerun here for a recording. Elsewhere: jaxcell robot replay "
                f"{self.out / _LOG} --file {self.file.name} --out {self.out}"
            )
        if code is not None:
            return code
        return 0 if outcome.result in ("localized", "arrived", "patrolled", "reported") else 1

    def _before(self, task: "AnyTask") -> "LoggedRun | None":
        """The run that is to go on, if one is."""
        if self.resume is None:
            return None
        if self.heading is not None:
            raise ValueError("--heading: a run that goes on has that of its log")
        if self.simulate is not None and self.start is None:
            raise ValueError("--resume: expected --start as well, where the emulated robot stands")
        return run_before(self.resume, task)

    def _resumed(self, before: "LoggedRun") -> dict[str, Any]:
        """What the log says of the run before this one."""
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
        """Say where the robot must stand to go on, and wait until somebody says that it does."""
        place = self._place(task, emulation, direction, before)
        note(f"The run goes on where the robot is {place_in_words(place)}")
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
        """The direction that the robot knows to face at the start, or `None`.

        It is the same on an emulated robot as on a real one.

        **Raises:** `ValueError` if the task needs a direction, and none is known.
        """
        from ...robot.tasks.anywhere_task import AnywhereTask
        from ...robot.tasks.patrol_task import PatrolTask

        if isinstance(task, AnywhereTask):
            if self.heading is not None:
                raise ValueError("--heading: a robot that starts anywhere needs none")
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
        """What the encoders of the robot miss, if that is known."""
        from ...robot.calibration import Calibration, calibration_file

        if self.calibration is not None:
            if self.steps == "clock":
                raise ValueError("--calibration: it is of the encoders, not for --steps clock")
            return Calibration.load(self.calibration)
        path = calibration_file()
        if self.port is None or self.steps == "clock" or not path.exists():
            return None
        note(f"The robot goes by the calibration in {path}")
        return Calibration.load(path)

    def _robot(
        self, stack: contextlib.ExitStack, task: "AnyTask", emulation: "Emulation | None"
    ) -> "tuple[Any, list[Listener]]":
        """The robot, armed, and who listens to the events of its run."""
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
        """The robot as it tells how far it goes."""
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
    """How a run stands that was stopped, by its log if there is one, and the exit status."""
    from ...robot.outcome import RunOutcome
    from ...robot.run_log import read_log, why_stopped

    code = 130 if isinstance(error, KeyboardInterrupt) else 1
    if isinstance(error, SystemExit):
        code = int(error.code or 0)
    if log.exists():
        return replayed(read_log(log)), code
    return RunOutcome("stopped", "", why_stopped(error)), code
