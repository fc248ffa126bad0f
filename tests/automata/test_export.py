import json
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from jaxcell.automata import Filter, subset_construction, to_dot, to_jflap, to_json


@pytest.fixture(params=[False, True])
def filter(request, labs):
    automaton = subset_construction(*labs["a", 45])
    return Filter.of(automaton, open_world=request.param, metadata={"map": 'a "lab"\n'})


def test_dot_has_the_states_and_edges_of_the_filter(filter):
    text = to_dot(filter)
    edges = re.findall(r'^  (\d+) -> (\d+) \[label="([01])"\];$', text, re.MULTILINE)
    transition = [[-1, -1] for _ in filter.transition]
    for source, target, observation in edges:
        transition[int(source)][int(observation)] = int(target)
    assert transition == filter.transition.tolist()
    nodes = re.findall(r'^  (\d+) \[label="(\d+)\\n(\d+)"(.*)\];$', text, re.MULTILINE)
    assert [(int(a), int(b), int(c)) for a, b, c, _ in nodes] == [
        (state, state, uncertainty) for state, uncertainty in enumerate(filter.uncertainty.tolist())
    ]
    fills = [re.search(r'fillcolor=("[^"]*"|\w+)', marks) for *_, marks in nodes]
    by_color = {}
    for color, fill in zip(filter.color.tolist(), fills, strict=True):
        by_color.setdefault(color, set()).add(fill and fill[1])
    assert by_color.pop(1) == {None}
    assert all(len(fill) == 1 for fill in by_color.values())
    assert len(set.union(*by_color.values())) == len(by_color)


def test_json_has_all_of_the_filter(filter):
    loaded = json.loads(to_json(filter))
    assert loaded["transition"] == filter.transition.tolist()
    assert loaded["color"] == filter.color.tolist()
    assert loaded["uncertainty"] == filter.uncertainty.tolist()
    assert loaded["trap"] == filter.trap
    assert loaded["open_world"] == filter.open_world
    assert loaded["metadata"] == {"map": 'a "lab"\n'}
    for ours, theirs in zip(loaded["cycles"], filter.cycles, strict=True):
        assert ours["states"] == theirs.states.tolist()
        assert (ours["color"], ours["uncertainty"]) == (theirs.color, theirs.uncertainty)
        assert ours["word"] == theirs.word
        assert ours["cells"] == [filter.cells(state).tolist() for state in ours["states"]]


def test_jflap_file_has_the_automaton_of_the_filter(filter):
    root = ElementTree.fromstring(to_jflap(filter).encode())
    assert (root.tag, root.findtext("type")) == ("structure", "moore")
    states = root.findall("automaton/state")
    assert [int(state.get("id")) for state in states] == list(range(len(filter.transition)))
    assert len({state.get("name") for state in states}) == len(states)
    assert len({(state.findtext("x"), state.findtext("y")) for state in states}) == len(states)
    assert [int(state.findtext("output")) for state in states] == filter.color.tolist()
    assert [state.get("id") for state in states if state.find("initial") is not None] == ["0"]
    transition = np.full_like(filter.transition, -1)
    for edge in root.findall("automaton/transition"):
        source, read, target = (int(edge.findtext(tag)) for tag in ("from", "read", "to"))
        assert transition[source, read] == -1
        assert int(edge.findtext("transout")) == filter.color[target]
        transition[source, read] = target
    np.testing.assert_array_equal(transition, filter.transition)
