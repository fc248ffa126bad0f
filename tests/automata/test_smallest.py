import functools
import math
import sys

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from jaxcell.automata import (
    Filter,
    MooreMachine,
    Policy,
    minimize,
    smallest as smallest_within,
    subset_construction,
)


pytest.importorskip("pysat.solvers")
# A search that ends on any machine, however slow.
smallest = functools.partial(smallest_within, seconds=math.inf)


@st.composite
def machines(draw, states=8):
    """Draw a machine of up to eight states, with two symbols and up to three outputs."""
    count = draw(st.integers(1, states))
    edges = st.lists(st.integers(-1, count - 1), min_size=2, max_size=2)
    rows = np.array(draw(st.lists(edges, min_size=count, max_size=count)), np.int32)
    colors = draw(st.lists(st.integers(1, 3), min_size=count, max_size=count))
    order = [0]
    for state in order:
        order += [s for s in dict.fromkeys(rows[state].tolist()) if s >= 0 and s not in order]
    number = np.full(count + 1, -1, np.int32)
    number[order] = np.arange(len(order))
    return MooreMachine(number[rows[order]], np.int32(colors)[order])


def exists(machine, count, after=None, classes=None, queue=((0, 0),)):
    """Try all transitions of a machine of `count` states with the same outputs."""
    after, classes, queue = dict(after or {}), [set(c) for c in classes or [{0}]], list(queue)
    while queue:
        state, here = queue[0]
        for symbol in range(machine.transition.shape[1]):
            target = machine.transition.item(state, symbol)
            if target < 0:
                continue
            if (here, symbol) not in after:
                return any(
                    exists(
                        machine,
                        count,
                        {**after, (here, symbol): choice},
                        classes if choice < len(classes) else [*classes, set()],
                        queue,
                    )
                    for choice in range(min(count, len(classes) + 1))
                )
            there = after[here, symbol]
            if target not in classes[there]:
                if any(machine.color[s] != machine.color[target] for s in classes[there]):
                    return False
                classes[there].add(target)
                queue.append((target, there))
        queue.pop(0)
    return True


def assert_same_outputs(machine, small):
    """Check that every string of a machine gives the same outputs in a smaller machine."""
    met, queue = {(0, 0)}, [(0, 0)]
    for state, other in queue:
        assert machine.color[state] == small.color[other]
        for after, then in zip(
            machine.transition[state].tolist(), small.transition[other].tolist(), strict=True
        ):
            if after >= 0:
                assert then >= 0
                if (after, then) not in met:
                    met.add((after, then))
                    queue.append((after, then))


@given(machine=machines())
def test_no_machine_is_smaller_than_the_least_cover(machine):
    result = smallest(machine)
    assert result.proved
    assert exists(machine, result.states)
    assert result.states == 1 or not exists(machine, result.states - 1)
    assert_same_outputs(machine, result.machine)


@pytest.mark.parametrize("output", ["color", "count", "cells", "localized"])
@pytest.mark.parametrize("runs", [False, True])
@pytest.mark.parametrize("lab", [("a", 45), ("a", 135), ("b", 45), ("b", 135)])
def test_smallest_filters_of_labs_have_the_outputs_of_the_filters(labs, lab, output, runs):
    filter = Filter.of(subset_construction(*labs[lab]))
    machine = MooreMachine.of(filter, output, runs=runs)
    result = smallest(machine)
    assert result.proved
    assert result.states < result.moore <= len(machine.transition)
    assert_same_outputs(machine, result.machine)
    if output == "color" and not runs:
        assert result.moore == len(minimize(filter).transition)


def test_outputs_of_machines_along_strings_are_those_of_the_filter(labs):
    filter = Filter.of(subset_construction(*labs["a", 45]))
    image, observation = labs["a", 45]
    machine = {
        output: MooreMachine.of(filter, output)
        for output in ("color", "count", "cells", "localized")
    }
    in_runs = MooreMachine.of(filter, runs=True)
    sets = {}
    for cell in range(image.size):
        string, here = [], cell
        for _ in range(40):
            string.append(int(observation[here]))
            here = image[here]
        run = filter.run(string)
        np.testing.assert_array_equal(machine["color"].run(string), run.colors)
        np.testing.assert_array_equal(machine["count"].run(string), filter.uncertainty[run.states])
        np.testing.assert_array_equal(machine["localized"].run(string), 1 + (run.colors > 1))
        for state, output in zip(run.states.tolist(), machine["cells"].run(string), strict=True):
            cells = tuple(filter.cells(state)) if filter.color[state] > 1 else None
            assert sets.setdefault(int(output), cells) == cells
        bumps = np.flatnonzero(string)
        steps = np.diff(bumps, prepend=-1) - 1
        np.testing.assert_array_equal(in_runs.run(steps.tolist())[1:], run.colors[bumps + 1])


def test_open_world_filter_is_least_when_equivalent_states_are_merged(labs):
    filter = Filter.of(subset_construction(*labs["a", 135]), open_world=True)
    result = smallest(filter)
    assert result.states == result.bound == result.moore == len(minimize(filter).transition)


# Up to three bumps, with turns by angles 0 and 1; the last two states are ends.
POLICY = Policy(
    turn=np.int32([-1, 0, 1, 0, -1, -1]),
    first=np.int32([0, 2, 3, 5, 6, 6, 6]),
    steps=np.int32([0, 1, 1, 0, 2, 3]),
    target=np.int32([1, 2, 3, 4, 5, 4]),
    offsets=np.int32([0, 2, 3, 4, 5, 6, 7]),
    members=np.int32([0, 1, 0, 1, 2, 3, 4]),
)


def test_smallest_machine_of_a_policy_keeps_its_actions_and_cells():
    machine = MooreMachine.of(POLICY)
    assert machine.color.tolist() == [2, 0, 1, 0, 3, 4]
    assert MooreMachine.of(POLICY, "action").color.tolist() == [2, 0, 1, 0, 3, 3]
    assert machine.run([0, 1, 3]).tolist() == [2, 0, 0, 3]
    for output, states in (("cells", 5), ("action", 4)):
        result = smallest(MooreMachine.of(POLICY, output))
        assert result.proved
        assert result.states == states
        assert_same_outputs(MooreMachine.of(POLICY, output), result.machine)


def test_plan_is_a_machine_of_its_actions():
    machine = MooreMachine.of_plan([0.0, 0.5, 0.0, 1.5])
    assert machine.color.tolist() == [2, 2, 0, 2, 5]
    assert machine.run([0, 1, 0, 1]).tolist() == [2, 2, 0, 2, 5]
    assert MooreMachine.of_plan([]).color.tolist() == [1]
    many = MooreMachine.of_plan([0.0, 0.0, 0.0, 0.5] * 5 + [0.0])
    assert smallest(many).states < len(many.transition)


def test_limit_of_time_gives_a_bound_and_a_filter_with_the_same_outputs(labs):
    filter = Filter.of(subset_construction(*labs["b", 135]))
    result = smallest(filter, seconds=0)
    assert not result.proved
    assert result.bound <= smallest(filter).states <= result.states == result.moore
    assert_same_outputs(MooreMachine.of(filter), result.machine)


def test_error_without_the_solver_names_the_extra_to_install(labs, monkeypatch):
    monkeypatch.setitem(sys.modules, "pysat.solvers", None)
    with pytest.raises(ModuleNotFoundError, match=r"jaxcell\[smallest\]"):
        smallest(Filter.of(subset_construction(*labs["a", 135])))


@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (lambda: MooreMachine(np.int32([[1, 0]]), np.int32([0])), "states from 0 to 0"),
        (lambda: MooreMachine(np.int32([[0], [0]]), np.int32([0, 1])), "reaches state 1"),
        (lambda: MooreMachine.of(POLICY, "count"), "expected cells or action for a policy"),
        (lambda: MooreMachine(np.int32([[0]]), np.int32([0])).run([1]), "symbol 0 is 1"),
    ],
)
def test_wrong_machines_are_refused(make, cause):
    with pytest.raises(ValueError, match=cause):
        make()


def test_filter_that_may_never_bump_has_no_runs():
    filter = Filter.of(subset_construction(np.int32([0]), np.array([False])))
    with pytest.raises(ValueError, match="may never bump again"):
        MooreMachine.of(filter, runs=True)
