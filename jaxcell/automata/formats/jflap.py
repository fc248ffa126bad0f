import xml.etree.ElementTree as ElementTree
from collections import Counter

from ..filter import Filter


_SPACING = 90


def to_jflap(filter: Filter) -> str:
    """Write a filter as a `.jff` file of JFLAP 7: a Moore machine whose output is the colour.

    **Arguments:** a filter. **Returns:** the text, with states in columns, one column per distance
    from the start.

    The filter of a ring of three cells:

        >>> from jaxcell import automata, examples
        >>> automata.to_jflap(examples.ring()).count("<transition>")
        7
    """
    colors = filter.color.tolist()
    root = ElementTree.Element("structure")
    _add_children(root, type="moore")
    automaton = ElementTree.SubElement(root, "automaton")
    note = ElementTree.SubElement(automaton, "note")
    _add_children(note, text="filter", **_place(0, -1))
    for state, (x, y) in enumerate(_columns(filter)):
        node = ElementTree.SubElement(automaton, "state", id=str(state), name=f"q{state}")
        _add_children(node, **_place(x, y))
        if state == 0:
            ElementTree.SubElement(node, "initial")
        _add_children(node, output=colors[state])
    for source, row in enumerate(filter.transition.tolist()):
        for observation, target in enumerate(row):
            if target < 0:
                continue
            edge = ElementTree.SubElement(automaton, "transition")
            _add_children(edge, **{"from": source, "to": target, "read": observation})
            _add_children(edge, transout=colors[target])
    ElementTree.indent(root)
    declaration = '<?xml version="1.0" encoding="UTF-8" standalone="no"?>\n'
    return declaration + ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_children(node: ElementTree.Element, **texts: object) -> None:
    for tag, text in texts.items():
        ElementTree.SubElement(node, tag).text = str(text)


def _place(x: int, y: int) -> dict[str, float]:
    return {"x": float(_SPACING * (x + 1)), "y": float(_SPACING * (y + 2))}


def _columns(filter: Filter) -> list[tuple[int, int]]:
    """Compute the column and the row of each state; the column is its distance from the start."""
    places, height = {0: (0, 0)}, Counter([0])
    for source, targets in enumerate(filter.transition.tolist()):
        for target in targets:
            if target >= 0 and target not in places:
                column = places[source][0] + 1
                places[target] = column, height[column]
                height[column] += 1
    return [places[state] for state in range(len(places))]
