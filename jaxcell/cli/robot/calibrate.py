import dataclasses
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.documents import checked_number
from ..options import Printing
from ..terminal import note, say


if TYPE_CHECKING:
    from ...robot.calibration import Calibration


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotCalibrate(Printing):
    """Drive a robot 1 m and turn it by 360 degrees, ask what it truly did, and keep that.

    Put it where it has 1.5 m ahead, and mark where its front is. `jaxcell robot run` uses what is
    kept. Where the robot has a calibration, it is measured anew without it."""

    port: str
    """Serial line of the robot, such as /dev/ttyUSB0 or socket://host:port."""
    calibration: Path | None = None
    """File to keep it in, by default calibration.json in ~/.config/jaxcell."""

    def run(self) -> int:
        from ...robot import Create, RobotStopped
        from ...robot.calibration import Calibration, calibration_file

        path = self.calibration or calibration_file()
        try:
            with Create.open(self.port) as robot:
                robot.arm()
                went = robot.forward(1.0, tolerance=0.002)
                if went.bumped:
                    note("jaxcell robot calibrate: it bumped; expected 1 m of free floor ahead")
                    return 1
                distance = _asked("How far did it go, in metres? ") / went.distance
                # Whoever measured it may have lifted it.
                robot.arm()
                turned = robot.turn(2 * math.pi, tolerance=math.radians(0.4)).angle
                degrees = _asked("By how many degrees did it turn, to the left? ")
        except RobotStopped as error:
            note(f"jaxcell robot calibrate: the robot was stopped: {error}")
            return 1
        found = Calibration.measured(distance, math.radians(degrees) / turned)
        found.save(path)
        self._say(found, path)
        return 0

    def _say(self, found: "Calibration", path: Path) -> None:
        summary = {"calibration": str(path), **dataclasses.asdict(found)}
        if self.json:
            say(json.dumps(summary))
        else:
            say(
                f"Where the encoders say 1 m it goes {found.distance:g} m, and where they say "
                f"360 degrees it turns by {360 * found.angle:g}. That is in {path}."
            )


def _asked(question: str) -> float:
    """The number that a person answers with; the question goes to standard error."""
    note(question)
    try:
        return checked_number("the answer", input().strip(), "a number", text=True)
    except EOFError:
        raise ValueError("expected an answer on standard input, found its end") from None
