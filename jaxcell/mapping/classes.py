import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Int
from scipy.sparse import csgraph

from ..base.certificate import Whole
from ..base.shown import Pictured
from ..base.wide import traced
from .generalized import Chain, ChainLike, leaving_rows
from .sequence import ChainSequence
from .traced import like, on_host


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class PersistentGroups(Pictured):
    """The persistent groups of a chain (Alam 2018, Definition 3.3.3).

    If JAX traces the search, `size` and `period` have an entry per cell; those past `count` are 0.
    """

    group: Int[Array, "cells"]
    "The group of each cell, from 0 in the order of the smallest cells of groups; -1 if transient."
    count: Whole
    "Number of persistent groups."
    size: Int[Array, "groups"]
    "Number of cells of each group."
    _chain: Chain = dataclasses.field(repr=False)
    # The groups of all states of the chain, if the cells are only the first of the states.
    _states: Int[Array, "states"] | None = dataclasses.field(default=None, repr=False)

    def first(self, cells: int) -> "PersistentGroups":
        """Keep only the first `cells` states: the cells at phase 0 of a [`ChainSequence`][]."""
        group, rows = self.group[:cells], self.size.shape[0]
        form = like(int, rows)
        size = on_host(functools.partial(_sizes, rows=rows), form, (), group)
        return PersistentGroups(group, self.count, jax.device_put(size), self._chain, self.group)

    @functools.cached_property
    def period(self) -> Int[Array, "groups"]:
        """The period of each group: the greatest common divisor of the lengths of its circuits."""
        rows = self.size.shape[0]
        group = self.group if self._states is None else self._states
        # Whole periods lead from cells at a phase to cells at the same phase.
        phases = self._chain.cells // self.group.shape[0]
        compute = functools.partial(periods, rows=rows)
        period = on_host(compute, like(int, rows), self._chain, group, of_steps=True)
        return jax.device_put(period) // phases


def _sizes(_: Any, group: Int[np.ndarray, "cells"], rows: int) -> Int[np.ndarray, "groups"]:
    group = np.asarray(group)
    return np.bincount(group[group >= 0], minlength=rows).astype(np.int32)


def periods(
    matrix: scipy.sparse.csr_array, group: Int[np.ndarray, "states"], rows: int
) -> Int[np.ndarray, "groups"]:
    """Return the periods of the closed classes `group`, in `rows` rows."""
    group = np.asarray(group)
    inside = np.flatnonzero(group >= 0)
    group = group[inside]
    edges = matrix[inside][:, inside].tocoo()
    # The breadth-first levels of a cell and of its images differ by 1, modulo the period. Circuits
    # are detected where they differ by another number.
    _, roots = np.unique(group, return_index=True)
    level = np.zeros(inside.size, np.int64)
    if inside.size:
        distance = csgraph.dijkstra(edges.tocsr(), indices=roots, unweighted=True, min_only=True)
        level = distance.astype(np.int64)
    period = np.zeros(rows, np.int64)
    np.gcd.at(period, group[edges.row], level[edges.row] + 1 - level[edges.col])
    return period.astype(np.int32)


def check_groups(chain: Chain, groups: PersistentGroups) -> Any:
    """Return the group of each cell, -1 for none, and check that the chain has these `groups`.

    The values of arrays that JAX traces are not checked.
    """
    if groups.group.shape != (chain.cells,):
        raise ValueError(
            f"groups: expected the groups of this chain of {chain.cells} cells, got the groups of "
            f"a chain of {groups.group.size}"
        )
    if traced(chain, groups):
        return jnp.asarray(groups.group)
    group = np.asarray(groups.group)
    if groups._chain is not chain:
        wrong = np.flatnonzero(np.asarray(persistent_groups(chain).group) != group)
        if wrong.size:
            raise ValueError(
                f"groups: expected the groups of this chain, got those of another chain, which "
                f"differ at cell {wrong[0]}; find them with persistent_groups(chain)"
            )
    return group


def reaching(
    matrix: scipy.sparse.csr_array, target: Bool[np.ndarray, "cells"]
) -> Bool[np.ndarray, "cells"]:
    """Return a mask of the cells from which a set can be reached, including the set.

    `matrix` is a transition matrix without explicit zeros, and `target` a mask of the set.
    """
    return next_cells(matrix, target) >= 0


def next_cells(
    matrix: scipy.sparse.csr_array, target: Bool[np.ndarray, "cells"]
) -> Int[np.ndarray, "cells"]:
    """Return the next cell on a shortest path from each cell to a set of cells.

    For a cell of the set, the result is the total number of cells; for a cell without a path, it is
    negative. `matrix` is a transition matrix without explicit zeros.
    """
    cells = target.size
    goals = np.flatnonzero(target)
    source = np.repeat(np.arange(cells), np.diff(matrix.indptr))
    # The search goes backwards along the edges, from an additional node that leads to the set.
    tail = np.concatenate([matrix.indices, np.full(goals.size, cells)])
    head = np.concatenate([source, goals])
    backwards = scipy.sparse.csr_array(
        (np.ones(tail.size), (tail, head)), shape=(cells + 1, cells + 1)
    )
    return csgraph.breadth_first_order(backwards, cells)[1][:-1]


def persistent_groups(chain: ChainLike | ChainSequence) -> PersistentGroups:
    """Find the persistent groups of a chain: its closed communicating classes.

    These are the strongly connected components without edges to other cells or to the sink; all
    other cells are transient. The components are found on the host, in time proportional to the
    number of edges.

    **Arguments:** a chain, or a [`ChainSequence`][]. The groups of a sequence are those of its
    period map, but are found in its sparse unrolled chain. **Returns:** the group of each cell.

    Cells 1 and 2 lead to each other, cell 3 leads to itself, and cell 0 leads to both groups:

        >>> import numpy as np
        >>> from jaxcell import mapping
        >>> P = np.array([[0, 0.5, 0, 0.5], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
        >>> chain = mapping.Chain.from_scipy(P)
        >>> groups = mapping.persistent_groups(chain)
        >>> groups.group.tolist(), groups.period.tolist()
        ([-1, 0, 0, 1], [2, 1])
    """
    if isinstance(chain, ChainSequence):
        return persistent_groups(chain.unrolled).first(chain.cells)
    form = like(int, chain.cells), like(int), like(int, chain.cells)
    group, count, size = on_host(closed_classes, form, chain, of_steps=True)
    group, size = jax.device_put((group, size))
    return PersistentGroups(group, count, size, chain)


def closed_classes(
    matrix: scipy.sparse.csr_array,
) -> tuple[Int[np.ndarray, "cells"], int, Int[np.ndarray, "groups"]]:
    """Return the group of each cell, the number of groups, and the sizes of the groups."""
    components, label = csgraph.connected_components(matrix, connection="strong")
    source = np.repeat(label, np.diff(matrix.indptr))
    open_ = np.zeros(components, bool)
    open_[source[source != label[matrix.indices]]] = True
    open_[label[leaving_rows(matrix) > 0]] = True
    closed = np.flatnonzero(~open_)
    persistent = np.flatnonzero(~open_[label])
    smallest = np.zeros(components, np.int64)
    # The assignment goes from the last cell to the first, so that the first remains.
    smallest[label[persistent[::-1]]] = persistent[::-1]
    closed = closed[np.argsort(smallest[closed])]
    number = np.full(components, -1, np.int32)
    number[closed] = np.arange(closed.size)
    group = number[label]
    return (
        group,
        closed.size,
        np.bincount(group[persistent], minlength=closed.size).astype(np.int32),
    )
