import json
import re

import pytest

from jaxcell.automata import Filter, subset_construction, to_dot, to_json


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
