import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from jaxcell.automata import Filter, subset_construction, to_jflap


@pytest.mark.parametrize("open_world", [False, True])
def test_automaton_in_the_file_equals_the_filter(labs, open_world):
    for graph in labs.values():
        filter = Filter.of(subset_construction(*graph), open_world=open_world)
        root = ElementTree.fromstring(to_jflap(filter).encode())
        assert (root.tag, root.findtext("type")) == ("structure", "moore")
        automaton = root.find("automaton")
        states = automaton.findall("state")
        assert [int(state.get("id")) for state in states] == list(range(len(filter.transition)))
        assert len({state.get("name") for state in states}) == len(states)
        assert len({(state.findtext("x"), state.findtext("y")) for state in states}) == len(states)
        assert [int(state.findtext("output")) for state in states] == filter.color.tolist()
        assert [state.get("id") for state in states if state.find("initial") is not None] == ["0"]
        transition = np.full_like(filter.transition, -1)
        for edge in automaton.findall("transition"):
            source, read, target = (int(edge.findtext(tag)) for tag in ("from", "read", "to"))
            assert transition[source, read] == -1
            assert int(edge.findtext("transout")) == filter.color[target]
            transition[source, read] = target
        np.testing.assert_array_equal(transition, filter.transition)
