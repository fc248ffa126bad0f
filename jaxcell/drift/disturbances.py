"""Disturbance sets: the cells to which a drifter may come, and their probabilities (Eq. 5.4)."""

from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from ..currents.sphere import turned
from .water import NEIGHBORS, Water, square


# The index that stands for no target; -1 is the sink.
NONE = -2

# Cells of origin, and points or squares of each of them, one row per branch. JAX may trace them.
Origin: TypeAlias = Int[np.ndarray, "some"]
Points: TypeAlias = Float[Any, "_branches some"]
Squares: TypeAlias = Int[Any, "_branches some"]


def turned_ends(water: Water, x: Points, y: Points, origin: Origin) -> tuple[Points, Points]:
    """Turn the displacement of each drifter by 0, 45 and -45 degrees; return the end points."""
    dx, dy = water.sides[:, None, origin]
    column, row = np.stack([water.column, water.row])[:, None, origin].astype(float)
    right, up = turned((x - column) * dx, (y - row) * dy, np.radians([[0], [45], [-45]]))
    return column + right / dx, row + up / dy


def around(water: Water, x: Points, y: Points, *, exits: bool) -> Squares:
    """Find the image of each cell and its neighbours: off the map -1 if `exits`, else `NONE`."""
    image = water.landing(x, y, exits=exits)
    row, column = squares_around(water, image, x, y)
    cell, land = water.at(row[1:], column[1:])
    other = (cell < 0) | (water.piece[cell] != water.piece)
    on, off = (cell >= 0) | (land & (water.coast != "strand")), -1 if exits else NONE
    return np.concatenate([image, np.where(on, np.where(other, NONE, cell), off)])


def squares_around(water: Water, image: Squares, x: Points, y: Points) -> tuple[Squares, Squares]:
    """Return the rows and columns of each image and its eight neighbours, on and off the map."""
    row, column = square(x, y)
    row = np.where(image >= 0, water.row[image], row)
    column = np.where(image >= 0, water.column[image], column)
    up, right = np.array([(0, 0), *NEIGHBORS]).T[:, :, None]
    return row + up, column + right


def set_probabilities(targets: Squares, rho: float) -> Points:
    """Compute Eq. 5.4 for `targets`: row 0 has the images, repeated cells have probability 0."""
    xp = targets.__array_namespace__()
    new = [(targets[k : k + 1] != targets[:k]).all(axis=0) for k in range(1, len(targets))]
    counts = xp.stack(new) & (targets[1:] != NONE)
    others = counts.sum(axis=0, dtype=float, keepdims=True)
    share = xp.where(counts, (1 - rho) / xp.maximum(others, 1), 0.0)
    return xp.concatenate([xp.where(others > 0, rho, 1.0), share])


def with_uniform_boundary(
    water: Water, image: Squares, probability: Points
) -> tuple[Squares, Points]:
    """Map each cell at a coast or an edge to its neighbours and itself with equal probability."""
    cells = np.flatnonzero(water.boundary)
    # Existing neighbours come first, in their order.
    near = water.neighbor[:, cells]
    near = np.vstack([cells, np.sort(np.where(near < 0, water.cells, near), axis=0)])
    exists = near < water.cells
    slots = max(len(image), exists.sum(axis=0).max(initial=0))
    to, share = np.full((slots, water.cells), NONE, np.int32), np.zeros((slots, water.cells))
    to[: len(near), cells] = np.where(exists, near, NONE)[:slots]
    share[: len(near), cells] = (exists / exists.sum(axis=0))[:slots]
    xp, more = image.__array_namespace__(), ((0, slots - len(image)), (0, 0))
    image = xp.where(water.boundary[None], to, xp.pad(image, more, constant_values=NONE))
    return image, xp.where(water.boundary[None], share, xp.pad(probability, more))
