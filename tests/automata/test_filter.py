import inspect
import math

import hypothesis.strategies as st
import networkx as nx
import numpy as np
import pytest
from hypothesis import given

from jaxcell.automata import Filter, minimize, subset_construction


strings = st.text("01", max_size=12)


def filter_of(graph, **kwargs):
    return Filter.of(subset_construction(*graph), **kwargs)


def possible_cells(graph, string):
    """Find the possible cells after a string by trying every start."""
    image, observation = (array.tolist() for array in graph)
    ends = set()
    for cell in range(len(image)):
        for bit in string:
            if observation[cell] != int(bit):
                break
            cell = image[cell]
        else:
            ends.add(cell)
    return sorted(ends)


def closed_simple_cycles(transition):
    """Find the strong components in which each state has one edge, to a state of the component."""
    edges = [(s, t) for s, row in enumerate(transition.tolist()) for t in row if t >= 0]
    graph = nx.MultiDiGraph(edges)
    return {
        frozenset(component)
        for component in nx.strongly_connected_components(graph)
        if all(graph.out_degree(s) == 1 and set(graph[s]) <= component for s in component)
    }


@pytest.mark.parametrize(
    ("room", "angle", "uncertainties"),
    [("a", 45, [1, 3, 4]), ("a", 135, [1, 2]), ("b", 45, [1, 2]), ("b", 135, [1, 1])],
)
def test_uncertainties_of_table_2_2(labs, room, angle, uncertainties):
    filter = filter_of(labs[room, angle])
    assert sorted(cycle.uncertainty for cycle in filter.cycles) == uncertainties


@given(data=st.data(), open_world=st.booleans())
def test_knowledge_cycles_are_the_closed_simple_cycles(graphs, data, open_world):
    graph = data.draw(graphs)
    filter = filter_of(graph, open_world=open_world)
    closed = filter_of(graph)
    assert {frozenset(c.states.tolist()) for c in filter.cycles} == closed_simple_cycles(
        closed.transition
    )
    smallest = [cycle.states[0] for cycle in filter.cycles]
    assert smallest == sorted(smallest)
    assert [cycle.color for cycle in filter.cycles] == list(range(2, 2 + len(filter.cycles)))
    expected = np.ones(len(filter.transition))
    for cycle in filter.cycles:
        states = cycle.states.tolist()
        assert states[0] == min(states)
        assert len(cycle.word) == len(states)
        for state, bit, after in zip(states, cycle.word, states[1:] + states[:1], strict=True):
            assert closed.transition[state, int(bit)] == after
            assert closed.transition[state, 1 - int(bit)] == -1
            assert filter.uncertainty[state] == cycle.uncertainty == filter.cells(state).size
        expected[states] = cycle.color
    if open_world:
        expected[-1] = 2 + len(filter.cycles)
    np.testing.assert_array_equal(filter.color, expected)


@given(data=st.data(), string=strings)
def test_states_along_a_string_have_all_possible_cells(graphs, data, string):
    graph = data.draw(graphs)
    filter = filter_of(graph, open_world=True)
    run, state = filter.run(string), filter.start()
    refuted_at = localized_at = None
    for time in range(len(string) + 1):
        cells = possible_cells(graph, string[:time])
        if not cells and refuted_at is None:
            refuted_at = time - 1
        localized = any(state.index in cycle.states for cycle in filter.cycles)
        if localized and localized_at is None:
            localized_at = time
        assert (state.index, state.time) == (run.states[time], time)
        assert state.color == run.colors[time] == filter.color[state.index]
        assert state.cells.tolist() == filter.cells(state.index).tolist() == cells
        assert state.uncertainty == filter.uncertainty[state.index] == len(cells)
        assert state.localized == localized
        assert state.refuted == (state.index == filter.trap) == (not cells)
        assert state.refuted_at == refuted_at
        if time < len(string):
            before, state = state, state.observe(int(string[time]))
            assert before.time == time
    assert (run.refuted_at, run.localized_at) == (refuted_at, localized_at)


@given(data=st.data(), string=strings)
def test_strings_that_lead_to_the_trap_are_impossible_in_a_closed_world(graphs, data, string):
    graph = data.draw(graphs)
    closed, opened = filter_of(graph), filter_of(graph, open_world=True)
    assert (closed.trap, opened.trap) == (None, len(closed.transition))
    run = opened.run(string)
    if run.refuted_at is None:
        np.testing.assert_array_equal(closed.run(string).states, run.states)
    else:
        with pytest.raises(ValueError, match=rf"^observation {run.refuted_at} is "):
            closed.run(string)
        assert (run.states[run.refuted_at + 1 :] == opened.trap).all()
        assert (run.states[: run.refuted_at + 1] != opened.trap).all()


@pytest.mark.parametrize("kind", [list, np.array, lambda bits: map(bool, bits)])
def test_observations_may_be_a_list_an_array_or_an_iterator(labs, kind):
    filter = filter_of(labs["a", 45])
    expected = filter.run("0100")
    np.testing.assert_array_equal(filter.run(kind([0, 1, 0, 0])).states, expected.states)


@pytest.mark.parametrize("observation", [2, -1, "1", None, math.nan, 0.5])
@pytest.mark.parametrize("open_world", [False, True])
def test_other_observations_are_refused(labs, observation, open_world):
    state = filter_of(labs["a", 45], open_world=open_world).start().observe(0)
    with pytest.raises(ValueError, match=r"^observation 1 is .*; expected 0 or 1"):
        # The type checks of these tests would refuse it first.
        inspect.unwrap(type(state).observe)(state, observation)


def test_other_digits_are_refused(labs):
    with pytest.raises(ValueError, match=r"^observation 2 is 'x'; expected 0 or 1"):
        filter_of(labs["a", 45]).run("00x")


def test_cells_of_missing_states_are_refused(labs):
    filter = filter_of(labs["a", 45])
    for state in (-1, 129):
        with pytest.raises(ValueError, match=f"state {state} does not exist; there are 129"):
            filter.cells(state)


def test_metadata_is_a_json_object(labs):
    metadata = {"map": "lab", "bounce": 0.5, "nested": [1, {"a": None}]}
    filter = filter_of(labs["a", 45], metadata=metadata)
    metadata["nested"].append(2)
    for kept in (filter, minimize(filter)):
        assert kept.metadata == {"map": "lab", "bounce": 0.5, "nested": [1, {"a": None}]}
    for bad in ({"a": math.nan}, {"a": object()}):
        with pytest.raises(ValueError, match="metadata: expected a JSON object"):
            filter_of(labs["a", 45], metadata=bad)


def parts(transition, **changes):
    states = len(transition)
    return {
        "transition": np.array(transition, np.int32).reshape(-1, 2),
        "uncertainty": np.ones(states, np.int32),
        "offsets": np.arange(states + 1, dtype=np.int64),
        "members": np.arange(states, dtype=np.int32),
        **changes,
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (parts([]), "0 states; expected a start"),
        (parts([[0, 1]]), "expected states from 0 to 0"),
        (parts([[0, 0]], open_world=True), "expected a start and a trap"),
        (parts([[1, -2], [0, -1]]), "expected states from 0 to 1, or -1"),
        (parts([[2, -1], [1, 1], [2, 1]]), "breadth-first order"),
        (parts([[0, -1], [1, -1]]), "each reached"),
        (parts([[1, -1], [1, 1]], open_world=True), "every observation and"),
        (parts([[0, 1], [0, 1]], open_world=True), "a trap in an open world"),
        (parts([[0, -1]], offsets=np.array([0, 2])), "expected to rise from 0 to the 1 members"),
        (parts([[0, 1], [1, -1]], offsets=np.array([0, 3, 2])), "expected to rise from 0 to the 2"),
    ],
)
def test_inconsistent_parts_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Filter(**arguments)


def test_cycle_with_an_exit_is_no_knowledge_cycle():
    # Subset construction never makes such an automaton, but a caller can.
    filter = Filter(**parts([[1, -1], [0, 2], [2, -1]]))
    assert [cycle.states.tolist() for cycle in filter.cycles] == [[2]]
    assert len(minimize(filter).transition) == 3
