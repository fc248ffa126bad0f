"""Numbers about basins: stability, shocks, entropy and uncertainty."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ..space.box import Box
from .basin import Basins


def basin_stability(
    found: Basins, weight: Callable[[np.ndarray], np.ndarray] | None = None
) -> Float[np.ndarray, "attractors"]:
    """The share of starts that lead to each attractor, by a density of starts.

    **Arguments:**

    - `found`: the basins.
    - `weight`: the density at points `[cells, axes]`, not necessarily normalised; by default all
        cells weigh the same.

    **Returns:** the shares, which sum to less than 1 where starts leave the box.

    Cells to the right of the middle stay, the others go to the left end:

        >>> import jax.numpy as jnp
        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [1], cells=[8])
        >>> found = dynamics.basins(lambda x, p: jnp.where(x > 0.5, 0.6, 0.1), box)
        >>> dynamics.basin_stability(found, lambda x: x[:, 0] > 0.25).round(3).tolist()
        [0.333, 0.667]
    """
    if weight is None:
        return found.fraction
    mass = np.asarray(weight(found.box.centre(np.arange(found.box.size, dtype=np.int32))))
    total = np.bincount(found.basin + 1, mass, minlength=found.attractors + 1)
    return total[1:] / mass.sum()


def minimal_critical_shock(found: Basins) -> Float[np.ndarray, "attractors"]:
    """The shortest way from a cell of each attractor to a cell of another basin, or out of all.

    By an exact Euclidean distance transform between centres, so right to a cell; what is beyond the
    ends of axes counts only where they are periodic. `inf` where all of the box is one basin.

    **Returns:** the length for each attractor, in the units of the box.

    **Arguments:**

    - `found`: the basins.

    Cells to the right of the middle stay, the others go to the left end:

        >>> import jax.numpy as jnp
        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [1], cells=[8])
        >>> found = dynamics.basins(lambda x, p: jnp.where(x > 0.5, 0.6, 0.1), box)
        >>> dynamics.minimal_critical_shock(found).round(3).tolist()
        [0.5, 0.125]
    """
    shocks = np.full(found.attractors, np.inf)
    for k, cells in enumerate(found.attractor_cells):
        own = found.basin == k
        if not own.all() and cells.size:
            shocks[k] = _distance(found.box, own)[cells].min()
    return shocks


def _distance(box: Box, own: np.ndarray) -> Float[np.ndarray, "cells"]:
    """From each cell to the nearest that is not among them."""
    grid = own.reshape(box.cells)
    pad = [
        (n, n) if kind == "periodic" else (0, 0)
        for n, kind in zip(box.cells, box.axes, strict=True)
    ]
    wide = np.pad(grid, pad, mode="wrap")
    far = ndimage.distance_transform_edt(wide, sampling=box.width)
    middle = tuple(slice(low, low + n) for (low, _), n in zip(pad, box.cells, strict=True))
    return far[middle].ravel()


def basin_entropy(found: Basins, side: int) -> tuple[float, float]:
    """The entropy of the basins in boxes of cells, in nats, and that of boxes on a boundary.

    **Arguments:**

    - `found`: the basins.
    - `side`: cells along each side of a box; what is left over at the ends is not used.

    **Returns:** `S_b`, over all boxes, and `S_bb`, over those with more than one basin (Daza et al.
    2016). `S_bb > log 2` proves a fractal boundary; a boundary without basins has 0 for both.

    Cells to the right of the middle stay, the others go to the left end:

        >>> import jax.numpy as jnp
        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [1], cells=[8])
        >>> found = dynamics.basins(lambda x, p: jnp.where(x > 0.5, 0.6, 0.1), box)
        >>> dynamics.basin_entropy(found, side=2)
        (0.0, 0.0)
    """
    labels = found.basin.reshape(found.box.cells)
    whole = tuple(slice(0, n // side * side) for n in labels.shape)
    blocks = labels[whole]
    split = [part for n in blocks.shape for part in (n // side, side)]
    order = (*range(0, 2 * blocks.ndim, 2), *range(1, 2 * blocks.ndim, 2))
    boxes = blocks.reshape(split).transpose(order).reshape(-1, side**blocks.ndim)
    entropy = np.zeros(len(boxes))
    for label in np.unique(boxes):
        share = (boxes == label).mean(axis=1)
        entropy -= np.where(share > 0, share * np.log(np.where(share > 0, share, 1)), 0)
    mixed = entropy > 0
    return float(entropy.mean()), float(entropy[mixed].mean()) if mixed.any() else 0.0


def uncertainty_exponent(
    found: Basins, radii: tuple[int, ...] = (1, 2, 3, 5, 8, 13)
) -> tuple[float, Float[np.ndarray, "radii"]]:
    """How the share of cells with another basin within a radius grows with it.

    **Arguments:**

    - `found`: the basins.
    - `radii`: in cells, along any axis.

    **Returns:** the exponent, the slope of logarithms: 1 for a smooth boundary of a plane, 0 for
    one that fills it (Grebogi et al. 1983); and the share of uncertain cells by radius.

    Cells to the right of the middle stay, the others go to the left end:

        >>> import jax.numpy as jnp
        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [1], cells=[8])
        >>> found = dynamics.basins(lambda x, p: jnp.where(x > 0.5, 0.6, 0.1), box)
        >>> dynamics.uncertainty_exponent(found, (1, 2))[1].tolist()
        [0.25, 0.5]
    """
    labels = found.basin.reshape(found.box.cells)
    modes = ["wrap" if kind == "periodic" else "nearest" for kind in found.box.axes]
    share = []
    for radius in radii:
        size = 2 * radius + 1
        high = ndimage.maximum_filter(labels, size, mode=modes)
        low = ndimage.minimum_filter(labels, size, mode=modes)
        share.append(np.mean(high != low))
    uncertain = np.array(share)
    seen = uncertain > 0
    if np.count_nonzero(seen) < 2:
        return float("nan"), uncertain
    slope = np.polyfit(np.log(np.array(radii)[seen]), np.log(uncertain[seen]), 1)[0]
    return float(slope), uncertain


def overlap(one: Basins, other: Basins) -> Float[np.ndarray, "attractors others"]:
    """The share of each basin that lies in each basin of other parameters of the same box.

    **Raises:** `ValueError` if the boxes differ.

    **Returns:** an array over the attractors of both.

    **Arguments:**

    - `one`, `other`: the basins.

    Cells to the right of the middle stay, the others go to the left end:

        >>> import jax.numpy as jnp
        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [1], cells=[8])
        >>> found = dynamics.basins(lambda x, p: jnp.where(x > 0.5, 0.6, 0.1), box)
        >>> dynamics.overlap(found, found).tolist()
        [[1.0, 0.0], [0.0, 1.0]]
    """
    if one.box != other.box:
        raise ValueError("overlap: expected basins in the same box")
    both = np.zeros((one.attractors + 1, other.attractors + 1))
    np.add.at(both, (one.basin, other.basin), 1.0)
    own = both.sum(axis=1, keepdims=True)
    return (both / np.maximum(own, 1))[:-1, :-1]
