import re

import numpy as np
import pytest

from jaxcell.automata import Policy, policy_to_c_header
from jaxcell.automata.formats.c_policy import policy_bits


def random_policy(rng, states, longest):
    """Draw a tree of bumps."""
    after = [{} for _ in range(states)]
    for state in range(1, states):
        # Parents are in ascending order, and so are the states in the order in which they are met.
        parent = (state - 1) // 3
        free = [s for s in range(longest + 1) if s not in after[parent]]
        after[parent][int(rng.choice(free))] = state
    # The lower number of steps comes first.
    after = [dict(zip(sorted(next_), sorted(next_.values()), strict=True)) for next_ in after]
    sizes = rng.integers(1, 4, states)
    members = np.concatenate([np.sort(rng.choice(9, n, replace=False)) for n in sizes])
    turn = [int(rng.integers(3)) if state and after[state] else -1 for state in range(states)]
    return Policy(
        turn=np.int32(turn),
        first=np.cumsum([0, *map(len, after)], dtype=np.int32),
        steps=np.int32([steps for next_ in after for steps in next_]),
        target=np.int32([target for next_ in after for target in next_.values()]),
        offsets=np.cumsum([0, *sizes], dtype=np.int32),
        members=members.astype(np.int32),
    )


def random_run(policy, rng):
    """Draw the observations of a run to an end, or with random observations from some bump on."""
    state, word = 0, ""
    while after := policy.after(state):
        steps = int(rng.choice(list(after)))
        word += "0" * steps + "1"
        state = after[steps]
        if rng.random() < 0.2:
            return word + "".join(map(str, rng.integers(0, 2, 6)))
    return word


@pytest.mark.parametrize(
    ("compiler", "states", "longest"), [("cc", 40, 5), ("cc", 300, 270), ("c++", 40, 5)]
)
def test_compiled_header_follows_the_policy(outputs, compiler, states, longest):
    rng = np.random.default_rng(0)
    policy = random_policy(rng, states, longest)
    run = outputs(policy_to_c_header(policy, name="lab"), compiler)
    ends = set()
    for _ in range(25):
        word, state, expected = random_run(policy, rng), policy.start(), []
        for observation in word:
            if state.localized:
                break
            state = state.observe(int(observation))
            turn = 255 if state.turn is None else state.turn
            expected.append((state.color, state.localized, state.refuted, turn))
        printed = run(word[: len(expected)])
        assert [line[:-1] for line in printed] == expected
        if not state.refuted:
            assert printed[-1][-1] == policy.uncertainty[state.index]
        ends.add((state.localized, state.refuted))
    assert ends >= {(True, False), (False, True)}


def test_tables_have_the_reported_widths():
    policy = random_policy(np.random.default_rng(1), 300, 400)
    text = policy_to_c_header(policy)
    widths = re.findall(r"static const uint(\d+)_t \w+\[", text)
    assert list(map(int, widths)) == list(policy_bits(policy).values())
