import dataclasses
import heapq
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Int, Integer

from ..base.shown import Shown
from .adaptive import Search, check_apart


# The numbers of the unsettled sets, one per possible observation string of a sequence of inputs.
_Family: TypeAlias = frozenset[int]


@dataclasses.dataclass(frozen=True, eq=False)
class Homing(Shown):
    """A fixed sequence of inputs whose observations identify the state of a machine."""

    inputs: Int[np.ndarray, "length"]
    "The homing sequence, as indices of inputs."
    least: int
    "A lower bound on the length of every such sequence."

    @property
    def optimal(self) -> bool:
        """`True` if it is proved that no sequence is shorter."""
        return self.least == self.inputs.size


def homing_sequence(
    images: Integer[np.ndarray, "inputs states"],
    observations: Integer[np.ndarray, "inputs states"],
    roots: Sequence[Sequence[int] | Int[np.ndarray, "_"]],
    *,
    place: Integer[np.ndarray, "states"] | None = None,
    limit: int = 1_000_000,
) -> Homing:
    """Find a fixed sequence of inputs whose observations identify the state of a machine.

    After the sequence, the states that are still possible are settled, as in [`adaptive_choice`][].
    A sequence always exists, because pairs of states can be distinguished one after the other. A
    greedy sequence is found first: each input leaves as few undistinguished states as possible.
    Then all sequences are searched, in the order of a lower bound on their total length.

    **Arguments:**

    - `images`, `observations`, `roots`, `place`: as in [`adaptive_choice`][].
    - `limit`: the search ends after it has produced this number of unsettled sets of states; the
        result is then the shortest sequence that was found.

    **Returns:** [`Homing`][].

    Three states in a circle, with a bell that rings in state 2:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> ring, rings = np.array([[1, 2, 0]]), np.array([[0, 0, 1]])
        >>> automata.homing_sequence(ring, rings, [[0, 1, 2]]).inputs.tolist()
        [0, 0]
    """
    check_apart(images, observations)
    search = Search(images, observations, place, "worst", limit)
    numbers = (search.number(tuple(sorted(map(int, root)))) for root in roots)
    start: _Family = frozenset(number for number in numbers if search.lower[number] > 0)
    best = _greedy_sequence(search, start)
    least = _least(search, start)
    length = {start: 0}
    before: dict[_Family, tuple[_Family, int]] = {}
    queue = [(least, 0, 0, start)]
    while queue and least < len(best):
        bound, _, _, family = heapq.heappop(queue)
        least = min(bound, len(best))
        if least == len(best) or limit <= 0:
            break
        limit -= len(family)
        for i in range(len(images)):
            after, longer = _after(search, family, i), length[family] + 1
            if longer >= length.get(after, len(best)):
                continue
            length[after], before[after] = longer, (family, i)
            if not after:
                best = []
                while after in before:
                    after, made = before[after]
                    best.insert(0, made)
                continue
            # Among equal bounds the longest sequence is first. The third entry is never equal, so
            # that families are not compared.
            entry = (longer + _least(search, after), -longer, len(before), after)
            heapq.heappush(queue, entry)
    if not queue:
        least = len(best)
    return Homing(np.array(best, np.int64), least)


def _after(search: Search, family: _Family, i: int) -> _Family:
    """Apply input `i` to each set of states in `family`; return the unsettled sets that result."""
    parts = (part for number in family for part in search.parts(number)[i].values())
    return frozenset(part for part in parts if search.lower[part] > 0)


def _least(search: Search, family: _Family) -> int:
    return max((search.lower[number] for number in family), default=0)


def _greedy_sequence(search: Search, family: _Family) -> list[int]:
    def together(family: _Family) -> int:
        return sum(len(search.sets[number]) - 1 for number in family)

    inputs = []
    while family:
        after = [_after(search, family, i) for i in range(len(search.image))]
        best = min(range(len(after)), key=lambda i: (together(after[i]), _least(search, after[i])))
        if together(after[best]) >= together(family):
            best = search.toward_nearest(sorted(family))
        inputs.append(best)
        family = after[best]
    return inputs
