"""Drifters that strand at a coast, and come afloat again."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from ..mapping import Chain
from .water import NEIGHBORS, Water


def coast(water: Water) -> Bool[np.ndarray, "cells"]:
    """Give the cells at a coast: those beside land, but not those at the edge of the grid alone.

    **Arguments:**

    - `water`: the cells of a layer.

    **Returns:** whether each is at a coast.

    A sea of two cells with land at one end:

        >>> import numpy as np
        >>> from jaxcell import drift
        >>> number, side = np.int32([[-1, 0, 1]]), np.full((1, 3), 1000.0)
        >>> water = drift.Water(number, side, side, 0 * side, 0 * side, 0 * side, 0.0)
        >>> drift.coast(water).tolist()
        [True, False]
    """
    around = (water.at(water.row + up, water.column + right) for up, right in NEIGHBORS)
    return np.any([(cell < 0) & inside for cell, inside in around], axis=0)


def beaching(
    chain: Chain,
    at_coast: Bool[np.ndarray, "cells"],
    duration: float | int,
    *,
    afloat: float | int,
    stranded: float | int = np.inf,
) -> tuple[Chain, Int[np.ndarray, "coast"]]:
    """Give the map of drifters that may strand at a coast.

    Each cell at a coast has a beach, which is one more state. In a step, a drifter in the cell
    strands with probability `1 - 2^(-duration / afloat)`, and else drifts on; one on the beach is
    back in the cell with `1 - 2^(-duration / stranded)`.

    **Arguments:**

    - `chain`: the map of a layer, as from [`jaxcell.drift.drift_map`][].
    - `at_coast`: the cells with a beach, as from [`coast`][].
    - `duration`: of a step, in seconds.
    - `afloat`: the time in seconds in which half of the drifters in a cell at a coast strand.
    - `stranded`: the time in which half of those on a beach are afloat again; infinite by default,
        so that beaches are persistent groups.

    **Returns:** the map, over the cells and after them the beaches; and the cell of each beach.

    **Raises:** `ValueError` for times that are not positive, or a mask of other cells.

    In still water, half strand in an hour:

        >>> import numpy as np
        >>> from jaxcell import drift, mapping
        >>> still = mapping.Chain.from_scipy(np.eye(2))
        >>> chain, cell = drift.beaching(still, np.array([True, False]), 3600, afloat=3600)
        >>> chain.to_scipy().toarray().tolist(), cell.tolist()
        ([[0.5, 0.0, 0.5], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0])
    """
    for name, value in (("duration", duration), ("afloat", afloat), ("stranded", stranded)):
        if not value > 0:
            raise ValueError(f"{name}: expected more than 0 seconds, got {value}")
    if at_coast.shape != (chain.cells,):
        raise ValueError(f"at_coast: expected {chain.cells} cells, got {at_coast.shape}")
    cell = np.flatnonzero(at_coast).astype(np.int32)
    beach = chain.cells + np.arange(cell.size, dtype=np.int32)
    strands, floats = (-np.expm1(-np.log(2) * duration / half) for half in (afloat, stranded))
    image, probability = (
        np.pad(np.asarray(one), ((0, 1), (0, cell.size)))
        for one in (chain.image, chain.probability)
    )
    probability[:, cell] *= 1 - strands
    image[-1], image[-1, cell], probability[-1, cell] = np.arange(image.shape[1]), beach, strands
    image[:, beach], probability[:, beach] = beach, 0
    image[0, beach], probability[0, beach], probability[-1, beach] = cell, floats, 1 - floats
    return Chain(jnp.asarray(image), jnp.asarray(probability)), cell
