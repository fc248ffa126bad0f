import functools
import math
import operator
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import scipy.sparse
import scipy.special
from jaxtyping import Float, Int

from ..base import memory
from ..base.precision import require_x64
from ..mapping import Chain, ChainSequence
from ..mapping.generalized import slots_of
from .advection import carried, checked_duration
from .flow import Flow, steps_in
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

# Diffusion reaches so many standard deviations, which are not more than so many cells.
_TAILS, _MAX_SPREAD = 3.5, 10
# So many points drift at once, or those of a row of samples where they are more.
_POINTS = 65_536
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
        that `rho` does not matter. Where the flow has a diffusivity they are spread by it at the
        end of the step, which needs this choice.
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

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> chain = drift.drift_map(water, flow)
        >>> matrix = chain.to_scipy()
        >>> matrix.shape, round(float(matrix.max()), 2), round(float(matrix.sum(axis=1).min()), 6)
        ((538, 538), 0.8, 1.0)
    """
    require_x64("drift_map")
    _check(rho, spread, samples, edge)
    duration = checked_duration(flow, water, duration, method, steps)
    if flow.diffusivity and spread != "sampled":
        raise ValueError(f"diffusivity: expected spread 'sampled' with it, got {spread!r}")
    far = diffused_cells(water, flow, duration)
    if (widest := float(far.max())) > _MAX_SPREAD:
        raise ValueError(
            f"diffusivity: {flow.diffusivity:g} m²/s spreads drifters over {widest:.3g} cells in "
            f"a step of {duration:g} s; expected {_MAX_SPREAD:g} at most"
        )
    branches = {"turned": 3, "all": 9, "sampled": min(9, samples**2)}[spread]
    if flow.diffusivity:
        branches = (2 * math.ceil(_TAILS * widest) + 3) ** 2
    memory.check(
        (40 * (branches + 1) + 100 * samples) * water.cells,
        f"a drift map of {water.cells:,} cells of water",
        "read less of the currents",
    )

    def ends(right: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where points of all cells drift, which are off the centres by some parts of a cell."""
        x, y = water.column + right[:, None], water.row + up[:, None]
        return carried(flow, x, y, duration, start, method, steps)

    exits = edge == "exit"
    if spread == "sampled":
        places = (np.arange(samples) + 0.5) / samples - 0.5
        right, up = (one.ravel() for one in np.meshgrid(places, places))
        some = max(samples, _POINTS // water.cells)
        drifted = (ends(right[k : k + some], up[k : k + some]) for k in range(0, up.size, some))
        if flow.diffusivity:
            points = (point for x, y in drifted for point in zip(x, y, strict=True))
            spreads = (_diffused(water, x, y, far, exits) for x, y in points)
            image, probability = slots_of(functools.reduce(operator.add, spreads) / samples**2)
        else:
            landed = (one for x, y in drifted for one in water.landing(x, y, exits=exits))
            image, probability = _shares(landed, samples**2, water.cells)
    else:
        x, y = (place[0] for place in ends(np.zeros(1), np.zeros(1)))
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


def drift_maps(
    water: Water, flow: Flow, duration: float | int, **options: Any
) -> Chain | ChainSequence:
    """The maps of a flow that repeats itself, one after the other over its period.

    **Arguments:**

    - `water`, `flow`: as for [`drift_map`][]; the flow as from [`Flow.repeated`][].
    - `duration`: of one step, in seconds, such that whole steps make up a period, or whole periods
        a step: as from [`Flow.fitted`][].
    - `options`: further ones of [`drift_map`][]. Steps of the method are doubled until there are as
        many as records.

    **Returns:** [`jaxcell.mapping.ChainSequence`][]; of a flow that does not repeat, or if one
    step is whole periods, the one [`jaxcell.mapping.Chain`][].

    **Raises:** `ValueError` for a duration that does not fit, or as [`drift_map`][].

    Five hours of the bundled sea, again and again:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=(0, 4), depths=0)
        >>> water, flow = drift.Water.of(currents), drift.Flow.of(currents).repeated()
        >>> tide = drift.drift_maps(water, flow, 9000.0, **drift.METHODS["drifters"])
        >>> tide.shape
        (2, 538)
    """
    if flow.period is None:
        return drift_map(water, flow, duration, **options)
    if not np.isclose(flow.fitted(duration), duration, rtol=1e-9):
        raise ValueError(
            f"duration: expected a whole part or multiple of the period, {float(flow.period):g} s, "
            f"such as {flow.fitted(duration):g} s, got {duration:g} s"
        )
    records = duration / float(np.diff(np.asarray(flow.time)).min())
    given = options.get("steps", 1)
    # Few different numbers, so that few programs are compiled.
    steps = given * 2 ** max(0, math.ceil(math.log2(records / given) - 1e-9))
    starts = np.asarray(flow.time)[0] + np.arange(phases(flow, duration)) * duration
    chains = [
        drift_map(water, flow, duration, start=start, **{**options, "steps": steps})
        for start in starts.tolist()
    ]
    return chains[0] if len(chains) == 1 else ChainSequence.of(chains)


def phases(flow: Flow, duration: float | int) -> int:
    """Number of steps in a period of a flow; 1 if it is steady."""
    return 1 if flow.period is None else steps_in(float(flow.period), duration)


def diffused_cells(water: Water, flow: Flow, duration: float) -> Float[np.ndarray, "axes cells"]:
    """The standard deviation of what diffuses from each cell for a time, in cells along x and y."""
    return math.sqrt(2 * flow.diffusivity * abs(duration)) / water.sides


def _diffused(
    water: Water,
    x: Float[np.ndarray, "cells"],
    y: Float[np.ndarray, "cells"],
    spread: Float[np.ndarray, "axes cells"],
    exits: bool,
) -> scipy.sparse.csr_array:
    """Where drifters diffuse to from a point for each cell: the normal law over the squares."""
    reach = math.ceil(_TAILS * float(spread.max()))
    steps = np.arange(-reach, reach + 1)[:, None]
    row, column = square(x, y)
    across, along = (
        np.diff(
            scipy.special.ndtr((np.append(steps, [[reach + 1]], 0) - 0.5 + first - v) / far), axis=0
        )
        for first, v, far in zip((column, row), (x, y), spread, strict=True)
    )
    across, along = across / across.sum(axis=0), along / along.sum(axis=0)
    right, up = (one.ravel()[:, None] for one in np.meshgrid(steps, steps))
    image = water.landing(column + right + 0.0, row + up + 0.0, exits=exits)
    share = (along[:, None] * across).reshape(image.shape)
    stays = image >= 0
    origin = np.broadcast_to(np.arange(water.cells), image.shape)[stays]
    shape = water.cells, water.cells
    return scipy.sparse.csr_array((share[stays], (origin, image[stays])), shape=shape)


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
    dx, dy = water.sides
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
    image, count = np.full((1, cells), _NONE, np.int32), np.zeros((1, cells), np.int32)
    every, used = np.arange(cells), np.zeros(cells, np.int32)
    for target in landed:
        # The slot of this target, or the first that is empty.
        slot = used.copy()
        for place, held in enumerate(image):
            np.copyto(slot, place, where=held == target)
        if slot.max() == len(image):
            image = np.pad(image, ((0, 1), (0, 0)), constant_values=_NONE)
            count = np.pad(count, ((0, 1), (0, 0)))
        image[slot, every] = target
        count[slot, every] += 1
        used = np.maximum(used, slot + 1)
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
