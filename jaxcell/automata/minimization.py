import numpy as np
from jaxtyping import Int, Integer

from .equivalent import equivalence
from .filter import Filter


def minimize(filter: Filter) -> Filter:
    """Find the smallest filter with the same colours and the same impossible observations.

    Equivalent states are merged (Moore's equivalence; states with different impossible observations
    are not equivalent). A merged state has the possible cells of all states merged into it, and the
    largest of their uncertainties. So the colours are the same, but the cells may be less precise.

    **Arguments:** a filter. **Returns:** the smallest filter.

    A robot bumps every second step on a ring of four cells with a path into it. The original filter
    finds the cell on the ring; the colours distinguish only two halves of the ring:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> image = np.array([1, 2, 3, 0, 0, 4])
        >>> bumped = np.array([False, True, False, True, True, True])
        >>> filter = automata.Filter.of(automata.subset_construction(image, bumped))
        >>> len(filter.transition), len(automata.minimize(filter).transition)
        (8, 6)
    """
    transition = filter.closed_transition
    states = len(transition)
    label, first = moore_classes(transition, filter.color[:states])
    # Classes are in breadth-first order, as their smallest states are.
    after = transition[first]
    uncertainty = np.zeros(first.size, np.int32)
    np.maximum.at(uncertainty, label, filter.uncertainty[:states])
    # The possible cells of one class after the other, because all sets at once take much memory.
    order = np.argsort(label, kind="stable")
    cells = []
    for members in np.split(order, np.searchsorted(label[order], np.arange(1, first.size))):
        sets = [filter.cells(state) for state in members.tolist()]
        cells.append(sets[0] if len(sets) == 1 else np.unique(np.concatenate(sets)))
    quotient = Filter(
        transition=np.where(after < 0, np.int32(-1), label[after]),
        uncertainty=uncertainty,
        offsets=np.cumsum([0, *map(len, cells)], dtype=np.int64),
        members=np.concatenate(cells),
        metadata=filter.metadata,
    )
    return quotient.with_trap() if filter.open_world else quotient


def moore_classes(
    transition: Integer[np.ndarray, "states symbols"], color: Integer[np.ndarray, "states"]
) -> tuple[Int[np.ndarray, "states"], Int[np.ndarray, "classes"]]:
    """Find the class of each state under Moore's equivalence, and the first state of each class.

    States with different outputs, or different impossible symbols (-1 in `transition`), are not
    equivalent.
    """
    states = len(transition)
    # An impossible symbol leads to one more state, with an output of its own.
    images = np.where(transition < 0, states, transition)
    images = np.vstack([images, np.full_like(images[:1], states)]).T
    color = np.append(color, color.max() + 1)
    label = equivalence(images, np.tile(color, (len(images), 1)))[:-1]
    return label, np.unique(label, return_index=True)[1]
