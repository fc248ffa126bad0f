import numpy as np
from jaxtyping import Bool, Int, Integer

from ...base.memory import check


def incompatible_pairs(
    transition: Integer[np.ndarray, "states symbols"], color: Integer[np.ndarray, "states"]
) -> Bool[np.ndarray, "states states"]:
    """Find pairs of states that give different outputs on some string that is possible from both.

    Two states are incompatible if their outputs differ, or if their successors after some symbol
    are incompatible. `transition` is -1 for an impossible symbol.
    """
    states = len(transition)
    check(
        4 * states**2,
        f"comparing all pairs of {states:,} states",
        "use larger cells or fewer directions",
    )
    apart = color[:, None] != color
    changed = np.ones(states, bool)
    while changed.any():
        grown = np.zeros(states, bool)
        for after in transition.T:
            possible = np.flatnonzero(after >= 0)
            rows = possible[changed[after[possible]]]
            if not rows.size:
                continue
            block = apart[after[rows]][:, after[possible]]
            block |= apart[rows][:, possible]
            larger = np.any(block != apart[rows][:, possible], axis=1)
            apart[np.ix_(rows[larger], possible)] = block[larger]
            grown[rows[larger]] = True
        changed = grown
    return apart


def large_clique(adjacent: Bool[np.ndarray, "vertices vertices"]) -> Int[np.ndarray, "clique"]:
    """Find a large clique of a graph greedily, from each of the 32 vertices of highest degree."""
    degree = adjacent.sum(axis=1, dtype=np.int64)
    best: list[int] = []
    for first in np.argsort(-degree, kind="stable")[:32].tolist():
        clique, candidate, inside = [], np.ones(degree.size, bool), degree.copy()
        chosen = first
        while True:
            clique.append(chosen)
            lost = np.flatnonzero(candidate & ~adjacent[chosen])
            candidate[lost] = False
            if not candidate.any():
                break
            # The number of candidates that are adjacent to each candidate.
            inside -= adjacent[lost].sum(axis=0, dtype=np.int64)
            chosen = int(np.argmax(np.where(candidate, inside, -1)))
        best = max(best, clique, key=len)
    return np.array(best)
