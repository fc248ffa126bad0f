"""Damaged and forged files of filters and policies."""

import io
import json

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from mutations import cases, changed_json, damaged, place, reads_or_refuses

from jaxcell.automata import (
    Filter,
    Policy,
    minimize,
    policy_to_c_header,
    to_c_header,
    to_dot,
    to_jflap,
    to_json,
)


ARRAYS = {
    "transition": [1, 2, 1, 3, 2, 3, 3, 3],
    "uncertainty": [2, 1, 1, 0],
    "sizes": [2, 1, 1, 0],
    "members": [0, 1, 0, 1],
}
HEADER = {
    "kind": "filter",
    "open_world": True,
    "metadata": {"map": "m.json", "cell_m": 1.0, "directions": 8, "bounce_deg": 45.0},
}


def forged(header, arrays):
    """Make a file with right checksums and any content."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    stored = {
        name: np.diff(np.array(values, "<i4"), prepend=np.zeros(1, "<i4"))
        for name, values in arrays.items()
    }
    file = io.BytesIO()
    np.savez_compressed(file, header=np.frombuffer(text, np.uint8), **stored)
    return file.getvalue()


POLICY = {
    "turn": [-1, 0, -1, -1],
    "first": [0, 2, 3, 3, 3],
    "steps": [0, 2, 1],
    "target": [1, 2, 3],
    "offsets": [0, 3, 5, 6, 7],
    "members": [0, 1, 2, 1, 2, 0, 1],
}
POLICY_HEADER = {"kind": "policy", "metadata": {"bounce_deg": [45.0]}}


def use_filter(path):
    """Reads a filter, runs it, and writes it in all formats."""
    filter = Filter.load(path)
    assert len(filter.color) == len(filter.transition)
    filter.run([0])
    for write in (to_dot, to_jflap, to_json, to_c_header):
        write(minimize(filter))


def use_policy(path):
    """Reads a policy, and follows it for up to 20 steps."""
    policy = Policy.load(path)
    policy_to_c_header(policy)
    state = policy.start()
    while not (state.localized or state.refuted) and state.time < 20:
        state = state.observe(int(min(policy.after(state.index)) == state.steps))


GOOD = {
    "filter": (use_filter, forged(HEADER, ARRAYS)),
    "policy": (use_policy, forged(POLICY_HEADER, POLICY)),
}


@pytest.mark.parametrize("kind", GOOD)
def test_good_files_are_read(tmp_path, kind):
    read, content = GOOD[kind]
    assert reads_or_refuses(read, place(tmp_path, "f.jxf", content))


@pytest.mark.parametrize("kind", GOOD)
@cases()
@given(data=st.data())
def test_damaged_files_are_read_or_refused(tmp_path, kind, data):
    read, content = GOOD[kind]
    reads_or_refuses(read, place(tmp_path, *data.draw(damaged({"f.jxf": content}))))


@cases()
@given(changed_json({"f.jxf": HEADER}))
@example(("f.jxf", b'{"kind": 1e999}'))
@example(("f.jxf", b"[[0, 0]]"))
@example(
    ("f.jxf", json.dumps(HEADER).encode().replace(b'"metadata": {', b'"metadata": [], "x": {'))
)
def test_forged_headers_are_read_or_refused(tmp_path, file):
    reads_or_refuses(Filter.load, place(tmp_path, "f.jxf", forged(file[1], ARRAYS)))


numbers = st.sampled_from([-(2**31), -2, -1, 0, 0, 1, 1, 2, 2, 3, 3, 4, 5, 2**31 - 1])


@cases()
@given(
    st.fixed_dictionaries(
        {
            name: st.just(values)
            | st.lists(numbers, max_size=10)
            | st.tuples(st.integers(0, len(values) - 1), numbers).map(
                lambda at, values=values: [*values[: at[0]], at[1], *values[at[0] + 1 :]]
            )
            for name, values in ARRAYS.items()
        }
    ),
    st.booleans(),
)
def test_forged_tables_are_read_or_refused(tmp_path, arrays, open_world):
    header = {**HEADER, "open_world": open_world}
    reads_or_refuses(use_filter, place(tmp_path, "f.jxf", forged(header, arrays)))


@cases()
@given(
    st.sampled_from(sorted(POLICY)),
    st.lists(st.integers(-2, 6) | st.sampled_from([-(2**31), 2**31 - 1]), max_size=8),
)
def test_forged_policies_are_read_or_refused(tmp_path, name, values):
    path = place(tmp_path, "f.jxf", forged(POLICY_HEADER, POLICY | {name: values}))
    reads_or_refuses(use_policy, path)
