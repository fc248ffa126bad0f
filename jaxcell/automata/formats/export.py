import json

from ..filter import Filter
from ..machine import MooreMachine


def to_dot(filter: Filter | MooreMachine) -> str:
    """Write a filter or a machine as a Graphviz graph.

    A state shows its number and, below it, its uncertainty (in a machine, its output). The start is
    a double circle, each knowledge cycle has its own hue, and the trap is a box.

    **Arguments:** a filter or a machine. **Returns:** the text.

    The last edge of the filter of a ring of three cells:

        >>> from jaxcell import automata, examples
        >>> print(automata.to_dot(examples.ring()).splitlines()[-2])
          4 -> 3 [label="0"];
    """
    lines = [
        'digraph "filter" {',
        '  label="filter";',
        "  rankdir=LR;",
        "  node [shape=circle, style=filled, fillcolor=white];",
    ]
    colors = filter.color.tolist()
    if isinstance(filter, MooreMachine):
        shown, final, trap = filter.color, filter.final, None
    else:
        shown, final, trap = filter.uncertainty, 2, filter.trap
    for state, (color, uncertainty) in enumerate(zip(colors, shown.tolist(), strict=True)):
        marks = [f'label="{state}\\n{uncertainty}"']
        if state == 0:
            marks.append("shape=doublecircle")
        if state == trap:
            marks += ["shape=box", "fillcolor=gray"]
        elif color >= final:
            # Steps of the golden ratio make the hues of any number of cycles distinct.
            marks.append(f'fillcolor="{(color - final) * 0.618034 % 1:.3f} 0.4 1.0"')
        lines.append(f"  {state} [{', '.join(marks)}];")
    for source, row in enumerate(filter.transition.tolist()):
        for observation, target in enumerate(row):
            if target >= 0:
                lines.append(f'  {source} -> {target} [label="{observation}"];')
    return "\n".join([*lines, "}", ""])


def to_json(filter: Filter | MooreMachine) -> str:
    """Write a filter or a machine as one JSON object, for other programs.

    The fields of a filter are `transition` (for each state, the states after 0 and 1, or -1),
    `color`, `uncertainty`, `open_world`, `trap` (a state, or null), `metadata` and `cycles`. Each
    cycle has `color`, `uncertainty`, `word`, `states` and `cells`, the configurations of each of
    its states. Configurations of states outside cycles are omitted because there may be too many.
    The fields of a machine are `transition` (for each state, the state after each symbol, or -1),
    `color`, `runs` and `final`.

    **Arguments:** a filter or a machine. **Returns:** the text.

    The filter of a ring of three cells:

        >>> import json
        >>> from jaxcell import automata, examples
        >>> json.loads(automata.to_json(examples.ring()))["transition"]
        [[1, 2], [3, 2], [4, -1], [-1, 2], [3, -1]]
    """
    if isinstance(filter, MooreMachine):
        arrays = {name: getattr(filter, name).tolist() for name in ("transition", "color")}
        described = {"format": "jaxcell machine", "version": 1, **arrays}
        described |= {"runs": filter.runs, "final": filter.final}
        return json.dumps(described) + "\n"
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
