"""A robot is localized only when further observations have not refuted its map."""

import dataclasses
import functools

import numpy as np
import pytest
from grid_robot import GridRobot, filter_of, room

from jaxcell.automata import Belief, HiddenMap, Policy
from jaxcell.automata.filter import CONFIRM
from jaxcell.bounce import localization_policy
from jaxcell.robot.followers import BeliefFollower, FilterFollower, PolicyFollower
from jaxcell.robot.outcome import RunOutcome
from jaxcell.space import CellSpace


# The angles of the robots, in quarters of a turn.
QUARTERS = [1, 2]


def policy_of(free: np.ndarray) -> Policy:
    return localization_policy(CellSpace.of_grid(free, 4), np.radians([90.0, 180.0])).policy


def outcomes(kind, free, elsewhere) -> list[RunOutcome]:
    """Run a robot from every cell of each room, and check the place of robots in their own room."""
    found = []
    for other in elsewhere:
        for cell in range(4 * int(other.sum())):
            robot = GridRobot(other, cell)
            found.append(robot.drive(kind(), QUARTERS))
            if other is free:
                assert found[-1].result == "localized"
                assert robot.cell in found[-1].cells
    return found


ROOMS = [room(seed) for seed in range(7)]
KINDS = {
    "filter": (functools.partial(filter_of, shift=1), FilterFollower),
    "policy": (policy_of, PolicyFollower),
}


@pytest.fixture(scope="module", params=KINDS)
def kind(request):
    build, follow = KINDS[request.param]
    source = build(ROOMS[0])
    return functools.partial(follow, source)


def share(kind, confirm: int) -> float:
    """The share of the robots that are localized in another room."""
    found = outcomes(functools.partial(kind, confirm=confirm), ROOMS[0], ROOMS[1:])
    return sum(outcome.result == "localized" for outcome in found) / len(found)


def test_robots_in_other_rooms_are_localized_only_without_confirmation(kind):
    assert share(kind, 0) > 0.05
    assert share(kind, CONFIRM) < 0.001


def test_a_robot_in_its_room_is_localized_to_its_place_after_the_confirmation(kind):
    at_once = outcomes(functools.partial(kind, confirm=0), ROOMS[0], ROOMS[:1])
    later = outcomes(kind, ROOMS[0], ROOMS[:1])
    for before, after in zip(at_once, later, strict=True):
        assert after.observations.startswith(before.observations)
        more = len(after.observations) - len(before.observations)
        assert more >= CONFIRM
        assert f" {len(before.observations)} observations, and {more} more" in after.reason


def test_a_run_that_ends_during_its_confirmation_is_not_localized(kind):
    at_once = GridRobot(ROOMS[0], 0).drive(kind(confirm=0), QUARTERS)
    count = len(at_once.observations)
    outcome = GridRobot(ROOMS[0], 0).drive(kind(), QUARTERS, count + 3)
    assert outcome.result == "unfinished"
    assert outcome.reason.startswith(f"not confirmed by {CONFIRM} observations: localized to ")
    assert outcome.reason.endswith(f" after {count} observations, and 3 more agreed")


def test_a_policy_of_an_early_version_is_not_confirmed(tmp_path):
    path = tmp_path / "policy.jxf"
    policy = policy_of(ROOMS[0])
    policy.save(path)
    np.testing.assert_array_equal(Policy.load(path).onward.target, policy.onward.target)
    dataclasses.replace(policy, onward=None).save(path)
    early = Policy.load(path)
    assert early.onward is None
    follower = PolicyFollower(early)
    assert follower.confirm == 0
    assert GridRobot(ROOMS[0], 0).drive(follower, QUARTERS).result == "localized"


@pytest.mark.parametrize(
    ("field", "change", "message"),
    [
        ("at", lambda at: at[::-1], "ascending configurations"),
        ("steps", lambda steps: -1 - steps, "steps from 0"),
        ("target", lambda target: target + target.size, "expected each target below"),
    ],
)
def test_a_damaged_table_is_refused(field, change, message):
    onward = policy_of(ROOMS[0]).onward
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(onward, **{field: change(getattr(onward, field))})


@pytest.mark.parametrize(("degrees", "chosen"), [([180.0, 90.0], 1), ([90.0, 180.0], 0)])
def test_a_robot_that_would_drive_back_and_forth_turns_by_another_angle(degrees, chosen):
    cells = CellSpace.of_grid(ROOMS[0], 4)
    assert localization_policy(cells, np.radians(degrees)).policy.onward.turn == chosen


def test_a_table_without_the_end_of_its_policy_is_refused():
    policy = policy_of(ROOMS[0])
    none = dataclasses.replace(
        policy.onward, **dict.fromkeys(("at", "steps", "target"), np.int32([]))
    )
    with pytest.raises(ValueError, match="expected each configuration in which the policy ends"):
        dataclasses.replace(policy, onward=none)


# The probability that a robot stays where it is in place of a step; it observes no bump.
STAYS = 0.05


class SlippingRobot(GridRobot):
    """A robot whose steps fail sometimes."""

    def __init__(self, free: np.ndarray, cell: int, rng: np.random.Generator) -> None:
        super().__init__(free, cell)
        self.rng = rng

    def step(self) -> bool:
        slips = self.rng.random() < STAYS
        return not self.is_free(*self.ahead[self.direction]) if slips else super().step()


def belief_of(free: np.ndarray) -> Belief:
    """The belief of a slipping robot that turns left at each bump."""
    cells = 4 * int(free.sum())
    moves, bumps = np.zeros((2, cells, cells))
    for cell in range(cells):
        robot = GridRobot(free, cell)
        if robot.step():
            robot.turn(1)
            bumps[cell, robot.cell] = 1
        else:
            moves[cell, robot.cell] = 1 - STAYS
            moves[cell, cell] = STAYS
    return Belief(HiddenMap.of(moves, bumps, np.arange(cells), np.full(cells, 1 / cells)))


@pytest.fixture(scope="module")
def belief():
    return belief_of(ROOMS[0])


def believers(belief, room, robots=60, **options):
    """Yield robots from random cells of a room, their followers, and the outcomes of their runs."""
    rng = np.random.default_rng(5)
    for cell in rng.integers(4 * int(room.sum()), size=robots).tolist():
        robot, follower = SlippingRobot(room, cell, rng), BeliefFollower(belief, **options)
        yield robot, follower, robot.drive(follower, [1])


def test_a_belief_in_its_room_is_localized_by_evidence(belief):
    held = 0
    for robot, follower, outcome in believers(belief, ROOMS[0]):
        if outcome.result == "localized":
            held += robot.cell in outcome.cells
            assert follower.evidence.decibans >= 30
            assert "times better than a predictor that learns from them" in outcome.reason
    assert held >= 54


def test_beliefs_in_other_rooms_are_localized_rarely_with_evidence(belief):
    shares = {}
    for confirm in (0, 30):
        outcomes = [
            outcome.result
            for room in ROOMS[1:]
            for *_, outcome in believers(belief, room, 30, confirm=confirm)
        ]
        shares[confirm] = outcomes.count("localized") / len(outcomes)
    assert shares[0] > 0.3
    assert shares[30] < 0.01


@pytest.mark.parametrize("confirm", [0, 10, 40])
def test_a_belief_ends_where_it_is_known_with_enough_evidence(belief, confirm):
    for *_, outcome in believers(belief, ROOMS[0], 8, confirm=confirm):
        again, ends = BeliefFollower(belief, confirm=confirm), []
        for observation in outcome.observations:
            assert again.result is None
            again.observe(int(observation))
            enough = again.fields["decibans"] >= confirm or confirm == 0
            ends.append(again.fields["credible"] <= 4 and enough)
        assert again.outcome() == outcome
        assert ends == [False] * (len(ends) - 1) + [outcome.result == "localized"]


def test_a_belief_without_enough_evidence_is_not_localized(belief):
    *_, first = believers(belief, ROOMS[0], 1)
    assert first[2].result == "localized"
    follower = BeliefFollower(belief)
    for observation in first[2].observations[:-1]:
        follower.observe(int(observation))
    outcome = follower.outcome()
    assert outcome.result == "unfinished"
    assert outcome.reason.startswith("not confirmed by evidence of 30 decibans: localized to ")


def test_a_belief_is_refuted_by_evidence_unless_it_is_not_to_be_confirmed():
    # Robots that stay in one of six cells, and should bump in one of ten steps, but bump in half.
    moves, bumps = np.eye(6) * 0.9, np.eye(6) * 0.1
    source = Belief(HiddenMap.of(moves, bumps, np.arange(6), np.full(6, 1 / 6)))
    doubting, trusting = BeliefFollower(source), BeliefFollower(source, confirm=0)
    while doubting.result is None:
        for follower in (doubting, trusting):
            follower.observe(len(follower.observations) % 2)
    assert doubting.result == "refuted"
    assert doubting.fields["nowhere"] < 0.99
    assert "times worse than a predictor that learns from them" in doubting.outcome().reason
    assert trusting.result is None
