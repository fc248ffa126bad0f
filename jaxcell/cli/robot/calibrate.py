import dataclasses
import math
from pathlib import Path
from typing import Annotated, ClassVar

from ...base.documents import checked_number
from ...study.parameters import Only, check
from ..output import Printing
from ..terminal import note, say, status


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotCalibrate(Printing):
    """Calibrate a robot: drive it 1 m, turn it by 360 degrees, and ask for the true values.

    Leave 1.5 m of free floor ahead of the robot, and mark its place and its heading on the floor.
    `jaxcell robot run` uses the calibration. Earlier calibrations do not affect the measurement."""

    example: ClassVar[str] = "--port /dev/ttyUSB0"
    one_of: ClassVar[tuple[str, ...]] = ("port", "log")

    port: str | None = None
    """Serial line of the robot, such as /dev/ttyUSB0 or socket://host:port."""
    log: Annotated[Path | None, Only(port=False)] = None
    """Log (run.jsonl) of a robot that ran a file anywhere.json. It is used to estimate the angle by
    which a bump into a wall at 45 degrees turns the robot, for the error
    bump_turn of `jaxcell localize slip`."""
    file: Annotated[Path | None, Only(log=True)] = None
    """The anywhere.json of the logged run; by default the file named in the log."""
    calibration: Path | None = None
    """File of the calibration; by default calibration.json in ~/.config/jaxcell."""

    def run(self) -> int:
        check(self)
        return self._estimate() if self.port is None else self._measure(self.port)

    def _estimate(self) -> int:
        from ...robot.bump_turn import estimate_bump_turn
        from ...robot.run_log import read_log
        from ...robot.tasks.anywhere_task import AnywhereTask
        from ...robot.tasks.files import load_task

        assert self.log is not None
        run = read_log(self.log)
        task = load_task(self.file or str(run.header.get("file")))
        if not isinstance(task, AnywhereTask) or run.header.get("kind") != "anywhere":
            raise ValueError(f"--log {self.log}: expected the run of an anywhere.json")
        with status("following the robot of the log"):
            degrees = round(math.degrees(estimate_bump_turn(run, task.settings)), 2)
        text = (
            f"A bump at 45 degrees turns the robot by {degrees:g} degrees to the wall, which "
            f"its encoders do not show: `jaxcell localize slip --errors slip=2% "
            f"bump_turn={degrees:g}deg`"
        )
        self.report({"log": str(self.log), "bump_turn_deg": degrees}, lambda: say(text))
        return 0

    def _measure(self, port: str) -> int:
        from ...robot import Create, RobotStopped
        from ...robot.calibration import Calibration, calibration_file

        path = self.calibration or calibration_file()
        try:
            with Create.open(port) as robot:
                robot.arm()
                went = robot.forward(1.0, tolerance=0.002)
                if went.bumped:
                    note("jaxcell robot calibrate: the robot bumped; it needs 1 m of free floor")
                    return 1
                distance = _asked("How far did the robot go, in metres? ") / went.distance
                # A robot that was lifted for the measurement is disarmed.
                robot.arm()
                turned = robot.turn(2 * math.pi, tolerance=math.radians(0.4)).angle
                degrees = _asked("By how many degrees did the robot turn to the left? ")
        except RobotStopped as error:
            note(f"jaxcell robot calibrate: the robot was stopped: {error}")
            return 1
        calibration = Calibration.measured(distance, math.radians(degrees) / turned)
        calibration.save(path)
        summary = {"calibration": str(path), **dataclasses.asdict(calibration)}
        text = (
            f"For 1 m of the encoders the robot drives {calibration.distance:g} m, and for 360 "
            f"degrees it turns by {360 * calibration.angle:g} degrees. This is kept in {path}."
        )
        self.report(summary, lambda: say(text))
        return 0


def _asked(question: str) -> float:
    """Print a question to standard error, and read a number from standard input."""
    note(question)
    try:
        return checked_number("the answer", input().strip(), "a number", text=True)
    except EOFError:
        raise ValueError("expected an answer on standard input, found its end") from None
