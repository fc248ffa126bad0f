import itertools

import numpy as np
from jaxtyping import Int32

from .equivalent import equivalence
from .filter import Filter


def minimize(filter: Filter) -> Filter:
    """Find the smallest filter with the same colours and the same impossible observations.

    It is the quotient by bisimulation (Moore's equivalence with missing edges preserved). Its
    `cells` is the union of the configurations of the merged states, and `uncertainty` the largest
    uncertainty among them, which can be less than the size of that union: the quotient gives the
    same colours as the filter, and less precise cells.

    **Arguments:** a filter. **Returns:** the quotient.

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
    states = len(filter.transition) - filter.open_world
    transition = filter.transition[:states]
    # Impossible observations lead to one more state, as to a trap; its class is the last.
    images = np.append(np.where(transition < 0, states, transition), [[states] * 2], axis=0).T
    color = np.append(filter.color[:states], 0)
    label = equivalence(images, np.stack([color, color])).label
    # Classes are in breadth-first order, as their smallest states are.
    count = int(label[-1])
    first = np.unique(label[:-1], return_index=True)[1]
    after = label[images.T[first]]
    uncertainty = np.zeros(count, np.int32)
    np.maximum.at(uncertainty, label[:-1], filter.uncertainty[:states])
    cells = _unions(filter, label[:-1], count)
    quotient = Filter(
        transition=np.where(after == count, np.int32(-1), after),
        uncertainty=uncertainty,
        offsets=np.cumsum([0, *map(len, cells)], dtype=np.int64),
        members=np.concatenate(cells),
        metadata=filter.metadata,
    )
    return quotient.with_trap() if filter.open_world else quotient


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
