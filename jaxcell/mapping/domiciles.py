import dataclasses

import jax
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Int
from scipy.sparse import csgraph

from .classes import PersistentGroups
from .generalized import Chain, leaving_rows


# The sink as a domicile.
SINK = -1


@dataclasses.dataclass(frozen=True, eq=False)
class TransientGroups:
    """Transient cells by where they may end: one group for each set of domiciles that occurs.

    A *domicile* of a transient cell is a persistent group that it can reach, and here also the
    sink, written -1. With one the cell is *single-domicile*, in the domain of attraction of that
    group; with several it is *multiple-domicile*, in the boundary region between their domains
    (Alam 2018, Definition 5.4.2).
    """

    group: Int[Array, "cells"]
    "The transient group of each cell, from 0 in the order of `domiciles`; -1 if persistent."
    domiciles: tuple[tuple[int, ...], ...]
    "The domiciles of each transient group, ascending; fewer come first, then smaller ones."
    size: Int[Array, "groups"]
    "Number of cells of each transient group."

    @property
    def count(self) -> int:
        """Number of transient groups."""
        return len(self.domiciles)

    @property
    def single(self) -> Bool[np.ndarray, "groups"]:
        """Whether a transient group has one domicile."""
        return np.array([len(homes) == 1 for homes in self.domiciles], bool)

    def first(self, cells: int) -> "TransientGroups":
        """The same for the first cells only, as [`PersistentGroups.first`][]."""
        group = np.asarray(self.group[:cells])
        used, number = np.unique(group[group >= 0], return_inverse=True)
        group = group.copy()
        group[group >= 0] = number
        homes = tuple(self.domiciles[one] for one in used)
        size = np.bincount(number, minlength=used.size)
        group, size = jax.device_put((group, size.astype(np.int32)))
        return TransientGroups(group, homes, size)


def transient_groups(chain: Chain, groups: PersistentGroups) -> TransientGroups:
    """Find the transient groups of a chain: cells with the same domiciles.

    Strongly connected cells have the same domiciles, and those of a component are the union of
    those of the components that it leads to. These are numbered backwards from the ends, a whole
    layer at a time, and sets that are equal are kept once; so any number of groups will do, where a
    table of groups and cells would not fit.

    **Arguments:**

    - `chain`: the chain.
    - `groups`: its persistent groups.

    **Returns:** [`TransientGroups`][].

    **Raises:** `ValueError` if the groups are of another chain.

    A random walk that ends at either end of a line of four cells:

        >>> from jaxcell import examples, mapping
        >>> chain = examples.ruin()
        >>> found = mapping.transient_groups(chain, mapping.persistent_groups(chain))
        >>> found.group.tolist(), found.domiciles
        ([-1, 0, 0, -1], ((0, 1),))
    """
    group = np.asarray(groups.group)
    if group.size != chain.cells:
        raise ValueError(
            f"groups: expected those of this chain of {chain.cells} cells, got those of one of "
            f"{group.size}"
        )
    matrix = chain.to_scipy()
    components, label = csgraph.connected_components(matrix, connection="strong")
    # One more component is the sink.
    leaving = np.flatnonzero(leaving_rows(matrix))
    source = np.concatenate([np.repeat(label, np.diff(matrix.indptr)), label[leaving]])
    target = np.concatenate([label[matrix.indices], np.full(leaving.size, components)])
    between = source != target
    later = scipy.sparse.csr_array(
        (np.ones(between.sum(), bool), (source[between], target[between])),
        shape=(components + 1, components + 1),
    )
    home = np.full(components + 1, SINK)
    home[label] = group
    number, sets = _unions(later, home)
    cells = np.flatnonzero(group < 0)
    used, within = np.unique(number[label[cells]], return_inverse=True)
    order = sorted(range(used.size), key=lambda n: (len(sets[used[n]]), sets[used[n]]))
    rank = np.argsort(np.array(order, np.int64))
    found = np.full(group.size, -1, np.int32)
    found[cells] = rank[within]
    size = np.bincount(found[cells], minlength=used.size)
    homes = tuple(sets[used[n]] for n in order)
    return TransientGroups(jax.device_put(found), homes, jax.device_put(size.astype(np.int32)))


def _unions(
    later: scipy.sparse.csr_array, home: Int[np.ndarray, "nodes"]
) -> tuple[Int[np.ndarray, "nodes"], list[tuple[int, ...]]]:
    """The homes of the ends that each node of a graph without circuits leads to.

    **Arguments:**

    - `later`: the edges.
    - `home`: the home of each node that leads nowhere.

    **Returns:** the number of the set of each node, and the sets.
    """
    earlier = later.T.tocsr()
    missing = np.diff(later.indptr).astype(np.int64)
    number = np.full(home.size, -1)
    ready = np.flatnonzero(missing == 0)
    homes, number[ready] = np.unique(home[ready], return_inverse=True)
    sets: list[tuple[int, ...]] = [(int(one),) for one in homes]
    known = {one: place for place, one in enumerate(sets)}
    joined: dict[tuple[int, ...], int] = {}
    while ready.size:
        tails = _rows_of(earlier, ready)[0]
        np.subtract.at(missing, tails, 1)
        tails = np.unique(tails)
        ready = tails[missing[tails] == 0]
        if not ready.size:
            break
        heads, start = _rows_of(later, ready)
        found = number[heads]
        least = np.minimum.reduceat(found, start[:-1])
        number[ready] = least
        for place in np.flatnonzero(least != np.maximum.reduceat(found, start[:-1])):
            parts = tuple(sorted(set(found[start[place] : start[place + 1]].tolist())))
            if parts not in joined:
                union = tuple(sorted(set().union(*(sets[part] for part in parts))))
                joined[parts] = known.setdefault(union, len(sets))
                if joined[parts] == len(sets):
                    sets.append(union)
            number[ready[place]] = joined[parts]
    return number, sets


def _rows_of(
    graph: scipy.sparse.csr_array, rows: Int[np.ndarray, "rows"]
) -> tuple[Int[np.ndarray, "edges"], Int[np.ndarray, "rows+1"]]:
    """The edges of some rows of a graph, one row after the other, and where each begins."""
    length = graph.indptr[rows + 1] - graph.indptr[rows]
    start = np.concatenate([[0], np.cumsum(length)])
    place = np.arange(start[-1]) + np.repeat(graph.indptr[rows] - start[:-1], length)
    return graph.indices[place], start
