import dataclasses
import json

import numpy as np
import pytest
from wheels import map_cells, walker_in

from jaxcell.bounce import bounce_map, localization_policy
from jaxcell.robot import (
    PolicyFollower,
    RunLog,
    Walker,
    load_task,
    read_log,
    replay_follower,
    run_follower,
)


LAB_A, LAB_B = map_cells("lab_a.json"), map_cells("lab_b.json")
BOUNCES = np.radians([45.0, 135.0]).tolist()


@pytest.fixture(scope="module")
def found():
    return localization_policy(LAB_A, BOUNCES)


class ModelWalker(Walker):
    """A walker that is in a cell of a map, and nowhere else."""

    def __init__(self, cells, cell):
        self.observations = ""
        self._cells, self._cell = cells, cell
        mapped = bounce_map(cells, BOUNCES[0])
        self._image, self._bumped = np.asarray(mapped.image), np.asarray(mapped.bumped)

    estimate = (0.0, 0.0, 0.0)

    def step(self):
        bumped = bool(self._bumped[self._cell])
        self.observations += str(int(bumped))
        if not bumped:
            self._cell = int(self._image[self._cell])
        return bumped

    def rotate(self, angle):
        direction, position = divmod(self._cell, self._cells.positions)
        direction = (direction + round(angle / (2 * np.pi) * 8)) % 8
        self._cell = direction * self._cells.positions + position

    @property
    def cell(self):
        return self._cell


@pytest.mark.parametrize("cell", [3, 70, 77, 151])
def test_the_robot_is_localized_to_its_true_configuration(cell, found, tmp_path):
    walker = ModelWalker(LAB_A, cell)
    with RunLog(tmp_path / "run.jsonl", {"kind": "policy"}) as log:
        outcome = run_follower(walker, PolicyFollower(found.policy), BOUNCES, log=log)
    assert outcome.result == "localized"
    run = found.drive(cell)
    assert outcome.observations == run.word
    assert outcome.cells == (run.end,) == (walker.cell,)
    assert set(outcome.colors[:-1]) == {1}
    assert outcome.colors[-1] > 1
    kept = read_log(tmp_path / "run.jsonl")
    assert replay_follower(kept, PolicyFollower(found.policy)) == outcome
    # The states of the log are those at bumps.
    states = [event["state"] for event in kept.events if event["event"] == "observation"]
    bumps = run.observations == 1
    assert [state for state in states if state is not None] == run.states[1:][bumps].tolist()


def test_an_emulated_robot_is_localized_as_the_model_is(found):
    walker, body = walker_in(LAB_A, 70)
    outcome = run_follower(walker, PolicyFollower(found.policy), BOUNCES)
    run = found.drive(70)
    assert outcome.observations == run.word
    assert outcome.cells == (run.end,) == (int(LAB_A.index(*body.pose)),)


def test_a_policy_of_another_map_is_refuted(found, tmp_path):
    # In lab B the robot bumps where it cannot in lab A.
    walker = ModelWalker(LAB_B, 77)
    with RunLog(tmp_path / "run.jsonl", {"kind": "policy"}) as log:
        outcome = run_follower(walker, PolicyFollower(found.policy), BOUNCES, log=log)
    assert outcome.result == "refuted"
    assert outcome.cells == ()
    assert outcome.colors[-1] == len(found.policy.ends) + 2
    assert f"the robot observed {outcome.observations}" in outcome.reason
    run = read_log(tmp_path / "run.jsonl")
    assert replay_follower(run, PolicyFollower(found.policy)) == outcome
    changed = tuple(dict(event, color=7) if "color" in event else event for event in run.events)
    with pytest.raises(ValueError, match="observation 0: the log has colour 7, the policy 1"):
        replay_follower(dataclasses.replace(run, events=changed), PolicyFollower(found.policy))


def test_a_task_has_the_angles_of_its_policy(found, tmp_path):
    path = tmp_path / "policy.jxf"
    about = {"cell_m": 1.0, "directions": 8, "step_m": 1.0, "robot_radius_m": 0.0}
    angles = {"bounces_deg": [45.0, 135.0]}
    dataclasses.replace(found.policy, metadata=about | angles).save(path)
    task = load_task(path)
    np.testing.assert_allclose(task.bounces, BOUNCES)
    assert task.header["kind"] == "policy"
    assert json.loads(json.dumps(task.header))["bounces_deg"] == pytest.approx([45.0, 135.0])
    for angles in ({}, {"bounces_deg": [45.0]}, {"bounces_deg": 45.0}):
        dataclasses.replace(found.policy, metadata=about | angles).save(path)
        with pytest.raises(ValueError, match="bounces_deg: expected a list of at least 2 angles"):
            load_task(path)
    angles = {"bounces_deg": [45.0, 135.0]}
    dataclasses.replace(found.policy, metadata=angles).save(path)
    with pytest.raises(ValueError, match=r"policy\.jxf: cell_m"):
        load_task(path)
