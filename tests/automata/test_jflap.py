import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from jaxcell.automata import Filter, subset_construction, to_jflap


class JflapFile:
    """A reader of the format for these tests."""

    def __init__(self, text):
        root = ElementTree.fromstring(text.encode())
        assert root.tag == "structure"
        self.kind = root.findtext("type")
        automaton = root.find("automaton")
        states = automaton.findall("state")
        self.names = {state.get("id"): state.get("name") for state in states}
        assert len(self.names) == len(states)
        self.places = {
            s.get("id"): (float(s.findtext("x")), float(s.findtext("y"))) for s in states
        }
        self.initial = [s.get("id") for s in states if s.find("initial") is not None]
        self.output = {s.get("id"): s.findtext("output") for s in states}
        self.edges = {}
        for edge in automaton.findall("transition"):
            key = edge.findtext("from"), edge.findtext("read")
            target = edge.findtext("to")
            assert target in self.names
            assert edge.findtext("transout") == self.output[target]
            self.edges.setdefault(key, set()).add(target)

    def reach(self, string):
        """Return the states after a string."""
        states = set(self.initial)
        for digit in string:
            states = {t for s in states for t in self.edges.get((s, digit), ())}
        return states


def strings(rng, graph):
    """Draw strings that robots sense, and random strings."""
    image, observation = graph
    for cell in rng.integers(0, image.size, 30):
        string = ""
        for _ in range(40):
            string += str(int(observation[cell]))
            cell = image[cell]
        yield string
    for bits in rng.integers(0, 2, (30, 12)).tolist():
        yield "".join(map(str, bits))


@pytest.mark.parametrize("open_world", [False, True])
def test_automaton_in_the_file_equals_the_filter(labs, open_world):
    for graph in labs.values():
        filter = Filter.of(subset_construction(*graph), open_world=open_world)
        file = JflapFile(to_jflap(filter))
        assert file.kind == "moore"
        assert len(file.names) == len(filter.transition)
        assert len(set(file.places.values())) == len(file.places)
        assert list(file.output.values()) == [str(color) for color in filter.color]
        for string in strings(np.random.default_rng(0), graph):
            states = file.reach(string)
            if states:
                assert states == {str(filter.run(string).states[-1])}
            else:
                with pytest.raises(ValueError, match="cannot occur"):
                    filter.run(string)
