import itertools

import numpy as np
from jaxtyping import Int32

from .filter import Filter


def minimize(filter: Filter) -> Filter:
    """Find the smallest filter with the same colours and the same impossible observations.

    This is the quotient by bisimulation (Moore's equivalence with missing edges preserved). Apart
    from the transient states, which form an acyclic graph, a filter has only knowledge cycles, each
    with its own colour (Alam 2018, Proposition 2.4.4); so the time is linear: a cycle is folded to
    the shortest period of its word, and transient states with the same successors are merged,
    successors first (Revuz 1992, for acyclic automata).

    In the quotient `cells` is the union of the configurations of the merged states, and
    `uncertainty` the largest uncertainty among them, which can be less than the size of that union:
    the quotient gives the same colours as the filter, and less precise cells.

    **Arguments:**

    - `filter`: a localization filter, closed- or open-world.

    **Returns:** [`Filter`][], with colours equal to those of `filter`.

    **Raises:** `ValueError` if states outside the knowledge cycles form a cycle, which subset
    construction never makes.

    A ring of four cells that bumps every second step, and a path into it. The filter knows the cell
    of the ring; its colours only give the half of the ring:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> image = np.array([1, 2, 3, 0, 0, 4])
        >>> bumped = np.array([False, True, False, True, True, True])
        >>> filter = automata.Filter.of(automata.subset_construction(image, bumped))
        >>> len(filter.transition), len(automata.minimize(filter).transition)
        (8, 6)
    """
    zero, one = filter.transition.T.tolist()
    block = _merge(filter, zero, one)

    # Number the blocks in breadth-first order; any state of a block stands for it.
    trap = filter.trap
    number = {block[0]: 0}
    queue = [0]
    transition: list[list[int]] = []
    for state in queue:
        row = []
        for target in (zero[state], one[state]):
            if target == -1 or target == trap:
                row.append(-1)
                continue
            if block[target] not in number:
                number[block[target]] = len(queue)
                queue.append(target)
            row.append(number[block[target]])
        transition.append(row)

    states = len(block) - filter.open_world
    numbers = np.array([number[b] for b in block[:states]], np.int32)
    uncertainty = np.zeros(len(queue), np.int32)
    np.maximum.at(uncertainty, numbers, filter.uncertainty[:states])
    cells = _unions(filter, numbers, len(queue))
    quotient = Filter(
        transition=np.array(transition, np.int32),
        uncertainty=uncertainty,
        offsets=np.cumsum([0, *map(len, cells)], dtype=np.int64),
        members=np.concatenate(cells),
        metadata=filter.metadata,
    )
    return quotient.with_trap() if filter.open_world else quotient


def _merge(filter: Filter, zero: list[int], one: list[int]) -> list[int]:
    """Return the number of each state's block of equivalent states."""
    block = [-1] * len(zero)
    done: list[int] = []
    blocks = 0
    for cycle in filter.cycles:
        period = _period(cycle.word)
        for position, state in enumerate(cycle.states.tolist()):
            block[state] = blocks + position % period
        done.extend(cycle.states.tolist())
        blocks += period
    if filter.trap is not None:
        block[filter.trap] = blocks
        done.append(filter.trap)
        blocks += 1

    # Successors come first: a state is done when all its edges lead to states that are done.
    open_edges = [(a >= 0) + (b >= 0) for a, b in zip(zero, one, strict=True)]
    settled = bytearray(len(zero))
    for state in done:
        settled[state] = True
    edges = np.flatnonzero(filter.transition >= 0)
    edges = edges[np.argsort(filter.transition.ravel()[edges], kind="stable")]
    into = np.searchsorted(filter.transition.ravel()[edges], np.arange(len(zero) + 1)).tolist()
    sources = (edges // 2).tolist()
    met: dict[tuple[int, int], int] = {}
    for state in done:
        for source in sources[into[state] : into[state + 1]]:
            open_edges[source] -= 1
            if open_edges[source] or settled[source]:
                continue
            after_0, after_1 = zero[source], one[source]
            key = (
                block[after_0] if after_0 >= 0 else -1,
                block[after_1] if after_1 >= 0 else -1,
            )
            block[source] = met.setdefault(key, blocks)
            blocks += block[source] == blocks
            done.append(source)
    if len(done) != len(zero):
        raise ValueError(
            f"filter: {len(zero) - len(done)} states are on or before a cycle that edges leave"
        )
    return block


def _period(word: str) -> int:
    """Return the shortest period of a cyclic word: its first nonzero shift that equals it."""
    return (word + word).index(word, 1)


def _unions(
    filter: Filter, numbers: Int32[np.ndarray, "states"], blocks: int
) -> list[Int32[np.ndarray, "_"]]:
    order = np.argsort(numbers, kind="stable")
    bounds = np.searchsorted(numbers[order], np.arange(blocks + 1)).tolist()
    states = order.tolist()
    unions = []
    for begin, end in itertools.pairwise(bounds):
        sets = [filter.cells(state) for state in states[begin:end]]
        unions.append(sets[0] if len(sets) == 1 else np.unique(np.concatenate(sets)))
    return unions
