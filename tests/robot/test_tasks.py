"""Files of tasks are read; with one wrong value they are refused with the file and the field."""

import json
import math

import numpy as np
import pytest
from wheels import bounce_filter, map_cells

from jaxcell.robot import load_task, save_patrols, save_team
from jaxcell.robot.tasks.anywhere_task import save_anywhere
from jaxcell.robot.tasks.files import FilterTask, PlanTask


LAB = map_cells("lab_b.json")
SIZES = {"cell_m": 1.0, "directions": 8, "step_m": 1.0}
SPEC = SIZES | {"robot_radius_m": 0.0}
BOUNDS = {"run": 0.01, "distance": 0.05, "turn": 0.03, "displacement": 0.06}


def save(kind, path, actions_deg=(0,)):
    if kind == "plan":
        plan = {"found": True, "start": 3, "actions_deg": actions_deg}
        path.write_text(json.dumps(SPEC | plan))
    elif kind == "team":
        save_team(path, SPEC, [(0.5, 0.5, 0.0)], [math.pi / 2], ["01"])
    elif kind == "anywhere":
        fields = {"bounce_deg": [70.0], "headings": None, "slices": 8, "errors": BOUNDS}
        save_anywhere(path, LAB.workspace, **SIZES, **fields, counted_m=0.0, known_m=0.5)
    else:
        image = np.arange(LAB.positions)[None].repeat(3, 0)
        image[1:] = np.roll(image[1:], 1, axis=1)
        save_patrols(path, LAB, [(image, np.full(image.shape, 1 / 3))], [0], 2.5)


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
    save("plan", tmp_path / "summary.json", actions_deg=[0, 135, 0])
    task = load_task(tmp_path / "summary.json")
    assert isinstance(task, PlanTask)
    assert task.start == 3
    assert task.actions == task.header["actions"] == (0, math.radians(135), 0)


# A kind of task, the place of a value in the file, the wrong value, and the error.
DAMAGES = [
    ("plan", "found", False, "there is no path"),
    ("plan", "actions_deg", None, "actions_deg: expected a list of angles"),
    ("plan", "actions_deg", [0, "x"], "actions_deg: expected a list of angles"),
    ("plan", "step_m", None, "step_m: expected a finite number"),
    ("plan", "cell_m", math.inf, "cell_m: expected a finite number"),
    ("plan", "directions", True, "directions: expected a whole number"),
    ("plan", "start", "3", "start: expected a whole number from 0"),
    ("plan", "start", 2.5, "start: expected a whole number from 0"),
    ("plan", "start", -1, "start: expected a whole number from 0"),
    ("team", "robots/0/actions", "01x", r"robots\[0\].actions: expected a text of 0, 1, 2, \+ "),
    ("team", "robots/0/start", [0, 1], r"robots\[0\].start: expected numbers, 3 of them"),
    ("team", "robots/0/start", [0, 1, math.nan], r"robots\[0\].start: expected finite numbers"),
    ("team", "robots/0/bounce_deg", None, r"robots\[0\].bounce_deg: expected a finite number, "),
    ("anywhere", "errors", {"run": 2.0}, "errors: run: expected a share below 1"),
    ("anywhere", "errors", {"luck": 0.1}, "luck"),
    ("anywhere", "bounce_deg", [], "bounce_deg: expected a list of at least 1 angles"),
    ("anywhere", "slices", 1, "slices: expected"),
    ("anywhere", "boundary", [[0, 0], [1, 1]], "boundary"),
    ("patrol", "free", 3, "free: expected a list of rows"),
    ("patrol", "free", ["..", "."], "free: expected rows of . and #, of one length"),
    ("patrol", "free", ["##", "##"], "free: expected rows .* with a . or more"),
    ("patrol", "free", ["", ""], "free: expected rows .* with a . or more"),
    ("patrol", "directions", 8, "directions: expected 4"),
    ("patrol", "closed", [[99, 0]], "closed: position 99 does not exist"),
    ("patrol", "closed", [[0, 0, 1]], "closed: expected whole numbers, any x 2"),
    ("patrol", "closed", [[0, 0], [0, 1]], r"robots\[0\] walks to position .* which no path along"),
    ("patrol", "range_m", -1, "range_m: expected a finite number from 0, got -1"),
    ("patrol", "robots", {}, "robots: expected a list, got {}"),
    ("patrol", "robots/0/start", 99, r"robots\[0\].start: expected a whole number"),
    ("patrol", "robots/0/image/0/0", 19, "image: expected states from"),
    ("patrol", "robots/0/image/0", [1], "image: expected whole numbers, any x any"),
    ("patrol", "robots/0/image", [[0] * 20], "image: expected rows of 19 states, or a multiple"),
    ("patrol", "robots/0/probability", [[1.0]], "probability: expected numbers, 3 x 19"),
    ("patrol", "robots/0/probability/0/0", 2.0, "probability: expected from 0, with the sum 1"),
]


@pytest.mark.parametrize(("kind", "place", "value", "message"), DAMAGES)
def test_a_wrong_value_is_refused_with_its_field(tmp_path, kind, place, value, message):
    path = tmp_path / "task.json"
    save(kind, path)
    load_task(path)
    part = values = json.loads(path.read_text())
    *folders, name = [int(word) if word.isdecimal() else word for word in place.split("/")]
    for folder in folders:
        part = part[folder]
    part[name] = value
    path.write_text(json.dumps(values))
    with pytest.raises(ValueError, match=message) as caught:
        load_task(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("kind", ["team", "patrol"])
def test_a_robot_that_does_not_exist_is_refused(tmp_path, kind):
    save(kind, tmp_path / "task.json")
    with pytest.raises(ValueError, match="there is no robot 1; robots are 0 to 0"):
        load_task(tmp_path / "task.json", 1)


def test_damaged_and_missing_files_are_refused(tmp_path):
    path = tmp_path / "filter.jxf"
    bounce_filter(LAB, 45, metadata=SPEC).save(path)
    with pytest.raises(ValueError, match="bounce_deg: expected a list of at least 1 angles"):
        load_task(path)
    for text in ("{", "[]"):
        (tmp_path / "plan.json").write_text(text)
        with pytest.raises(ValueError, match=r"plan\.json: "):
            load_task(tmp_path / "plan.json")
    with pytest.raises(FileNotFoundError):
        load_task(tmp_path / "none.jxf")
