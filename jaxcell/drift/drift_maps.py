from collections.abc import Iterator, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from ..base import memory
from ..base.precision import require_x64
from ..mapping import Chain
from .flow import Flow, advect, checked_duration
from .water import NEIGHBORS, Water, square


SPREADS = ("turned", "all", "sampled")
EDGES = ("uniform", "exit")
METHODS: Mapping[str, Mapping[str, Any]] = {
    "drifters": {"spread": "sampled", "edge": "exit", "method": "rk4", "steps": 4},
    "source": {"spread": "turned", "edge": "uniform", "method": "euler", "steps": 1},
}
"""Arguments of a drift map: what agrees best with drifters in the current, and the rules of Alam
2018, section 5.4.3, where the grid spreads drifters more than the water does and no edge is open.
"""

# Stands for no cell at all, where -1 stands for the sink.
_NONE = -2


def drift_map(
    water: Water,
    flow: Flow,
    duration: float | int | None = None,
    *,
    rho: float | int = 0.8,
    spread: str = "turned",
    samples: int = 5,
    edge: str = "uniform",
    start: float | int = 0.0,
    method: str = "euler",
    steps: int = 1,
) -> Chain:
    """The generalized map of a drifter (Alam 2018, section 5.4.3 and lines 2 to 8 of Alg. 5.1).

    The *image* of a cell is where the flow takes its centre, [`Water.landing`][]. Disturbances may
    bring the drifter to other cells; with the image they are the set `A(z)`. The image has
    probability `rho`, and each other cell of the set `(1 - rho) / (|A(z)| - 1)`. It is a set:
    cells that are reached in several ways count once, and an image that is alone has probability 1.

    **Arguments:**

    - `water`: the cells.
    - `flow`: the flow of the same layer.
    - `duration`: of one step of the map, in seconds; by default
        [`jaxcell.drift.crossing_time`][].
    - `rho`: the probability of the image, from 0 to 1.
    - `spread`: the disturbances. `"turned"`: the drift, turned by 45 degrees to either side.
        `"all"`: the eight neighbours of the image; then connected water tends to be one persistent
        group. `"sampled"`: none; instead of the centre, `samples` x `samples` points of the cell
        drift, and the probability of a cell is the share of them that end there (Hsu 1987), so
        that `rho` does not matter.
    - `samples`: see `spread`.
    - `edge`: `"uniform"`, the rule of the source: cells with fewer than eight neighbours are mapped
        to those and to themselves, all with one probability, and nothing ever leaves the grid.
        `"exit"`: they drift as the others do, and what ends off the grid goes to the sink (it is
        one element of `A(z)`).
    - `start`, `method`, `steps`: as for [`jaxcell.drift.advect`][].

    **Returns:** [`jaxcell.mapping.Chain`][].

    **Raises:** `ValueError` for a probability or a number out of range, an unknown choice, or as
    [`jaxcell.drift.flow_map`][]; `RuntimeError` where JAX is set to 32 bits; `MemoryError` where
    the map would not fit the free memory.

    The surface of the bundled sea; most cells have an image and two disturbances:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> water, flow = drift.Water.of(currents), drift.Flow.of(currents)
        >>> chain = drift.drift_map(water, flow)
        >>> matrix = chain.to_scipy()
        >>> matrix.shape, round(float(matrix.max()), 2), round(float(matrix.sum(axis=1).min()), 6)
        ((538, 538), 0.8, 1.0)
    """
    require_x64("drift_map")
    _check(rho, spread, samples, edge)
    branches = {"turned": 3, "all": 9, "sampled": min(9, samples**2)}[spread]
    memory.check(
        40 * (branches + 1) * water.cells,
        f"a drift map of {water.cells:,} cells of water",
        "read less of the currents",
    )
    duration = checked_duration(flow, water, duration, method, steps)

    def ends(right: float, up: float) -> tuple[np.ndarray, np.ndarray]:
        """Where points of all cells drift, which are off the centres by some parts of a cell."""
        x, y = jnp.asarray(water.column + right), jnp.asarray(water.row + up)
        found = advect(flow, x, y, duration, start=float(start), method=method, steps=steps)
        return np.asarray(found[0]), np.asarray(found[1])

    exits = edge == "exit"
    if spread == "sampled":
        places = ((np.arange(samples) + 0.5) / samples - 0.5).tolist()
        landed = (
            water.landing(*(v[None] for v in ends(right, up)), exits=exits)[0]
            for up in places
            for right in places
        )
        image, probability = _shares(landed, samples**2, water.cells)
    else:
        x, y = ends(0.0, 0.0)
        if spread == "turned":
            targets = water.landing(*_turned(water, x, y), exits=exits)
        else:
            targets = _around(water, x, y, exits=exits)
        image, probability = targets, _set_probabilities(targets, float(rho))
    if not exits:
        image, probability = _with_uniform_boundary(water, image, probability)
    # What goes to the sink is what is missing.
    gone = image < 0
    image = np.where(gone, np.arange(water.cells), image)
    return Chain(image.astype(np.int32), np.where(gone, 0.0, probability))


def periodic_drift_map(
    water: Water,
    flow: Flow,
    period: float | int | None = None,
    *,
    rho: float | int = 0.8,
    spread: str = "turned",
    samples: int = 5,
    edge: str = "uniform",
    method: str = "euler",
    steps: int = 1,
) -> Chain:
    """The map over a whole period of a flow that repeats itself, such as a day.

    It is the product of the maps from record to record, the last of which leads back to the first.
    The matrix fills up with every factor, so this is for some 10^4 cells and some tens of records.

    **Arguments:**

    - `water`, `flow`: as for [`drift_map`][], with two records or more.
    - `period`: in seconds; by default, as if one more record followed the last at the same
        distance as the last two.
    - `rho`, `spread`, `samples`, `edge`, `method`, `steps`: as for [`drift_map`][], from each
        record to the next.

    **Returns:** [`jaxcell.mapping.Chain`][]; one step is one period.

    **Raises:** `ValueError` for a flow with one record, a period that ends before the last, or as
    [`drift_map`][].

    The first two hours of the bundled sea, again and again:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=(0, 1), depths=0)
        >>> water, flow = drift.Water.of(currents), drift.Flow.of(currents)
        >>> chain = drift.periodic_drift_map(water, flow)
        >>> chain.cells == water.cells, round(float(chain.to_scipy().sum(axis=1).min()), 6)
        (True, 1.0)
    """
    time = np.asarray(flow.time)
    if time.size < 2:
        raise ValueError("flow: expected two records or more, got 1; use drift_map for steady flow")
    length = float(2 * time[-1] - time[-2] - time[0] if period is None else period)
    if not (np.isfinite(length) and length > time[-1] - time[0]):
        raise ValueError(
            f"period: expected more than the {time[-1] - time[0]:g} s from the first record to the "
            f"last, got {length:g} s"
        )
    around = Flow(
        jnp.concatenate([flow.rate, flow.rate[:1]]),
        jnp.append(flow.time, flow.time[0] + length),
        flow.wraps,
    )
    product = scipy.sparse.eye_array(water.cells, format="csr")
    for now, then in zip(around.time[:-1].tolist(), around.time[1:].tolist(), strict=True):
        chain = drift_map(
            water,
            around,
            then - now,
            rho=rho,
            spread=spread,
            samples=samples,
            edge=edge,
            start=now,
            method=method,
            steps=steps,
        )
        product = product @ chain.to_scipy()
    return Chain.from_scipy(product)


def _check(rho: float | int, spread: str, samples: int, edge: str) -> None:
    if not 0 <= rho <= 1:
        raise ValueError(f"rho: expected a probability from 0 to 1, got {rho}")
    if spread not in SPREADS:
        raise ValueError(f"spread: expected 'turned', 'all' or 'sampled', got {spread!r}")
    if samples < 1:
        raise ValueError(f"samples: expected 1 or more, got {samples}")
    if edge not in EDGES:
        raise ValueError(f"edge: expected 'uniform' or 'exit', got {edge!r}")


def _turned(
    water: Water, x: Float[np.ndarray, "cells"], y: Float[np.ndarray, "cells"]
) -> tuple[Float[np.ndarray, "3 cells"], Float[np.ndarray, "3 cells"]]:
    """The end points of drifts that are turned by 0, 45 and -45 degrees."""
    dx, dy = (side[water.row, water.column] for side in (water.dx, water.dy))
    right, up = (x - water.column) * dx, (y - water.row) * dy
    angle = np.radians([[0], [45], [-45]])
    cos, sin = np.cos(angle), np.sin(angle)
    return (
        water.column + (right * cos - up * sin) / dx,
        water.row + (right * sin + up * cos) / dy,
    )


def _around(
    water: Water, x: Float[np.ndarray, "cells"], y: Float[np.ndarray, "cells"], *, exits: bool
) -> Int[np.ndarray, "9 cells"]:
    """The image of each cell and what is around it, the sink included where there is an exit."""
    image = water.landing(x[None], y[None], exits=exits)
    # An image that is off the grid has cells around it too.
    row, column = square(x, y)
    row = np.where(image[0] >= 0, water.row[image[0]], row)
    column = np.where(image[0] >= 0, water.column[image[0]], column)
    around = []
    for up, right in NEIGHBORS:
        cell, inside = water.at(row + up, column + right)
        other = (cell < 0) | (water.piece[cell] != water.piece)
        around.append(np.where(inside, np.where(other, _NONE, cell), -1 if exits else _NONE))
    return np.concatenate([image, np.stack(around)])


def _set_probabilities(
    targets: Int[np.ndarray, "branches cells"], rho: float
) -> Float[np.ndarray, "branches cells"]:
    """The probabilities of sets of cells whose first is the image; 0 for what is there already."""
    counts = np.ones(targets.shape, bool)
    for branch in range(1, len(targets)):
        counts[branch] = (targets[branch] != _NONE) & (targets[branch] != targets[:branch]).all(
            axis=0
        )
    others = counts[1:].sum(axis=0)
    probability = np.where(counts, (1 - rho) / np.maximum(others, 1), 0)
    probability[0] = np.where(others > 0, rho, 1)
    return probability


def _shares(
    landed: Iterator[Int[np.ndarray, "cells"]], samples: int, cells: int
) -> tuple[Int[np.ndarray, "branches cells"], Float[np.ndarray, "branches cells"]]:
    """The cells in which samples landed and the shares of them, in as many slots as needed."""
    image = np.full((1, cells), _NONE)
    count = np.zeros((1, cells), np.int64)
    every = np.arange(cells)
    for target in landed:
        # The slot of this target, or the first that is empty.
        fits = (image == target) | (image == _NONE)
        if not fits.any(axis=0).all():
            image = np.pad(image, ((0, 1), (0, 0)), constant_values=_NONE)
            count = np.pad(count, ((0, 1), (0, 0)))
            fits = np.pad(fits, ((0, 1), (0, 0)), constant_values=True)
        slot = fits.argmax(axis=0)
        image[slot, every] = target
        count[slot, every] += 1
    return image, count / samples


def _with_uniform_boundary(
    water: Water,
    image: Int[np.ndarray, "branches cells"],
    probability: Float[np.ndarray, "branches cells"],
) -> tuple[Int[np.ndarray, "slots cells"], Float[np.ndarray, "slots cells"]]:
    """The map with cells at a coast or an edge mapped to all around them and themselves."""
    cells = np.flatnonzero(water.boundary)
    slots = max(len(image), 1 + int((water.neighbor[:, cells] >= 0).sum(axis=0).max(initial=0)))
    more = ((0, slots - len(image)), (0, 0))
    image = np.pad(image, more, constant_values=_NONE)
    probability = np.pad(probability, more)
    near = water.neighbor[:, cells]
    # Those that exist come first, in their order.
    near = np.sort(np.where(near < 0, np.iinfo(np.int32).max, near), axis=0)
    near = np.concatenate([cells[None], near])[:slots]
    exists = near < water.cells
    image[:, cells] = _NONE
    probability[:, cells] = 0
    image[: len(near), cells] = np.where(exists, near, _NONE)
    probability[: len(near), cells] = exists / exists.sum(axis=0)
    return image, probability
