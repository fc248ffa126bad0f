import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from typing import Literal

from ..filter import Filter


# Characters that XML 1.0 cannot represent.
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_SPACING = 90


def to_jflap(
    filter: Filter, kind: Literal["fa", "moore"] = "moore", *, name: str = "filter"
) -> str:
    """Write the filter as an automaton of JFLAP 7.

    **Arguments:**

    - `filter`: a localization filter.
    - `kind`: `"moore"` for a Moore machine whose output is the colour, `"fa"` for a finite
        automaton whose final states are those of the knowledge cycles.
    - `name`: a note in the drawing.

    **Returns:** the text of a `.jff` file. States are in columns by their distance from the start.

    **Raises:** `ValueError` for another `kind`.

    The filter of a ring of three cells:

        >>> from jaxcell import automata, examples
        >>> filter = examples.ring()
        >>> automata.to_jflap(filter).count("<transition>")
        7
    """
    if kind not in ("fa", "moore"):
        raise ValueError(f"kind is {kind!r}; expected 'fa' or 'moore'")
    colors = filter.color.tolist()
    root, automaton = _document(kind, name)
    for state, (x, y) in enumerate(_columns(filter)):
        node = _add_state(automaton, state, x, y)
        if kind == "moore":
            ElementTree.SubElement(node, "output").text = str(colors[state])
        elif colors[state] > 1 and state != filter.trap:
            ElementTree.SubElement(node, "final")
    for source, row in enumerate(filter.transition.tolist()):
        for observation, target in enumerate(row):
            if target < 0:
                continue
            edge = _add_transition(automaton, source, target, str(observation))
            if kind == "moore":
                ElementTree.SubElement(edge, "transout").text = str(colors[target])
    return _text(root)


def _document(kind: str, name: str) -> tuple[ElementTree.Element, ElementTree.Element]:
    root = ElementTree.Element("structure")
    ElementTree.SubElement(root, "type").text = kind
    automaton = ElementTree.SubElement(root, "automaton")
    note = ElementTree.SubElement(automaton, "note")
    ElementTree.SubElement(note, "text").text = _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", name)
    _add_place(note, 0, -1)
    return root, automaton


def _add_state(automaton: ElementTree.Element, state: int, x: int, y: int) -> ElementTree.Element:
    node = ElementTree.SubElement(automaton, "state", id=str(state), name=f"q{state}")
    _add_place(node, x, y)
    if state == 0:
        ElementTree.SubElement(node, "initial")
    return node


def _add_place(node: ElementTree.Element, x: int, y: int) -> None:
    ElementTree.SubElement(node, "x").text = str(float(_SPACING * (x + 1)))
    ElementTree.SubElement(node, "y").text = str(float(_SPACING * (y + 2)))


def _add_transition(
    automaton: ElementTree.Element, source: int, target: int, read: str
) -> ElementTree.Element:
    edge = ElementTree.SubElement(automaton, "transition")
    ElementTree.SubElement(edge, "from").text = str(source)
    ElementTree.SubElement(edge, "to").text = str(target)
    ElementTree.SubElement(edge, "read").text = read
    return edge


def _columns(filter: Filter) -> Iterable[tuple[int, int]]:
    """Compute the column of each state, its distance from the start, and its row in the column."""
    column = [0] * len(filter.transition)
    height: list[int] = [1]
    row = [0] * len(filter.transition)
    met = {0}
    for source, targets in enumerate(filter.transition.tolist()):
        for target in targets:
            if target < 0 or target in met:
                continue
            met.add(target)
            column[target] = column[source] + 1
            if column[target] == len(height):
                height.append(0)
            row[target] = height[column[target]]
            height[column[target]] += 1
    return zip(column, row, strict=True)


def _text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    declaration = '<?xml version="1.0" encoding="UTF-8" standalone="no"?>\n'
    return declaration + ElementTree.tostring(root, encoding="unicode") + "\n"
