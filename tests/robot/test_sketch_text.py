"""The tables, the comment, and the errors of sketches."""

import dataclasses
import math

import numpy as np
import pytest
from arduino import BOUNCE, ROOM_TASK, policy_task

from jaxcell.automata import Filter, MooreMachine
from jaxcell.robot.sketch import PROGRAM_BYTES, bounce_sketch, filter_sketch, policy_sketch


def sketches():
    """The task, the function of its sketch, and the bytes of its tables, for filter and policy."""
    filter, task = ROOM_TASK.filter, policy_task()
    policy = task.policy
    # All numbers are below 256.
    states, bumps = policy.turn.size, policy.steps.size
    return [
        (ROOM_TASK, filter_sketch, 4 * len(filter.transition)),
        (task, policy_sketch, 4 * states + 1 + 2 * bumps),
    ]


def test_tables_that_do_not_fit_the_flash_are_refused_with_sizes():
    for task, sketch, total in sketches():
        sketch(task, flash=PROGRAM_BYTES + total)
        message = rf"\.jxf: the tables have {total} bytes; there is room for {total - 1},"
        with pytest.raises(ValueError, match=message):
            sketch(task, flash=PROGRAM_BYTES + total - 1)
    task, _, total = sketches()[0]
    with pytest.raises(ValueError, match=f"the tables have {total + 32} bytes"):
        filter_sketch(task, direction=0, flash=PROGRAM_BYTES + total)
    states = 9000
    line = np.full((states, 2), -1, np.int32)
    line[:-1, 0] = np.arange(1, states)
    filter = Filter(
        transition=line,
        uncertainty=np.ones(states, np.int32),
        offsets=np.arange(states + 1),
        members=np.zeros(states, np.int32),
    )
    large = dataclasses.replace(task, filter=filter)
    with pytest.raises(ValueError, match=r"the table transition has 36,000 bytes; an AVR"):
        filter_sketch(large, flash=10**6)


def test_bad_directions_and_angles_of_sketches_are_refused():
    with pytest.raises(ValueError, match="direction: expected 0 to 3, got 4"):
        filter_sketch(ROOM_TASK, direction=4)
    oblique = dataclasses.replace(ROOM_TASK, bounce=1.0)
    with pytest.raises(
        ValueError, match=r"bounce_deg: 57\.2958 deg is not a whole number of the 4"
    ):
        filter_sketch(oblique, direction=0)
    filter_sketch(oblique)
    task = policy_task()
    oblique = dataclasses.replace(task, bounces=(task.bounces[0], 1.0))
    with pytest.raises(ValueError, match=r"bounce_deg: 57\.2958 deg is not a whole number of the"):
        policy_sketch(oblique, direction=0)
    for step in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="step: expected a positive number"):
            bounce_sketch(1.0, step)
    with pytest.raises(ValueError, match="bounce: expected a finite angle"):
        bounce_sketch(math.inf, 1.0)


def test_the_comment_of_a_sketch_is_complete():
    for text in (filter_sketch(ROOM_TASK, direction=1), BOUNCE):
        comment = text[: text.index("*/")]
        assert "$" not in text
        assert max(map(len, comment.splitlines())) <= 100
    assert "facing 90 degrees" in filter_sketch(ROOM_TASK, direction=1)


def test_a_sketch_says_whether_its_answer_is_confirmed():
    def comment(text):
        return " ".join(text[: text.index("*/")].replace("\n *", " ").split())

    assert "30 further observations have not refuted the map" in comment(filter_sketch(ROOM_TASK))
    machine = MooreMachine.of(ROOM_TASK.filter)
    for text in (
        filter_sketch(ROOM_TASK, confirm=0),
        filter_sketch(ROOM_TASK, machine=machine),
        policy_sketch(policy_task()),
    ):
        assert "No further observation confirms the answer" in comment(text)
        assert "const uint32_t CONFIRM = 0;" in text
    assert "localized and" not in comment(BOUNCE)
