import dataclasses
import json

import numpy as np
import pytest
from wheels import map_cells, walker_in

from jaxcell.bounce import localization_policy
from jaxcell.robot import PolicyFollower, RunLog, load_task, read_log, replay_follower, run_follower
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.emulation.simulated import SimulatedCreate


LAB_A, LAB_B = map_cells("lab_a.json"), map_cells("lab_b.json")
BOUNCES = np.radians([45.0, 135.0]).tolist()


@pytest.fixture(scope="module")
def found():
    return localization_policy(LAB_A, BOUNCES)


@pytest.mark.parametrize(
    ("cell", "driver"),
    [(3, DirectBody), (70, SimulatedCreate), (77, DirectBody), (151, DirectBody)],
)
def test_the_robot_is_localized_to_its_true_configuration(cell, driver, found, tmp_path):
    walker, body = walker_in(LAB_A, cell, robot=driver)
    with RunLog(tmp_path / "run.jsonl", {"kind": "policy"}) as log:
        outcome = run_follower(walker, PolicyFollower(found.policy), BOUNCES, log=log)
    assert outcome.result == "localized"
    run = found.drive(cell)
    assert outcome.observations == run.word
    assert outcome.cells == (run.end,) == (int(LAB_A.index(*body.pose)),)
    assert set(outcome.colors[:-1]) == {1}
    assert outcome.colors[-1] > 1
    kept = read_log(tmp_path / "run.jsonl")
    assert replay_follower(kept, PolicyFollower(found.policy)) == outcome
    # The log has the states at bumps.
    states = [event["state"] for event in kept.events if event["event"] == "observation"]
    bumps = run.observations == 1
    assert [state for state in states if state is not None] == run.states[1:][bumps].tolist()


def test_a_policy_of_another_map_is_refuted(found, tmp_path):
    # In Lab B the robot bumps where Lab A is free.
    walker, _ = walker_in(LAB_B, 77, robot=DirectBody)
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
