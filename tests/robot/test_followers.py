"""Robots that are localized by filters, policies and beliefs."""

import dataclasses
import functools
import json
import math

import numpy as np
import pytest
from robot_files import SPEC
from wheels import bounce_filter, map_cells, orbit, place_of, walker_in as walker_with

from jaxcell.automata import Belief, HiddenMap
from jaxcell.bounce import localization_policy
from jaxcell.robot.emulation.body import Noise
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.followers import (
    BeliefFollower,
    FilterFollower,
    PolicyFollower,
    replay_follower,
    run_follower,
)
from jaxcell.robot.run_log import RunLog, read_log
from jaxcell.robot.tasks.files import load_task
from jaxcell.space import CellSpace, Workspace


LAB_A, LAB_B = map_cells("lab_a.json"), map_cells("lab_b.json")
BOUNCES = np.radians([45.0, 135.0]).tolist()
# Most of these tests do not depend on the driver.
walker_in = functools.partial(walker_with, robot=DirectBody)


@pytest.fixture
def logged(tmp_path):
    """Run a follower with a log, and check that a replay has the same outcome."""

    def run(walker, make_follower, bounces, **header):
        path = tmp_path / "run.jsonl"
        path.unlink(missing_ok=True)
        with RunLog(path, header) as log:
            outcome = run_follower(walker, make_follower(), bounces, log=log)
        kept = read_log(path)
        assert replay_follower(kept, make_follower()) == outcome
        return outcome, kept

    return run


@pytest.mark.parametrize("open_world", [False, True])
def test_a_filter_of_another_map_is_refuted_with_its_observations(open_world):
    """From some cells of Lab A, a robot has observations that are impossible in Lab B."""
    filter = bounce_filter(LAB_B, 45, open_world=open_world)
    refuted = 0
    for cell in range(0, LAB_A.size, 19):
        walker, _ = walker_in(LAB_A, cell)
        outcome = run_follower(walker, FilterFollower(filter, "cycle"), [math.radians(45)])
        observed, _ = orbit(LAB_A, 45, cell, len(outcome.observations))
        assert outcome.observations == observed
        if outcome.result == "refuted":
            refuted += 1
            with pytest.raises(ValueError, match=f"observation {len(observed) - 1} is"):
                bounce_filter(LAB_B, 45).run(observed)
            bounce_filter(LAB_B, 45).run(observed[:-1])
            assert outcome.cells == ()
            assert outcome.reason.endswith(f"the robot observed {observed}")
            assert outcome.colors[-1] == (filter.color[-1] if open_world else 0)
    assert refuted >= 2


@pytest.mark.parametrize("confirm", [0, 9])
def test_a_run_ends_where_one_configuration_is_left_or_in_the_cycle(confirm, logged):
    filter, start = bounce_filter(LAB_A, 135), 148
    word, cells = orbit(LAB_A, 135, start, 200)
    run = filter.run(word)
    known = int(np.flatnonzero(filter.uncertainty[run.states] == 1)[0])
    # One configuration is left long before the knowledge cycle.
    assert known < run.localized_at - 5
    for until, end in (("known", known), ("cycle", run.localized_at)):
        walker, _ = walker_in(LAB_A, start)
        follower = functools.partial(FilterFollower, filter, until, confirm=confirm)
        outcome, kept = logged(walker, follower, [math.radians(135)])
        assert outcome.result == "localized"
        assert outcome.observations == word[: end + confirm]
        assert outcome.cells == (cells[end + confirm - 1],)
        agreed = [event["agreed"] for event in kept.events if "agreed" in event]
        assert agreed == [*range(confirm + 1)]
        if confirm:
            assert outcome.reason.endswith(f" after {end} observations, and {confirm} more agreed")
        else:
            # A replay does not need to know the end of the run, which old logs do not contain.
            assert replay_follower(kept, FilterFollower(filter, confirm=0)) == outcome


def test_the_limit_ends_a_run():
    walker, _ = walker_in(LAB_A, 70)
    follower = FilterFollower(bounce_filter(LAB_A, 45))
    outcome = run_follower(walker, follower, [math.radians(45)], limit=3)
    assert outcome.result == "unfinished"
    assert len(outcome.observations) == len(outcome.colors) == 3
    assert outcome.reason.startswith("not localized after 3 observations; ")


def test_a_log_is_written_as_it_goes_and_replays_to_the_same_colours(tmp_path):
    path = tmp_path / "run.jsonl"
    filter = bounce_filter(LAB_A, 45)
    walker, _ = walker_in(LAB_A, 70)
    heard = []
    with RunLog(path, {"kind": "filter", "bounce_deg": 45}) as log:
        log.on_event = lambda name, fields: heard.append(
            ({"event": name, **fields}, json.loads(path.read_text().splitlines()[-1]))
        )
        outcome = run_follower(walker, FilterFollower(filter), [math.radians(45)], log=log)
    # Each event is in the file before the robot continues.
    assert all(event == written for event, written in heard)
    run = read_log(path)
    assert run.whole
    assert [event for event, _ in heard] == list(run.events)
    assert run.header["bounce_deg"] == 45
    assert run.observations == outcome.observations
    assert run.colors == list(outcome.colors) == filter.run(run.observations).colors[1:].tolist()
    assert run.events[-1] == {
        "event": "end",
        "seconds": run.events[-1]["seconds"],
        "result": "localized",
        "reason": outcome.reason,
    }
    assert replay_follower(run, FilterFollower(filter)) == outcome
    with pytest.raises(ValueError, match=r"observation \d+: the log has colour"):
        replay_follower(run, FilterFollower(bounce_filter(LAB_A, 135)))
    with pytest.raises(FileExistsError):
        RunLog(path, {})


@pytest.fixture(scope="module")
def localizing():
    return localization_policy(LAB_A, BOUNCES)


@pytest.mark.parametrize(
    ("cell", "driver"),
    [(3, DirectBody), (70, SimulatedCreate), (77, DirectBody), (151, DirectBody)],
)
def test_a_policy_localizes_a_robot_to_its_true_configuration(cell, driver, localizing, logged):
    walker, body = walker_in(LAB_A, cell, robot=driver)
    follower = functools.partial(PolicyFollower, localizing.policy, confirm=0)
    outcome, kept = logged(walker, follower, BOUNCES)
    assert outcome.result == "localized"
    run = localizing.drive(cell)
    assert outcome.observations == run.word
    assert outcome.cells == (run.end,) == (place_of(LAB_A, body),)
    assert set(outcome.colors[:-1]) == {1}
    assert outcome.colors[-1] > 1
    # The log has the states at bumps.
    states = [event["state"] for event in kept.events if event["event"] == "observation"]
    bumps = run.observations == 1
    assert [state for state in states if state is not None] == run.states[1:][bumps].tolist()


def test_a_policy_of_another_map_is_refuted(localizing, logged):
    # In Lab B the robot bumps where Lab A is free.
    walker, _ = walker_in(LAB_B, 77)
    outcome, run = logged(walker, lambda: PolicyFollower(localizing.policy), BOUNCES)
    assert outcome.result == "refuted"
    assert outcome.cells == ()
    assert outcome.colors[-1] == len(localizing.policy.ends) + 2
    assert f"the robot observed {outcome.observations}" in outcome.reason
    changed = tuple(dict(event, color=7) if "color" in event else event for event in run.events)
    with pytest.raises(ValueError, match="observation 0: the log has colour 7, the policy 1"):
        replay_follower(dataclasses.replace(run, events=changed), PolicyFollower(localizing.policy))


def test_a_task_has_the_angles_of_its_policy(localizing, tmp_path):
    def loaded(**about):
        dataclasses.replace(localizing.policy, metadata=about).save(tmp_path / "policy.jxf")
        return load_task(tmp_path / "policy.jxf")

    task = loaded(**SPEC, bounce_deg=[45.0, 135.0])
    np.testing.assert_allclose(task.bounces, BOUNCES)
    assert task.header["kind"] == "policy"
    assert json.loads(json.dumps(task.header))["bounce_deg"] == pytest.approx([45.0, 135.0])
    for angles in ({}, {"bounce_deg": [45.0]}, {"bounce_deg": 45.0}):
        with pytest.raises(ValueError, match="bounce_deg: expected a list of at least 2 angles"):
            loaded(**SPEC, **angles)
    with pytest.raises(ValueError, match=r"policy\.jxf: cell_m"):
        loaded(bounce_deg=[45.0, 135.0])


def corridor(length):
    return CellSpace.of(Workspace([(0, 0), (length, 0), (length, 1), (0, 1)]), 1.0, 2)


def belief_of(cells, slack=0.05):
    """The belief of a robot in a corridor, which turns around at a bump, and sometimes stays."""
    n = cells.positions
    moves, bumps = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    for direction, ahead in ((0, 1), (1, -1)):
        for place in range(n):
            here, to = direction * n + place, place + ahead
            if 0 <= to < n:
                moves[here, direction * n + to] = 1 - slack
                moves[here, here] = slack
            else:
                bumps[here, (1 - direction) * n + place] = 1
    return Belief(HiddenMap.of(moves, bumps, np.arange(2 * n), np.full(2 * n, 1 / (2 * n))))


def test_a_belief_localizes_a_robot(logged):
    cells = corridor(7)
    belief = belief_of(cells)
    noise = Noise(distance=0.005, rotation=0.005, veer=0.005)
    walker, body = walker_in(cells, 2, noise=noise, rng=np.random.default_rng(1))
    outcome, run = logged(walker, lambda: BeliefFollower(belief), [math.pi])
    assert outcome.result == "localized"
    assert place_of(cells, body) in outcome.cells
    assert len(outcome.cells) <= 4
    events = [event for event in run.events if event["event"] == "observation"]
    assert {"credible", "nowhere", "likeliest", "decibans"} <= events[-1].keys()
    assert events[-1]["credible"] == len(outcome.cells)


def test_a_robot_that_is_nowhere_on_the_map_stops():
    # The robot is in a corridor, but its map is a ring of twenty free cells.
    ring = np.roll(np.eye(20), 1, axis=1)
    hidden = HiddenMap.of(ring, np.zeros((20, 20)), np.arange(20), np.full(20, 0.05))
    walker, _ = walker_in(corridor(10), 0)
    outcome = run_follower(walker, BeliefFollower(Belief(hidden)), [math.pi])
    assert outcome.result == "refuted"
    assert "nowhere on the map" in outcome.reason
    assert outcome.cells == ()
    assert outcome.observations == "0000000001"
