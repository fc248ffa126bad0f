import dataclasses

import numpy as np
import pytest

from jaxcell.automata import Filter, Policy, subset_construction


# A bump without a step leaves two cells, which angle 1 distinguishes; a bump after two steps leaves
# one cell.
SMALL = Policy(
    turn=np.int32([-1, 1, -1, -1, -1]),
    first=np.int32([0, 2, 4, 4, 4, 4]),
    steps=np.int32([0, 2, 1, 3]),
    target=np.int32([1, 2, 3, 4]),
    offsets=np.int32([0, 5, 7, 8, 9, 10]),
    members=np.int32([0, 1, 2, 3, 4, 1, 3, 4, 0, 2]),
    metadata={"bounce_deg": [45.0, 135.0]},
)


def follow(word):
    state = SMALL.start()
    for observation in word:
        state = state.observe(int(observation))
    return state


@pytest.mark.parametrize(
    ("word", "color", "uncertainty", "turn", "cells"),
    [
        ("", 1, 5, None, [0, 1, 2, 3, 4]),
        ("0", 1, 1, None, []),
        ("1", 1, 2, 1, [1, 3]),
        ("001", 2, 1, None, [4]),
        ("10", 1, 2, None, []),
        ("100", 1, 1, None, []),
        ("101", 3, 1, None, [0]),
        ("10001", 4, 1, None, [2]),
        ("01", 5, 0, None, []),
        ("000", 5, 0, None, []),
        ("11", 5, 0, None, []),
        ("10000", 5, 0, None, []),
        ("01101", 5, 0, None, []),
    ],
)
def test_states_after_observations(word, color, uncertainty, turn, cells):
    state = follow(word)
    assert (state.color, state.uncertainty, state.turn) == (color, uncertainty, turn)
    assert state.cells.tolist() == cells
    assert state.localized == (1 < color < 5)
    assert state.refuted == (color == 5)


def test_index_of_an_impossible_observation_is_reported():
    assert follow("0110").refuted_at == 1
    assert follow("1").refuted_at is None
    with pytest.raises(ValueError, match="observation 3: expected none, as the policy has ended"):
        follow("1010")
    with pytest.raises(ValueError, match="observation 0 is 2; expected 0 or 1"):
        follow("2")


def test_policy_is_read_back(tmp_path):
    path = tmp_path / "policy.jxf"
    SMALL.save(path)
    again = Policy.load(path)
    for field in dataclasses.fields(Policy):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(SMALL, field.name))
    with pytest.raises(ValueError, match="it is a policy, not a filter"):
        Filter.load(path)
    ring = np.int32([1, 0]), np.array([True, False])
    Filter.of(subset_construction(*ring)).save(path)
    with pytest.raises(ValueError, match="it is a filter, not a policy"):
        Policy.load(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"turn": [-1, -1, -1, -1, -1]}, "turn: expected an angle where steps follow a bump"),
        ({"turn": [0, 1, -1, -1, -1]}, "turn: expected an angle where steps follow a bump"),
        ({"steps": [0, 0, 1, 3]}, "steps: expected numbers from 0, rising in each state"),
        ({"steps": [0, 2, -1, 3]}, "steps: expected numbers from 0, rising in each state"),
        ({"target": [1, 2, 4, 3]}, "target: expected states in the order in which they are met"),
        ({"target": [1, 2, 3, 3]}, "target: expected states in the order in which they are met"),
        ({"target": [1, 1, 2, 3]}, "target: expected states in the order in which they are met"),
        ({"first": [0, 2, 4, 4, 4, 3]}, "first: expected to rise from 0 to 4"),
        ({"offsets": [0, 5, 7, 8, 9, 9]}, "offsets: expected to rise from 0 to 10"),
        ({"metadata": {"x": float("nan")}}, "metadata: expected a JSON object"),
        (
            {"first": [0, 2, 4, 4, 5, 5], "steps": [0, 2, 1, 3, 0], "target": [1, 2, 3, 4, 1]},
            "target: expected no state to lead back to itself",
        ),
    ],
)
def test_bad_policies_are_refused(changes, message):
    changes = {k: v if k == "metadata" else np.int32(v) for k, v in changes.items()}
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(SMALL, **changes)
