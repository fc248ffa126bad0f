"""Files that robots run, of the dissertation's Lab A, and commands that run them in its map."""

import dataclasses
import json
import math

import numpy as np
from wheels import MAPS, bounce_filter, map_cells

from jaxcell.bounce import FineCells, localization_policy, slip_map
from jaxcell.cli.robot.run import RobotRun
from jaxcell.space import Slip


LAB = map_cells("lab_a.json")
SPEC = {"cell_m": 1.0, "directions": 8, "step_m": 1.0, "robot_radius_m": 0.0}


def save_filter(folder, **about):
    path = folder / "filter.jxf"
    bounce_filter(LAB, 45, metadata={**SPEC, "bounce_deg": 45, **about}).save(path)
    return path


def save_policy(folder):
    path = folder / "policy.jxf"
    about = {**SPEC, "bounce_deg": [45.0, 135.0]}
    localization_policy(LAB, np.radians([45.0, 135.0]), metadata=about).policy.save(path)
    return path


def save_belief(folder):
    path = folder / "belief.jxb"
    fine = FineCells.of(LAB, squares=3, directions=4, reach=2)
    hidden = slip_map(fine, [math.radians(45)], Slip.of(0.02))
    dataclasses.replace(hidden, metadata={**SPEC, "bounce_deg": 45}).save(path)
    return path


def simulated(file, name="lab_a.json", **fields) -> RobotRun:
    return RobotRun(file=file, simulate=MAPS / name, speedup=1e6, json=True, **fields)


def run(command, capsys) -> tuple[int, dict]:
    """The exit status of a command, and what it prints."""
    code = command.run()
    return code, json.loads(capsys.readouterr().out)
