import json

from ..filter import Filter


def to_dot(filter: Filter, *, name: str = "filter") -> str:
    """Write the filter as a Graphviz graph.

    A state shows its number and, below, its uncertainty; the start is a double circle, each
    knowledge cycle has its own hue, and the trap is a box.

    **Arguments:**

    - `filter`: a localization filter.
    - `name`: the title of the graph.

    **Returns:** the text of a `.dot` file.

    The last edge of the filter of a ring of three cells:

        >>> from jaxcell import automata, examples
        >>> filter = examples.ring()
        >>> print(automata.to_dot(filter).splitlines()[-2])
          4 -> 3 [label="0"];
    """
    lines = [
        f"digraph {_dot_string(name)} {{",
        f"  label={_dot_string(name)};",
        "  rankdir=LR;",
        "  node [shape=circle, style=filled, fillcolor=white];",
    ]
    colors = filter.color.tolist()
    for state, (color, uncertainty) in enumerate(
        zip(colors, filter.uncertainty.tolist(), strict=True)
    ):
        marks = [f'label="{state}\\n{uncertainty}"']
        if state == 0:
            marks.append("shape=doublecircle")
        if state == filter.trap:
            marks += ["shape=box", "fillcolor=gray"]
        elif color > 1:
            # Steps of the golden ratio make the hues of any number of cycles distinct.
            marks.append(f'fillcolor="{(color - 2) * 0.618034 % 1:.3f} 0.4 1.0"')
        lines.append(f"  {state} [{', '.join(marks)}];")
    for source, row in enumerate(filter.transition.tolist()):
        for observation, target in enumerate(row):
            if target >= 0:
                lines.append(f'  {source} -> {target} [label="{observation}"];')
    return "\n".join([*lines, "}", ""])


def to_json(filter: Filter) -> str:
    """Write the filter as one JSON object, for other programs.

    Fields: `transition` (rows of the states after 0 and 1, -1 for none), `color`, `uncertainty`,
    `open_world`, `trap` (a state, or null), `metadata`, and `cycles`, each with `color`,
    `uncertainty`, `word`, `states`, and `cells`, the configurations of each of its states.
    Configurations of other states are omitted, because there are too many.

    **Arguments:**

    - `filter`: a localization filter.

    **Returns:** the text of a `.json` file.

    The filter of a ring of three cells:

        >>> import json
        >>> from jaxcell import automata, examples
        >>> filter = examples.ring()
        >>> json.loads(automata.to_json(filter))["transition"]
        [[1, 2], [3, 2], [4, -1], [-1, 2], [3, -1]]
    """
    described = {
        "format": "jaxcell filter",
        "version": 1,
        "open_world": filter.open_world,
        "trap": filter.trap,
        "transition": filter.transition.tolist(),
        "color": filter.color.tolist(),
        "uncertainty": filter.uncertainty.tolist(),
        "cycles": [
            {
                "color": cycle.color,
                "uncertainty": cycle.uncertainty,
                "word": cycle.word,
                "states": cycle.states.tolist(),
                "cells": [filter.cells(state).tolist() for state in cycle.states.tolist()],
            }
            for cycle in filter.cycles
        ],
        "metadata": filter.metadata,
    }
    return json.dumps(described, allow_nan=False) + "\n"


def _dot_string(text: str) -> str:
    """Quote a DOT string that shows the text literally."""
    printable = "".join(
        c if c.isprintable() or c == "\n" else "\N{REPLACEMENT CHARACTER}" for c in text
    )
    escaped = printable.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'
