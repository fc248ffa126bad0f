import dataclasses
from typing import Any

import numpy as np
import scipy.ndimage
from jaxtyping import Array, Bool, Float, Int

from ...base.shown import Shown
from ..advection import carried
from ..drift_step import DriftStep
from ..flow import Flow, nearest_square
from ..water import Water


def ftle(
    water: Water,
    flow: Flow,
    duration: Float[Array, ""] | float | int,
    *,
    start: Float[Array, ""] | float | int = 0.0,
    method: str = "rk4",
    steps: int = 20,
) -> Float[Array | np.ndarray, "cells"]:
    """Compute the finite-time Lyapunov exponent, the rate at which water from a cell separates.

    It is `log(s) / |duration|`, where `s` is the largest factor by which the drift stretches a
    short line: the square root of the largest eigenvalue of the Cauchy-Green tensor (Haller 2015).
    The gradient of the drift is computed from the middles of the four sides of the cell, so that
    cells at a coast need no neighbour. Lengths are in metres, computed with the sides of the cells
    where the drift begins and ends.

    **Arguments:**

    - `water`: the cells.
    - `flow`: the flow of the same layer.
    - `duration`: the duration in seconds, negative to go backward in time. Ridges of the exponent
        repel the water if the duration is positive, and attract it otherwise.
    - `start`, `method`, `steps`: as for [`jaxcell.drift.advect`][]. The flow, the duration and the
        start may be traced by `jit`, `vmap` and `grad`.

    **Returns:** the exponents, per second.

    A flow along x whose speed grows by 0.01 cells per second from column to column stretches a line
    by a tenth in ten seconds, in one step of Euler's method:

        >>> import jax.numpy as jnp, numpy as np
        >>> from jaxcell import drift, examples
        >>> water = examples.water(np.ones((3, 5)))
        >>> along = jnp.tile(jnp.arange(-2.0, 3.0) / 100, (3, 1))
        >>> flow = drift.Flow(jnp.stack([along, jnp.zeros((3, 5))])[None], jnp.zeros(1))
        >>> exponent = drift.ftle(water, flow, 10.0, method="euler", steps=1)
        >>> exponent[1:4].round(6).tolist(), round(np.log(1.1).item() / 10, 6)
        ([0.009531, 0.009531, 0.009531], 0.009531)
    """
    duration = DriftStep(duration, method=method, substeps=steps).seconds(water, flow)
    sides = np.stack([water.dx, water.dy])
    right, up = np.array([[0.5, -0.5, 0.0, 0.0], [0.0, 0.0, 0.5, -0.5]])[:, :, None]
    begin = water.column + right, water.row + up
    ends: Any = carried(flow, *begin, duration, start, method, steps)
    xp = ends[0].__array_namespace__()
    east, west, north, south = xp.stack(ends, axis=1)
    row, column = nearest_square(sides.shape[1:], water.wraps, *(east + west) / 2)
    began, ended = water.sides, xp.asarray(sides)[:, row, column]
    a, c = (east - west) * ended / began[:1]
    b, d = (north - south) * ended / began[1:]
    # The singular values of the gradient of the drift, [[a, b], [c, d]], are half the sum and half
    # the difference of these two numbers.
    return xp.log((xp.hypot(a + d, b - c) + xp.hypot(a - d, b + c)) / 2) / abs(duration)


def ridges(
    water: Water, values: Float[np.ndarray, "cells"], *, share: float | int = 0.25
) -> Bool[np.ndarray, "cells"]:
    """Find the cells on a ridge of some values, such as [`ftle`][].

    A cell is on a ridge if its value is among the highest, and not below the values of the two
    neighbours across the ridge. Of four directions, the one along which the values curve downward
    most is across the ridge. Cells at a coast or the edge of the grid are on no ridge.

    **Arguments:**

    - `water`: the cells.
    - `values`: the value of each cell.
    - `share`: only this share of the cells, with the highest values, may be on a ridge.

    **Returns:** a mask over the cells.

    The middle column has the highest values; there is no ridge in the first and last row:

        >>> import numpy as np
        >>> from jaxcell import drift, examples
        >>> water = examples.water(np.ones((3, 5)))
        >>> drift.ridges(water, np.tile([0.0, 1.0, 2.0, 1.0, 0.0], 3)).nonzero()[0].tolist()
        [7]
    """
    if not 0 < share <= 1:
        raise ValueError(f"share: expected more than 0 and at most 1, got {share}")
    # West and East, South and North, and the two diagonals, by their rows in Water.neighbor.
    lines = ((3, 4), (1, 6), (0, 7), (2, 5))
    side = water.sides
    length = np.stack([side[0], side[1], np.hypot(*side), np.hypot(*side)])
    beside = np.where(water.neighbor >= 0, values[water.neighbor], np.nan)
    bend = np.stack([beside[a] + beside[b] - 2 * values for a, b in lines]) / length**2
    across = np.where(water.boundary, 0, bend).argmin(axis=0)
    first, second = np.array(lines)[across].T
    every = np.arange(water.cells)
    highest = np.maximum(beside[first, every], beside[second, every])
    crest = ~water.boundary & (bend[across, every] < 0) & (values >= highest)
    return crest & (values >= np.quantile(values, 1 - share))


@dataclasses.dataclass(frozen=True)
class Agreement(Shown):
    """The agreement of the borders of groups with ridges."""

    near: float
    "The share of the border cells that are near a ridge."
    expected: float
    "The share of all cells that are near a ridge; if borders were random, `near` would equal it."

    @property
    def ratio(self) -> float:
        """The ratio of `near` to `expected`."""
        return self.near / self.expected if self.expected else np.nan


def agreement(
    water: Water,
    label: Int[np.ndarray, "cells"],
    ridge: Bool[np.ndarray, "cells"],
    *,
    within: int = 1,
) -> Agreement:
    """Measure the agreement of the borders of groups with ridges.

    A border cell has a cell of another group beside it in its row or column.

    **Arguments:**

    - `water`: the cells.
    - `label`: the number of the group of each cell, such as `LongTermBehaviour.basin`.
    - `ridge`: the cells on ridges.
    - `within`: the largest distance, in rows and columns, at which a ridge counts as near.

    **Returns:** [`Agreement`][], two shares from 0 to 1.

    Groups with a border between columns 2 and 3, and a ridge in column 2:

        >>> import numpy as np
        >>> from jaxcell import drift, examples
        >>> water = examples.water(np.ones((3, 5)))
        >>> label, ridge = np.tile(np.int32([0, 0, 0, 1, 1]), 3), np.tile(np.arange(5) == 2, 3)
        >>> drift.agreement(water, label, ridge, within=0).near
        0.5
        >>> round(drift.agreement(water, label, ridge).ratio, 3)
        1.667
    """
    beside = water.neighbor[[1, 3, 4, 6]]
    border = ((beside >= 0) & (label[beside] != label)).any(axis=0)
    if not border.any():
        raise ValueError("label: expected two groups side by side or more, got no border")
    grid, beyond = water.on_grid(ridge, False), within if water.wraps else 0
    if within:  # scipy repeats 0 iterations until nothing changes
        grid = np.pad(grid, ((0, 0), (beyond, beyond)), mode="wrap")
        grid = scipy.ndimage.binary_dilation(grid, np.ones((3, 3), bool), iterations=within)
    near = grid[water.row, water.column + beyond]
    return Agreement(float(near[border].mean()), float(near.mean()))
