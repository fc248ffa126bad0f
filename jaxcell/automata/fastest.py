import numpy as np

from .filter import Filter


def fastest_localization(filter: Filter, uncertainty: int | None = None) -> str | None:
    """Find the shortest observation string that localizes a robot.

    **Arguments:** a filter, and the uncertainty of the knowledge cycle to reach, by default any.
    **Returns:** the string, the first of several in dictionary order, or `None` if no knowledge
    cycle has this uncertainty.

    A robot goes round three cells, and bumps in one of them, so that the bump identifies the cell:

        >>> from jaxcell import automata, examples
        >>> filter = examples.ring()
        >>> automata.fastest_localization(filter)
        '1'
    """
    goals = [
        cycle.states.min()
        for cycle in filter.cycles
        if uncertainty is None or cycle.uncertainty == uncertainty
    ]
    if not goals:
        return None
    # States are numbered breadth-first: the smallest goal is the nearest, and the first edge to a
    # state is on the shortest string to it.
    flat = filter.transition.ravel()
    met, edge = np.unique(flat, return_index=True)
    state, string = int(min(goals)), []
    while state:
        parent, observation = divmod(edge.item(np.searchsorted(met, state)), 2)
        string.append("01"[observation])
        state = parent
    return "".join(reversed(string))
