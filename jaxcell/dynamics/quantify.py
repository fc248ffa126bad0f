"""Measures of basins: stability, distances to the boundary, entropy, uncertainty exponents."""

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy import ndimage, special

from ..space.box import Box
from .basin import Basins


def basin_stability(
    basins: Basins,
    weight: Callable[[np.ndarray], np.ndarray] | None = None,
    *,
    within: float = math.inf,
) -> Float[np.ndarray, "attractors"]:
    """Compute the share of starts that lead to each attractor, with starts weighted by a density.

    **Arguments:** basins; a function that computes the density at points `[cells, axes]`, up to a
    factor (by default all starts are equally likely); and the time within which starts must reach
    their attractor, in mappings if a mapping has no duration. Basins by cells have the time to a
    group of cells, which may be earlier: take basins by orbits.

    **Returns:** shares, which sum to less than 1 if starts leave the box.

    Cells to the right of the middle stay, and other cells go to the left end:

        >>> from jaxcell import dynamics, examples
        >>> dynamics.basin_stability(examples.basins(), lambda x: x[:, 0] > 0.25).round(3).tolist()
        [0.333, 0.667]
    """
    mass = np.ones(basins.box.size)
    if weight is not None:
        mass = np.asarray(weight(basins.box.centre(np.arange(basins.box.size, dtype=np.int32))))
    come = np.where(basins.times <= within, basins.basin, -1)
    return np.bincount(come + 1, mass, minlength=basins.attractors + 1)[1:] / mass.sum()


def minimal_critical_shock(basins: Basins) -> Float[np.ndarray, "attractors"]:
    """Compute the least distance from a cell of each attractor to a cell outside of its basin.

    **Arguments:** basins. **Returns:** the distance for each attractor.

    An exact Euclidean distance transform between centres is used, so the result is accurate to
    within one cell. Cells beyond the ends of an axis count only if the axis is periodic. The
    distance is `inf` if all cells are in one basin.

        >>> from jaxcell import dynamics, examples
        >>> dynamics.minimal_critical_shock(examples.basins()).round(3).tolist()
        [0.5, 0.125]
    """
    shocks = np.full(basins.attractors, np.inf)
    for k, cells in enumerate(basins.attractor_cells):
        own = basins.basin == k
        if not own.all() and cells.size:
            shocks[k] = _distance_to_others(basins.box, own)[cells].min()
    return shocks


def _distance_to_others(box: Box, own: np.ndarray) -> Float[np.ndarray, "cells"]:
    grid = own.reshape(box.cells)
    pad = [
        (n, n) if kind == "periodic" else (0, 0)
        for n, kind in zip(box.cells, box.axes, strict=True)
    ]
    wide = np.pad(grid, pad, mode="wrap")
    far = ndimage.distance_transform_edt(wide, sampling=box.width)
    middle = tuple(slice(low, low + n) for (low, _), n in zip(pad, box.cells, strict=True))
    return far[middle].ravel()


def basin_entropy(basins: Basins, side: int) -> tuple[float, float]:
    """Compute the mean entropy, in nats, of the shares of basins in boxes of cells.

    **Arguments:** basins, and the number of cells along the side of a box. Cells that are left over
    at the ends of the axes are not used. **Returns:** the mean `S_b` over all boxes, and the mean
    `S_bb` over boxes with more than one basin (Daza et al. 2016). `S_bb > log 2` proves a fractal
    boundary. Without a boundary both are 0.

        >>> from jaxcell import dynamics, examples
        >>> dynamics.basin_entropy(examples.basins(), side=2)
        (0.0, 0.0)
    """
    labels = basins.basin.reshape(basins.box.cells)
    whole = tuple(slice(0, n // side * side) for n in labels.shape)
    blocks = labels[whole]
    split = [part for n in blocks.shape for part in (n // side, side)]
    order = (*range(0, 2 * blocks.ndim, 2), *range(1, 2 * blocks.ndim, 2))
    boxes = blocks.reshape(split).transpose(order).reshape(-1, side**blocks.ndim)
    shares = ((boxes == label).mean(axis=1) for label in np.unique(boxes))
    entropy = sum(map(special.entr, shares), np.zeros(len(boxes)))
    mixed = entropy > 0
    return float(entropy.mean()), float(entropy[mixed].mean()) if mixed.any() else 0.0


def uncertainty_exponent(
    basins: Basins, radii: tuple[int, ...] = (1, 2, 3, 5, 8, 13)
) -> tuple[float, Float[np.ndarray, "radii"]]:
    """Fit a power law to the share of cells within a radius of another basin, over several radii.

    **Arguments:** basins, and radii in cells along each axis. **Returns:** the exponent, which is 1
    for a smooth boundary and 0 for a boundary that fills the box (Grebogi et al. 1983), and the
    share for each radius.

        >>> from jaxcell import dynamics, examples
        >>> dynamics.uncertainty_exponent(examples.basins(), (1, 2))[1].tolist()
        [0.25, 0.5]
    """
    labels = basins.basin.reshape(basins.box.cells)
    uncertain = np.array([_mixed(basins.box, labels, radius).mean() for radius in radii])
    seen = uncertain > 0
    if np.count_nonzero(seen) < 2:
        return float("nan"), uncertain
    slope = np.polyfit(np.log(np.array(radii)[seen]), np.log(uncertain[seen]), 1)[0]
    return float(slope), uncertain


def wada(basins: Basins, radius: float = 3.0) -> float:
    """Return the largest share of a basin's boundary that is far from another's; 0 for Wada basins.

    Each basin has a boundary with the union of all others; for Wada basins these boundaries are the
    same (Daza et al. 2018). Cells that lead to no attractor count as a basin.

    **Arguments:** basins, and the distance in cells within which boundaries count as the same.
    **Returns:** the share of the cells of one boundary that are farther than this distance from
    another boundary, for the pair of boundaries with the largest share.

    Three stripes, of which only the middle one has a boundary with both others:

        >>> import jax.numpy as jnp
        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [3], cells=[30])
        >>> basins = dynamics.basins(lambda x, p: jnp.floor(x) + 0.5, box)
        >>> dynamics.wada(basins)
        1.0
    """
    labels = basins.basin.reshape(basins.box.cells)
    names = np.unique(labels)
    if names.size < 3:
        raise ValueError(f"wada: expected at least 3 basins, got {names.size}")
    edges = [_mixed(basins.box, (labels == name).astype(np.int8), 1) for name in names]
    far = [ndimage.distance_transform_edt(~edge) > radius for edge in edges]
    return max(float(np.mean(beyond[edge])) for edge in edges for beyond in far)


def _mixed(box: Box, labels: np.ndarray, radius: int) -> np.ndarray:
    """Return a mask of the cells that are within `radius` cells of a cell with another label."""
    modes = ["wrap" if kind == "periodic" else "nearest" for kind in box.axes]
    high = ndimage.maximum_filter(labels, 2 * radius + 1, mode=modes)
    return high != ndimage.minimum_filter(labels, 2 * radius + 1, mode=modes)


def overlap(one: Basins, other: Basins) -> Float[np.ndarray, "attractors others"]:
    """Compute the share of each basin that lies in each basin of another map of the same box.

    **Arguments:** basins of two maps in one box. **Returns:** a share for each pair of basins.

        >>> from jaxcell import dynamics, examples
        >>> basins = examples.basins()
        >>> dynamics.overlap(basins, basins).tolist()
        [[1.0, 0.0], [0.0, 1.0]]
    """
    if one.box != other.box:
        raise ValueError("overlap: expected basins in the same box")
    both = np.zeros((one.attractors + 1, other.attractors + 1))
    np.add.at(both, (one.basin, other.basin), 1.0)
    own = both.sum(axis=1, keepdims=True)
    return (both / np.maximum(own, 1))[:-1, :-1]
