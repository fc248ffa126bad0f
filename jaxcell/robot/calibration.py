import dataclasses
import json
import os
from pathlib import Path

from ..base.documents import Fields, about, check_file, checked_number, decode_json, read_text
from ..base.paths import replacing
from ..base.shown import Shown
from .create.motion import Moved
from .walker import Drivable


_FORMAT, _VERSION = "jaxcell-robot-calibration", 1
# A larger error means other wheels.
_LEAST, _MOST = 0.5, 2.0


@dataclasses.dataclass(frozen=True)
class Calibration(Shown):
    """Factors that correct the distances and angles that the encoders of a robot measure.

    They are needed because wheels wear and sink into carpets, and robots of one kind differ by a
    few percent.

    A robot drove 0.98 m when its encoders measured 1 m, and turned by 365 degrees instead of 360:

        >>> from jaxcell import robot
        >>> robot.Calibration.measured(0.98 / 1.0, 365 / 360)
        Calibration(distance=0.98, angle=1.0139)
    """

    distance: float = 1.0
    "The metres that the robot drives per metre that the encoders measure."
    angle: float = 1.0
    "The radians by which the robot turns per radian that the encoders measure."

    def __post_init__(self) -> None:
        expected = f"a number from {_LEAST} to {_MOST}"
        for name, value in vars(self).items():
            checked_number(name, value, expected, least=_LEAST, most=_MOST)

    @classmethod
    def measured(cls, distance: float, angle: float) -> "Calibration":
        """Create a calibration from ratios of true to measured motion, rounded to four digits."""
        return cls(round(distance, 4), round(angle, 4))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Calibration":
        """Read a calibration from a file that `save` wrote."""
        path = Path(path)
        check_file(path, "a calibration")
        with about(path):
            values = decode_json(read_text(path), "a calibration")
            if not isinstance(values, dict) or values.get("format") != _FORMAT:
                raise ValueError("expected the file of `jaxcell robot calibrate`")
            fields = Fields(values)
            fields.check_version(_VERSION)
            return cls(fields.number("distance"), fields.number("angle"))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the calibration to a file, and create the folder of the file if necessary."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            values = {"format": _FORMAT, "version": _VERSION, **dataclasses.asdict(self)}
            temporary.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")


class Calibrated:
    """A robot whose distances and angles are corrected by a calibration."""

    def __init__(self, robot: Drivable, calibration: Calibration) -> None:
        self._robot, self._calibration = robot, calibration

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        ratio = self._calibration.distance
        return self._truly(self._robot.forward(distance / ratio, tolerance=tolerance / ratio))

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        ratio = self._calibration.angle
        return self._truly(self._robot.turn(angle / ratio, tolerance=tolerance / ratio))

    def _truly(self, moved: Moved) -> Moved:
        ratio, angle = self._calibration.distance, moved.angle * self._calibration.angle
        return Moved(moved.distance * ratio, angle, moved.bumped, moved.left * ratio)


def calibration_file() -> Path:
    """Return the default path of the calibration file.

    **Returns:** a path in `$XDG_CONFIG_HOME/jaxcell`, by default in `~/.config/jaxcell`.

        >>> from jaxcell import robot
        >>> robot.calibration_file().name
        'calibration.json'
    """
    home = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(home) / "jaxcell" / "calibration.json"
