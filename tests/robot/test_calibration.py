import json
import math

import numpy as np
import pytest
from numpy.random import PCG64

from jaxcell.cli import main
from jaxcell.robot.calibration import Calibrated, Calibration, calibration_file
from jaxcell.robot.create.motion import Create
from jaxcell.robot.emulation.body import Body, Noise
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.emulation.emulator import Emulator, Line
from jaxcell.robot.walker import Walker
from jaxcell.space import Workspace


HALL = Workspace([(-9, -9), (9, -9), (9, 9), (-9, 9)])


class Always(np.random.Generator):
    """A random generator whose noise is always one standard deviation."""

    def normal(self, mean, deviation, size=None):
        return np.asarray(deviation, float)


def worn(pose=(0.0, 0.0, 0.0)) -> Body:
    """A body that goes 5 % and turns 3 % farther than its encoders measure."""
    return Body(HALL, pose, noise=Noise(distance=0.05, rotation=0.03), rng=Always(PCG64()))


def test_a_calibrated_robot_goes_where_it_is_sent():
    for calibration, error in ((Calibration(), 0.1), (Calibration(1.05, 1.03), 1e-3)):
        body = worn()
        walker = Walker(Calibrated(DirectBody(body), calibration), 1.0)
        for _ in range(3):
            walker.step()
        walker.rotate(math.pi / 2)
        walker.step()
        off = math.hypot(body.x - 3, body.y - 1)
        assert (off > error) is (error == 0.1), off
        assert walker.estimate == pytest.approx((3, 1, math.pi / 2), abs=0.01)


@pytest.mark.usefixtures("patient")
def test_a_calibration_is_measured_kept_and_used(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert calibration_file() == tmp_path / "jaxcell" / "calibration.json"
    body = worn()
    with Emulator(body, line=Line(speedup=20.0)) as robot:
        answers = iter([lambda: robot.pose[0], lambda: math.degrees(robot.pose[2])])
        monkeypatch.setattr("builtins.input", lambda: f" {next(answers)()} \n")
        assert main(["robot", "calibrate", "--port", robot.port, "--json"]) == 0
        printed = capsys.readouterr()
        result = json.loads(printed.out)
        assert result.pop("calibration") == str(calibration_file())
        assert result == pytest.approx({"distance": 1.05, "angle": 1.03}, abs=3e-3)
        assert "How far did the robot go, in metres?" in printed.err
        calibration = Calibration.load(calibration_file())
        before = robot.pose
        with Create.open(robot.port, patience=5.0) as create:
            create.arm()
            Calibrated(create, calibration).forward(1.0, tolerance=0.002)
        assert math.dist(robot.pose[:2], before[:2]) == pytest.approx(1.0, abs=0.006)


@pytest.mark.usefixtures("patient")
def test_answers_that_are_no_measurements_are_refused(tmp_path, monkeypatch, capsys):
    path = tmp_path / "calibration.json"
    with Emulator(worn(), line=Line(speedup=20.0)) as robot:
        for answer in ("far", "10"):
            monkeypatch.setattr("builtins.input", lambda answer=answer: answer)
            words = ["robot", "calibrate", "--port", robot.port, "--calibration", str(path)]
            assert main(words) == 2
    errors = capsys.readouterr().err
    assert "the answer: expected a number, got 'far'" in errors
    assert "distance: expected a number from 0.5 to 2.0, got 10" in errors
    assert not path.exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not valid JSON"),
        ("{}", "expected the file of `jaxcell robot calibrate`"),
        ('{"format": "jaxcell-robot-calibration"}', "distance: expected a finite number"),
        (
            '{"format": "jaxcell-robot-calibration", "distance": 1.0, "angle": 3.0}',
            "angle: expected a number from 0.5 to 2.0, got 3.0",
        ),
    ],
)
def test_damaged_calibrations_are_refused(tmp_path, text, message):
    path = tmp_path / "calibration.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        Calibration.load(path)
    assert str(caught.value).startswith(str(path))
    with pytest.raises(FileNotFoundError):
        Calibration.load(tmp_path / "none.json")
