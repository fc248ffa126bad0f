import re
import shutil
import subprocess

import numpy as np
import pytest

from jaxcell.automata import Policy, policy_to_c_header
from jaxcell.automata.formats.c_policy import policy_bits


MAIN = """
#include <stdio.h>
#include "room.h"
int main(void) {
    room_state state = ROOM_START;
    int c;
    while ((c = getchar()) != EOF) {
        state = room_next(state, (uint8_t)(c - '0'));
        printf("%lu %d %d %d\\n", (unsigned long)room_color(state), (int)room_turn(state),
               room_localized(state), room_refuted(state));
    }
    return (int)(room_uncertainty(state) & 127);
}
"""


def random_policy(rng, states, longest):
    """A tree of bumps, some branches of which meet again."""
    after = [{} for _ in range(states)]
    for state in range(1, states):
        # Parents in ascending order, so that states are met in theirs.
        parent = (state - 1) // 3
        free = [s for s in range(longest + 1) if s not in after[parent]]
        after[parent][int(rng.choice(free))] = state
    # The lower number of steps comes first.
    after = [dict(zip(sorted(one), sorted(one.values()), strict=True)) for one in after]
    sizes = rng.integers(1, 4, states)
    members = np.concatenate([np.sort(rng.choice(9, n, replace=False)) for n in sizes])
    turn = [int(rng.integers(3)) if state and after[state] else -1 for state in range(states)]
    return Policy(
        turn=np.int32(turn),
        first=np.cumsum([0, *map(len, after)], dtype=np.int32),
        steps=np.int32([steps for one in after for steps in one]),
        target=np.int32([target for one in after for target in one.values()]),
        offsets=np.cumsum([0, *sizes], dtype=np.int32),
        members=members.astype(np.int32),
    )


def some_run(policy, rng):
    """Observations of a run to an end, or that go wrong on the way."""
    state, word = 0, ""
    while after := policy.after(state):
        steps = int(rng.choice(list(after)))
        word += "0" * steps + "1"
        state = after[steps]
        if rng.random() < 0.2:
            return word + "".join(map(str, rng.integers(0, 2, 6)))
    return word


@pytest.mark.parametrize(
    ("compiler", "standard", "states", "longest"),
    [("cc", "c99", 40, 5), ("cc", "c99", 300, 270), ("c++", "c++11", 40, 5)],
)
def test_compiled_header_follows_the_policy(tmp_path, compiler, standard, states, longest):
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler} to compile with")
    rng = np.random.default_rng(0)
    policy = random_policy(rng, states, longest)
    (tmp_path / "room.h").write_text(policy_to_c_header(policy, name="room"))
    source = tmp_path / ("main.c" if compiler == "cc" else "main.cpp")
    source.write_text(MAIN)
    program = tmp_path / "main"
    strict = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    subprocess.run(
        [compiler, f"-std={standard}", *strict, str(source), "-o", str(program)], check=True
    )
    ends = set()
    for _ in range(25):
        word, state, expected = some_run(policy, rng), policy.start(), []
        for observation in word:
            if state.localized:
                break
            state = state.observe(int(observation))
            turn = 255 if state.turn is None else state.turn
            expected.append([state.color, turn, int(state.localized), int(state.refuted)])
        run = subprocess.run(
            [program], input=word[: len(expected)], capture_output=True, text=True, check=False
        )
        assert [list(map(int, line.split())) for line in run.stdout.splitlines()] == expected
        if not state.refuted:
            assert run.returncode == policy.uncertainty[state.index]
        ends.add((state.localized, state.refuted))
    assert ends >= {(True, False), (False, True)}


def test_tables_have_the_reported_widths():
    policy = random_policy(np.random.default_rng(1), 300, 400)
    text = policy_to_c_header(policy)
    found = re.findall(r"static const uint(\d+)_t \w+\[", text)
    assert list(map(int, found)) == list(policy_bits(policy).values())
