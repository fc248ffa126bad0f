import json
import math

import pytest
import serial
from wheels import bounce_filter, map_cells

from jaxcell.robot.create.firmware import firmware
from jaxcell.robot.create.packets import Mode
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.emulator import BANNER, Emulator, Line
from jaxcell.robot.tasks.files import FilterTask, PlanTask, load_task


LAB = map_cells("lab_a.json")
SPEC = {"cell_m": 1.0, "directions": 8, "step_m": 1.0, "robot_radius_m": 0.0}


def test_a_filter_is_read_with_the_numbers_of_its_map(tmp_path):
    path = tmp_path / "filter.jxf"
    bounce_filter(LAB, 45, metadata={**SPEC, "bounce_deg": 45}).save(path)
    task = load_task(path)
    assert isinstance(task, FilterTask)
    assert task.bounce == math.radians(45)
    assert (task.cell, task.directions, task.step, task.radius) == (1.0, 8, 1.0, 0.0)
    assert task.strides[1] == pytest.approx([math.sqrt(2), 0])
    assert task.header["kind"] == "filter"
    json.dumps(task.header)


def test_a_plan_is_read(tmp_path):
    path = tmp_path / "summary.json"
    path.write_text(json.dumps({**SPEC, "found": True, "start": 3, "actions_deg": [0, 135, 0]}))
    task = load_task(path)
    assert isinstance(task, PlanTask)
    assert task.start == 3
    assert task.actions == (0, math.radians(135), 0)
    assert task.header["actions"] == task.actions


def test_a_reset_prints_the_firmware():
    body = Body(LAB.workspace, (0.5, 0.5, 0.0))
    with (
        Emulator(body, line=Line(speedup=20.0)) as robot,
        serial.serial_for_url(robot.port, 115200) as line,
    ):
        assert firmware(line).encode() == BANNER.replace(b"\r", b"").strip()
        assert robot.mode is Mode.OFF
