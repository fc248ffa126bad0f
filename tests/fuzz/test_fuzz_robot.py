"""Damaged logs of robot runs and files of tasks."""

import json

import pytest
from hypothesis import example, given
from mutations import cases, changed_json, damaged, place, reads_or_refuses

from jaxcell.robot.run_log import read_log
from jaxcell.robot.tasks.files import load_task


COMMON = {"cell_m": 1.0, "directions": 4, "step_m": 1.0, "robot_radius_m": 0.1}
TASKS = {
    "plan.json": {
        "command": "jaxcell navigate",
        **COMMON,
        "found": True,
        "start": 0,
        "actions_deg": [0.0, 0.0, 90.0, 0],
    },
    "team.json": {
        "format": "jaxcell-robot-task",
        "kind": "team",
        **COMMON,
        "robots": [
            {"start": [0.5, 0.5, 90.0], "bounce_deg": 135.0, "actions": "0012+-"},
            {"start": [1.5, 0.5, 0], "bounce_deg": 45, "actions": ""},
        ],
    },
    "patrol.json": {
        "format": "jaxcell-robot-task",
        "kind": "patrol",
        **COMMON,
        "range_m": 2.0,
        "origin_m": [0.0, 0.0],
        "free": ["..", ".#"],
        "closed": [[0, 0], [1, 2]],
        "robots": [{"start": 0, "image": [[2, 0, 0]], "probability": [[1.0, 1.0, 1.0]]}],
    },
}
LOG = [
    {"format": "jaxcell-robot-log", "version": 1, "kind": "filter", "file": "f.jxf", "cell_m": 1},
    {"event": "start", "seconds": 0.1},
    {"event": "observation", "seconds": 0.2, "observation": 1, "color": 1, "estimate": [0.1, 0, 0]},
    {"event": "observation", "seconds": 0.3, "observation": 0, "color": 2, "estimate": [0, 0, 1.5]},
    {"event": "end", "seconds": 0.4, "result": "localized", "reason": "x"},
]


def lines(events):
    return "".join(json.dumps(event) + "\n" for event in events).encode()


def use(path):
    """Reads a task, and makes the header of its log."""
    task = load_task(path)
    assert len(task.strides) == task.directions
    json.dumps(task.header, allow_nan=False)


@cases()
@given(changed_json(TASKS))
@example(("plan.json", json.dumps(TASKS["plan.json"] | {"cell_m": 10**400}).encode()))
@example(("plan.json", json.dumps(TASKS["plan.json"] | {"cell_m": 0}).encode()))
@example(("plan.json", json.dumps(TASKS["plan.json"] | {"directions": 10**12}).encode()))
@example(("plan.json", b"[" * 100_000))
def test_changed_tasks(tmp_path, file):
    reads_or_refuses(use, place(tmp_path, *file))


@cases()
@given(damaged({name: json.dumps(task).encode() for name, task in TASKS.items()}))
def test_damaged_tasks(tmp_path, file):
    reads_or_refuses(use, place(tmp_path, *file))


@cases()
@given(damaged({"run.jsonl": lines(LOG)}))
def test_damaged_logs(tmp_path, file):
    path = place(tmp_path, *file)
    if reads_or_refuses(read_log, path):
        run = read_log(path)
        assert set(run.observations) <= {"0", "1"}
        assert isinstance(run.colors, list)


@cases()
@given(changed_json({str(i): event for i, event in enumerate(LOG)}))
@example(("2", b'{"event": "observation", "observation": true}'))
@example(("2", b'{"event": "observation", "observation": 1.0}'))
@example(("2", b'{"event": "observation", "observation": 1, "color": null}'))
@example(("0", b"[" * 100_000))
def test_changed_logs(tmp_path, event):
    number, text = event
    content = [json.dumps(line).encode() for line in LOG]
    content[int(number)] = text
    path = place(tmp_path, "run.jsonl", b"\n".join(content) + b"\n")
    if reads_or_refuses(read_log, path):
        run = read_log(path)
        assert set(run.observations) <= {"0", "1"}
        assert isinstance(run.colors, list)


def test_the_undamaged_ones_are_read(tmp_path):
    for name, task in TASKS.items():
        assert reads_or_refuses(use, place(tmp_path, name, json.dumps(task).encode()))
    assert read_log(place(tmp_path, "run.jsonl", lines(LOG))).observations == "10"


def test_positions_that_would_wrap_around(tmp_path):
    """2^32 is 0 in 32 bits, which is a position."""
    task = json.loads(json.dumps(TASKS["patrol.json"]))
    task["robots"][0]["image"] = [[2**32 + 2, 2**32, 0]]
    path = place(tmp_path, "patrol.json", json.dumps(task).encode())
    with pytest.raises(ValueError, match=r"robots\[0\]\.image: expected finite numbers of at most"):
        load_task(path)


@pytest.mark.parametrize("robot", [-1, 2, 10**30])
def test_a_missing_robot_of_a_team_is_refused(tmp_path, robot):
    path = place(tmp_path, "team.json", json.dumps(TASKS["team.json"]).encode())
    with pytest.raises(ValueError, match=r"team\.json: there is no robot"):
        load_task(path, robot)
