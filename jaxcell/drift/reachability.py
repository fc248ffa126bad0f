import dataclasses
import functools
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Bool, Int

from ..base.quantities import Result, derived
from ..mapping import Chain
from ..mapping.classes import reaching
from ..mapping.traced import like, on_host
from ..markov.hitting import cell_mask
from .layered_cells import Sea


_flag = functools.partial(derived, "layer y x", kind="flag")
_count = functools.partial(derived, "layer", kind="count", listed=True)


def reachable(chain: Chain, start: npt.ArrayLike | int) -> Bool[Any, "cells"]:
    """Find the cells that a chain can ever reach, including the start.

    A cell can be reached if the chain visits it with any positive probability, after any time.

    **Arguments:** the chain; and the start: a cell, several cells, or a mask over the cells. Both
    may be traced by `jit` and `vmap`. **Returns:** a mask over the cells.

    From cell 1 drifters go to cell 2 or 3, and do not return:

        >>> from jaxcell import drift, examples
        >>> chain = examples.stream()
        >>> drift.reachable(chain, 1).tolist()
        [False, True, True, True]
    """
    begin, form = cell_mask(chain.cells, start, "start"), like(bool, chain.cells)
    return on_host(_reached, form, chain, begin, of_steps=True)


def _reached(
    matrix: scipy.sparse.csr_array, begin: Bool[np.ndarray, "cells"]
) -> Bool[np.ndarray, "cells"]:
    return reaching(matrix.T.tocsr(), begin)


def reachable_by_layer(sea: Sea, start: int) -> Bool[np.ndarray, "cells"]:
    """Find the cells that drifters can ever reach in each layer (Alam 2018, Alg. 5.4).

    At the start, drifters go down to every layer above the sea bed; then each stays in its layer.

    **Arguments:** the layers; and the cell of the surface where drifters are dropped.
    **Returns:** a mask over the cells of all layers.

    Two layers of three cells; at the surface everything drifts East, below it West:

        >>> from jaxcell import drift, examples
        >>> sea = examples.sea()
        >>> drift.reachable_by_layer(sea, 1).tolist()
        [False, True, True, True, True, False]
    """
    begin = [_at_surface(sea, start)]
    while (below := int(sea.below[begin[-1]])) >= 0:
        begin.append(below)
    return sea.at_any_phase(reachable(sea.drift, begin))


def reachable_at_depth(sea: Sea, start: int) -> Bool[np.ndarray, "cells"]:
    """Find the cells that a drifter can ever reach if it goes up and down at any time.

    These are the cells to which some policy leads with positive probability. Algorithm 5.4 of Alam
    2018 finds only some of them.

    **Arguments:** the layers; and the cell of the surface where the drifter is dropped.
    **Returns:** a mask over the cells of all layers.

    Two layers of three cells: at the surface everything drifts East, below it West.
    A drifter that goes up and down reaches every cell:

        >>> from jaxcell import drift, examples
        >>> sea = examples.sea()
        >>> bool(drift.reachable_at_depth(sea, 1).all())
        True
    """
    moves = sea.drift.to_scipy() + sea.ascent + sea.descent
    begin = cell_mask(sea.drift.cells, _at_surface(sea, start), "start")
    return sea.at_any_phase(reaching(moves.T.tocsr(), begin))


def _at_surface(sea: Sea, start: int) -> int:
    surface = int(np.count_nonzero(sea.layer == 0))
    if not 0 <= start < surface:
        raise ValueError(
            f"start: cell {start} is not at the surface, which has cells 0 to {surface - 1}"
        )
    return start


@dataclasses.dataclass(frozen=True, eq=False)
class ReachedCells(Result):
    """The cells of all layers that a drifter from the start can reach, after any time."""

    sea: Sea
    constant_depth: Bool[np.ndarray, "cells"]
    "The mask of the cells that it reaches if it changes its layer only at the start."
    any_depth: Bool[np.ndarray, "cells"]
    "The mask of the cells that it reaches if it changes its layer at any time."

    @_flag("can ever be reached from the start, at constant depth")
    def reached(self) -> Bool[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(self.constant_depth, False)

    @_flag("can ever be reached from the start, by going up and down")
    def reached_at_any_depth(self) -> Bool[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(self.any_depth, False)

    @_count("in the long run: cells that can be reached, at constant depth")
    def reached_cells(self) -> Int[np.ndarray, "layers"]:
        return self.reached.sum(axis=(1, 2))

    @_count("in the long run: cells that can be reached, up and down too")
    def reached_cells_at_any_depth(self) -> Int[np.ndarray, "layers"]:
        return self.reached_at_any_depth.sum(axis=(1, 2))
