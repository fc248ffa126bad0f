import dataclasses

import numpy as np
from jaxtyping import Bool, Int32, Integer

from ..base.shown import Shown


@dataclasses.dataclass(frozen=True, eq=False)
class KnowledgeCycle(Shown):
    """A cycle of states without exits: a robot whose filter is in such a cycle is localized."""

    states: Int32[np.ndarray, "length"]
    "The states in the order of the cycle, starting with the smallest state."
    color: int
    "The colour of the states of the cycle in the filter, 2 or more."
    uncertainty: int
    "The number of possible configurations in each state of the cycle."
    word: str
    "The observations of one round of the cycle, as digits, starting in the smallest state."


def knowledge_cycles(
    transition: Int32[np.ndarray, "states 2"], uncertainty: Int32[np.ndarray, "states"]
) -> tuple[KnowledgeCycle, ...]:
    """Find the knowledge cycles of an automaton, in the order of their smallest states."""
    states = transition.shape[0]
    single = np.sum(transition >= 0, axis=1) == 1
    # A state without a choice has one successor; all other states, which are in no knowledge cycle,
    # share a sink.
    successor = np.append(np.where(single, transition.max(axis=1), states), states)
    word = np.where(transition[:, 1] >= 0, "1", "0")
    cycles: list[KnowledgeCycle] = []
    seen = {states}
    for smallest in np.flatnonzero(periodic_nodes(successor)).tolist():
        if smallest in seen:
            continue
        cycle, state = [], smallest
        while state not in seen:
            seen.add(state)
            cycle.append(state)
            state = successor.item(state)
        cycles.append(
            KnowledgeCycle(
                states=np.array(cycle, np.int32),
                color=len(cycles) + 2,
                uncertainty=uncertainty.item(smallest),
                word="".join(word[cycle].tolist()),
            )
        )
    return tuple(cycles)


def periodic_nodes(successor: Integer[np.ndarray, "nodes"]) -> Bool[np.ndarray, "nodes"]:
    """Find the nodes of a functional graph that are on a cycle."""
    # A power of the map whose exponent is at least the number of nodes maps all nodes to them.
    for _ in range(successor.size.bit_length()):
        successor = successor[successor]
    periodic = np.zeros(successor.size, bool)
    periodic[successor] = True
    return periodic
