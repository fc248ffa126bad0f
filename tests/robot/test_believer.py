"""Robots that are localized by a belief, on the body of the emulator."""

import numpy as np
from wheels import place_of, walker_in

from jaxcell.automata import Belief, HiddenMap
from jaxcell.robot import RunLog, read_log
from jaxcell.robot.emulation.body import Noise
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.followers import BeliefFollower, replay_follower, run_follower
from jaxcell.space import CellSpace, Workspace


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


def test_a_robot_is_localized_and_a_replay_of_its_log_agrees(tmp_path):
    cells = corridor(7)
    belief = belief_of(cells)
    noise = Noise(distance=0.01, rotation=0.01, veer=0.01)
    rng = np.random.default_rng(1)
    walker, body = walker_in(cells, 2, robot=DirectBody, noise=noise, rng=rng)
    with RunLog(tmp_path / "run.jsonl", {"kind": "belief"}) as log:
        outcome = run_follower(walker, BeliefFollower(belief), [np.pi], log=log)
    assert outcome.result == "localized"
    assert place_of(cells, body) in outcome.cells
    assert len(outcome.cells) <= 4
    run = read_log(tmp_path / "run.jsonl")
    assert replay_follower(run, BeliefFollower(belief)) == outcome
    events = [event for event in run.events if event["event"] == "observation"]
    assert {"credible", "nowhere", "likeliest"} <= events[-1].keys()
    assert events[-1]["credible"] == len(outcome.cells)


def test_a_robot_that_is_nowhere_on_the_map_stops():
    # The robot is in a corridor, but its map is a ring of twenty free cells.
    ring = np.roll(np.eye(20), 1, axis=1)
    hidden = HiddenMap.of(ring, np.zeros((20, 20)), np.arange(20), np.full(20, 0.05))
    walker, _ = walker_in(corridor(10), 0, robot=DirectBody)
    outcome = run_follower(walker, BeliefFollower(Belief(hidden)), [np.pi])
    assert outcome.result == "refuted"
    assert "nowhere on the map" in outcome.reason
    assert outcome.cells == ()
    assert outcome.observations == "0000000001"
