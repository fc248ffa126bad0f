import dataclasses
import itertools

import jax
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Int
from scipy.sparse import csgraph

from ..base.shown import Pictured
from .classes import PersistentGroups, check_groups
from .generalized import Chain, ChainLike


# The sink as a domicile.
SINK = -1
# Number of nodes whose edges are listed at once.
_CHUNK = 1 << 16


@dataclasses.dataclass(frozen=True, eq=False)
class TransientGroups(Pictured):
    """The transient groups of a chain: transient cells with the same domiciles form a group.

    A *domicile* of a transient cell is a persistent group that it can reach. The sink is also a
    domicile, written -1, if the cell can reach it. A cell with one domicile is *single-domicile*,
    in the domain of attraction of that group. A cell with several domiciles is *multiple-domicile*,
    in the boundary region between their domains of attraction (Alam 2018, Definition 5.4.2).
    """

    group: Int[Array, "cells"]
    "The transient group of each cell, from 0 in the order of `domiciles`; -1 if persistent."
    domiciles: tuple[tuple[int, ...], ...]
    "The domiciles of each group, in ascending order; groups with few domiciles come first."
    size: Int[Array, "groups"]
    "Number of cells of each transient group."

    @property
    def count(self) -> int:
        """Number of transient groups."""
        return len(self.domiciles)

    @property
    def single(self) -> Bool[np.ndarray, "groups"]:
        """A mask of the transient groups with one domicile."""
        return np.array([len(domiciles) == 1 for domiciles in self.domiciles], bool)

    def first(self, cells: int) -> "TransientGroups":
        """Keep only the first `cells` states: the cells at phase 0 of a [`ChainSequence`][]."""
        group = np.asarray(self.group[:cells])
        used, number = np.unique(group[group >= 0], return_inverse=True)
        group = group.copy()
        group[group >= 0] = number
        domiciles = tuple(self.domiciles[place] for place in used)
        size = np.bincount(number, minlength=used.size)
        group, size = jax.device_put((group, size.astype(np.int32)))
        return TransientGroups(group, domiciles, size)


def transient_groups(chain: ChainLike, groups: PersistentGroups) -> TransientGroups:
    """Find the transient groups of a chain: cells with the same domiciles.

    Two searches follow the steps backward from the domiciles, one search in ascending and one in
    descending order of the domiciles. They find the smallest and the largest domicile of each cell.
    If these are equal, the cell has no other domicile. The other cells are divided into strongly
    connected components. The domiciles of a component are the union of those of the components to
    which it leads. Equal unions are stored once, so no table of groups and cells is needed.

    It runs on the host, because the sets of domiciles have different sizes.

    **Arguments:** a chain, and its persistent groups. **Returns:** the transient group of each
    cell, and the domiciles of each group.

    A random walk that stops at both ends of a line of four cells:

        >>> from jaxcell import examples, mapping
        >>> chain = examples.ruin()
        >>> groups = mapping.transient_groups(chain, mapping.persistent_groups(chain))
        >>> groups.group.tolist(), groups.domiciles
        ([-1, 0, 0, -1], ((0, 1),))
    """
    group = check_groups(chain, groups)
    matrix = chain.to_scipy()
    least, most = _outermost(chain, group, groups.count)
    several = least < most
    inner = matrix[several]
    tails = np.repeat(np.arange(inner.shape[0]), np.diff(inner.indptr))
    leaving = np.flatnonzero(chain.can_leave[several])
    components, label = csgraph.connected_components(inner[:, several], connection="strong")
    # A node for each domicile precedes the components, and steps lead to preceding nodes.
    domiciles = groups.count + 1
    node = least.copy()
    node[several] = label + domiciles
    source = np.concatenate([label[tails], label[leaving]]) + domiciles
    target = np.concatenate([node[inner.indices], np.zeros(leaving.size, int)])
    between = source != target
    # scipy numbers components backwards along the steps, but does not guarantee it.
    assert (source >= target).all()
    later = scipy.sparse.csr_array(
        (np.ones(between.sum(), bool), (source[between], target[between])),
        shape=(components + domiciles,) * 2,
    )
    number, sets = _unions(later, domiciles)
    cells = np.flatnonzero(group < 0)
    count = np.bincount(number[node[cells]], minlength=len(sets))
    order = sorted(np.flatnonzero(count).tolist(), key=lambda n: (len(sets[n]), sets[n]))
    rank = np.empty(len(sets), np.int32)
    rank[order] = np.arange(len(order))
    number_of_cell = np.full(group.size, -1, np.int32)
    number_of_cell[cells] = rank[number[node[cells]]]
    placed, size = jax.device_put((number_of_cell, count[order].astype(np.int32)))
    return TransientGroups(placed, tuple(sets[n] for n in order), size)


def _outermost(
    chain: Chain, group: Int[np.ndarray, "cells"], groups: int
) -> tuple[Int[np.ndarray, "cells"], Int[np.ndarray, "cells"]]:
    """Find the smallest and the largest domicile of each cell: 0 is the sink, `k + 1` group `k`."""
    earlier = chain.to_scipy().tocsc()
    persistent = np.flatnonzero(group >= 0)
    _, first = np.unique(group[persistent], return_index=True)
    seeds = [np.flatnonzero(chain.can_leave), *persistent[first, None]]

    def first_seed(seeds: list[Int[np.ndarray, "_"]]) -> Int[np.ndarray, "cells"]:
        """Find the number of the first list in `seeds` to which each cell leads.

        The graph has a node for each list, with edges to its cells, and edges backward along steps.
        A depth-first search from one list after another numbers strong components as it leaves
        them. Cells that lead to a list, but to no earlier list, have numbers just below it.
        """
        ends = np.cumsum([0, *map(len, seeds)])
        start = np.concatenate([ends, ends[-1] + earlier.indptr[1:]])
        to = np.concatenate([*seeds, earlier.indices]) + len(seeds)
        graph = scipy.sparse.csr_array((np.ones(to.size), to, start), shape=(start.size - 1,) * 2)
        _, label = csgraph.connected_components(graph, connection="strong")
        of_label = np.repeat(np.arange(len(seeds)), np.diff(label[: len(seeds)], prepend=-1))
        return of_label[label[len(seeds) :]]

    return first_seed(seeds), groups - first_seed(seeds[::-1])


def _unions(
    later: scipy.sparse.csr_array, domiciles: int
) -> tuple[Int[np.ndarray, "nodes"], list[tuple[int, ...]]]:
    """Find the set of domiciles to which each node of a graph leads.

    The first nodes are the domiciles: the sink, then the groups. They have no edges to other nodes.
    All edges lead to preceding nodes. Returns the number of the set of each node, and the sets.
    """
    number = list(range(domiciles))
    sets: list[tuple[int, ...]] = [(place + SINK,) for place in range(domiciles)]
    known = {one: place for place, one in enumerate(sets)}
    joined: dict[tuple[int, int], int] = {}
    for first in range(domiciles, later.shape[0], _CHUNK):
        ends = later.indptr[first : first + _CHUNK + 1]
        heads = iter(later.indices[ends[0] : ends[-1]].tolist())
        for length in np.diff(ends).tolist():
            union = number[next(heads)]
            for head in itertools.islice(heads, length - 1) if length > 1 else ():
                other = number[head]
                if other != union:
                    pair = union, other
                    union = joined.get(pair, -1)
                    if union < 0:
                        both = tuple(sorted({*sets[pair[0]], *sets[pair[1]]}))
                        union = joined[pair] = known.setdefault(both, len(sets))
                        if union == len(sets):
                            sets.append(both)
            number.append(union)
    return np.array(number), sets
