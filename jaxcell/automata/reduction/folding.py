from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Int, Integer


def folded(
    transition: Integer[np.ndarray, "states symbols"],
    apart: Bool[np.ndarray, "states states"],
    go_on: Callable[[], bool],
) -> Int[np.ndarray, "states"]:
    """Merge each state with the first earlier state with which it can be merged.

    If two states are merged, their successors after each symbol that can occur in both are merged
    too, and so on. States can be merged if afterwards no class contains two states that are
    `apart`. Merging ends early if `go_on()` returns `False`. Returns the smallest state in the
    class of each state.
    """
    partition = _Partition(transition, apart)
    kept = [0]
    for state in range(1, len(transition)):
        if not go_on():
            break
        if partition.find(state) == state and not any(partition.merge(a, state) for a in kept):
            kept.append(state)
        else:
            kept = [head for head in kept if partition.find(head) == head]
    return np.array([partition.find(state) for state in range(len(transition))])


class _Partition:
    """A partition of states into classes, which are named by their smallest states."""

    def __init__(
        self,
        transition: Integer[np.ndarray, "states symbols"],
        apart: Bool[np.ndarray, "states states"],
    ) -> None:
        packed = np.packbits(apart, axis=1, bitorder="little")
        # Sets of states, as the bits of integers.
        self.apart = dict(enumerate(int.from_bytes(row.tobytes(), "little") for row in packed))
        self.members = {state: 1 << state for state in range(len(transition))}
        self.after = {
            state: {symbol: after for symbol, after in enumerate(row) if after >= 0}
            for state, row in enumerate(transition.tolist())
        }
        self.parent: dict[int, int] = {}

    def find(self, state: int, parent: dict[int, int] | None = None) -> int:
        for parents in (self.parent, parent or {}):
            while state in parents:
                state = parents[state]
        return state

    def merge(self, a: int, b: int) -> bool:
        """Merge the classes of two states and of their successors; return `False` if impossible."""
        parent: dict[int, int] = {}
        apart: dict[int, int] = {}
        members: dict[int, int] = {}
        after: dict[int, dict[int, int]] = {}
        pairs = [(a, b)]
        while pairs:
            a, b = sorted(self.find(state, parent) for state in pairs.pop())
            if a == b:
                continue
            others, row = members.get(b, self.members[b]), apart.get(a, self.apart[a])
            if row & others:
                return False
            parent[b] = a
            members[a] = members.get(a, self.members[a]) | others
            apart[a] = row | apart.get(b, self.apart[b])
            onward = dict(after.get(a, self.after[a]))
            for symbol, target in after.get(b, self.after[b]).items():
                if onward.setdefault(symbol, target) != target:
                    pairs.append((onward[symbol], target))
            after[a] = onward
        self.parent.update(parent)
        self.apart.update(apart)
        self.members.update(members)
        self.after.update(after)
        return True
