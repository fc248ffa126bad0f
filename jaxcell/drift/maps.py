import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
import scipy.special
from jaxtyping import Array, Bool, Float

from ..base import memory
from ..base.precision import require_x64
from ..base.wide import traced
from ..mapping import Chain, ChainSequence
from ..mapping.generalized import leaving_rows, slots_of
from ..mapping.traced import like, on_host
from .advection import carried
from .disturbances import (
    Origin,
    Points,
    Squares,
    around,
    set_probabilities,
    squares_around,
    turned_ends,
    with_uniform_boundary,
)
from .drift_step import DriftStep
from .flow import Flow, crossing_time
from .water import Water, on_grid, square


# Diffusion is cut off at this number of standard deviations; the largest deviation in cells.
_TAILS, _MAX_SPREAD = 3.5, 10
# A deviation in cells that keeps a drifter in its square.
_TINY = 1e-12
# The number of points per call, unless the points along one side of all cells are more.
_POINTS = 65_536
EDGES = ("east", "north", "west", "south")
"""The edges of the grid, counter-clockwise."""
EXITS = ("sea without data", "land", *(f"edge in the {side}" for side in EDGES))
"""The exits through which drifters leave the map."""

# The end points of drifters from some cells.
_Ends: TypeAlias = Float[Any, "some"]


def flow_map(
    water: Water, flow: Flow, step: DriftStep, *, start: float | Any = 0.0
) -> Float[Array, "axes cells"]:
    """Compute the displacement of the centre of every cell (Alam 2018, section 5.4.2).

    **Arguments:**

    - `water`: the cells.
    - `flow`: the flow of the same layer.
    - `step`: the duration and the integration method; its other rules have no effect.
    - `start`: the time at the beginning, in seconds as in `Flow.time`. The flow, the duration and
        the time may be traced by `jit`, `vmap` and `grad`.

    **Returns:** the displacements along the axes x and y of the grid, in cells.

    In the crossing time the centres of cells move by one cell on average:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> shift = drift.flow_map(water, flow, drift.DriftStep())
        >>> shift.shape, round(float(((shift**2).sum(axis=0) ** 0.5).mean()), 6)
        ((2, 538), 1.0)
    """
    duration = step.seconds(water, flow)
    x, y = np.stack([water.column, water.row]).astype(np.float64)
    right, up = carried(flow, x, y, duration, start, step.method, step.substeps)
    return jax.device_put(right.__array_namespace__().stack([right - x, up - y]))


def drift_map(water: Water, flow: Flow, step: DriftStep, *, start: float | Any = 0.0) -> Chain:
    """Compute the transition probabilities between cells (Alam 2018, section 5.4.3 and Alg. 5.1).

    **Arguments:**

    - `water`: the cells.
    - `flow`: the flow of the same layer.
    - `step`: the duration of a step and its rules.
    - `start`: the time at the beginning, in seconds as in `Flow.time`. The rate of the flow, the
        time and, without a diffusivity, the duration may be traced by `jit`, `vmap` and `grad`.

    **Returns:** the chain over the cells. In a program, each sampled point has an image of its own.
    Probabilities have derivatives if there is a diffusivity; otherwise they change only in jumps.

    **Raises:** `ValueError` if the flow and the water are on different grids, if the coast is
    `"strand"` but the edge is not `"exit"`, if the diffusivity is too large, or if there is a
    diffusivity but the spread is not `"sampled"`; `MemoryError` if the map does not fit into the
    free memory.

    The surface of the bundled sea; most cells have an image and two disturbances:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> chain = drift.drift_map(water, flow, drift.DriftStep())
        >>> matrix = chain.to_scipy()
        >>> matrix.shape, round(float(matrix.max()), 2), round(float(matrix.sum(axis=1).min()), 6)
        ((538, 538), 0.8, 1.0)
    """
    require_x64("drift_map")
    duration = step.seconds(water, flow)
    if traced(flow.diffusivity) or (flow.diffusivity and traced(duration)):
        raise TypeError(
            "diffusivity, duration: expected numbers that JAX does not trace, because the number "
            "of images of a cell depends on them"
        )
    if water.coast == "strand" and step.edge != "exit":
        raise ValueError(f"coast: expected the edge 'exit' with 'strand', got {step.edge!r}")
    if flow.diffusivity and step.spread != "sampled":
        raise ValueError(f"diffusivity: expected spread 'sampled' with it, got {step.spread!r}")
    deviation = diffused_cells(water, flow, duration)
    if (widest := float(deviation.max())) > _MAX_SPREAD:
        raise ValueError(
            f"diffusivity: {flow.diffusivity:g} m²/s spreads drifters over {widest:.3g} cells in "
            f"a step of {duration:g} s; expected {_MAX_SPREAD:g} at most"
        )
    samples, exits = step.samples, step.edge == "exit"
    in_program = traced(flow, duration, start) and step.spread == "sampled"
    # In a program the images of sampled points are not merged, because their number would change.
    near = (2 * math.ceil(_TAILS * widest) + 3) ** 2 if flow.diffusivity else min(9, samples**2)
    sampled = samples**2 * (near if flow.diffusivity else 1) if in_program else near
    branches = {"turned": 3, "all": 9, "sampled": sampled}[step.spread]
    memory.check(
        (40 * (branches + 1) + 100 * samples) * water.cells,
        f"a drift map of {water.cells:,} cells of water",
        "read less of the currents",
    )

    def landing(x: Points, y: Points) -> Squares:
        images = around if step.spread == "all" else Water.landing
        form = like(int, 9 if step.spread == "all" else len(x), water.cells)
        return on_host(lambda _, x, y: images(water, x, y, exits=exits), form, (), x, y)

    every = np.arange(water.cells, dtype=np.int32)
    ends = _ends(water, flow, step, start, every)
    if step.spread != "sampled":
        [(x, y, _)] = ends
        image = landing(x, y)
        probability = set_probabilities(image, float(step.rho))
    elif in_program:
        x, y, share = map(jnp.concatenate, zip(*ends, strict=True))
        image, probability = landing(x, y), share / samples**2
    else:
        matrix: scipy.sparse.csr_array | int = 0
        for x, y, share in ends:
            matrix = matrix + _transitions(landing(x, y), share)
        image, probability = slots_of(matrix / samples**2)
    if not exits:
        image, probability = with_uniform_boundary(water, image, probability)
    # The probability of the sink is 1 minus the sum over the cells.
    gone, xp = image < 0, image.__array_namespace__()
    image = xp.where(gone, every[None], image)
    return Chain(image.astype(np.int32), xp.where(gone, 0.0, probability))


def drift_maps(
    water: Water, flow: Flow, step: DriftStep, *, say: Callable[..., None] = lambda *_: None
) -> Chain | ChainSequence:
    """Compute a map of the cells for each phase of a periodic flow.

    **Arguments:**

    - `water`: the cells.
    - `flow`: the flow of the same layer; [`Flow.repeated`][] makes a flow periodic.
    - `step`: a step whose duration divides the period or is a multiple of it, as from
        [`Flow.fitted`][]. Runge-Kutta substeps are halved until each is at most as long as the time
        between records, and moves drifters by at most half a cell on average.
    - `say`: a function that is called before each map with the name of the stage, the number of
        maps that are done, and their total.

    **Returns:** the sequence of the chains of the phases; or a single chain, if the flow is not
    periodic or a step lasts whole periods.

    Five hours of the bundled sea, repeated:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=(0, 4), depths=0)
        >>> water, flow = drift.Water.of(currents), drift.Flow.of(currents).repeated()
        >>> tide = drift.drift_maps(water, flow, drift.METHODS["drifters"].lasting(9000.0))
        >>> tide.shape
        (2, 538)
    """
    step, starts = _phases(water, flow, step)
    chains = []
    for number, start in enumerate(starts):
        say(f"mapping {water.cells:,} cells at {water.depth:g} m", number, len(starts))
        chains.append(drift_map(water, flow, step, start=start))
    return chains[0] if len(chains) == 1 else ChainSequence.of(chains)


def exit_shares(
    water: Water, flow: Flow, step: DriftStep, chain: Chain | ChainSequence
) -> Float[np.ndarray, "exits states"]:
    """Compute the probability of leaving the map in a step through each exit.

    **Arguments:**

    - `water`, `flow`, `step`: as for [`drift_maps`][].
    - `chain`: the map that [`drift_maps`][] made from them.

    **Returns:** the probability from each cell at each phase, for each of `EXITS`: sea without
    data, stranding on land, and the edge of the grid in the east, north, west and south.

    One cell, whose water moves East by half a cell in a step; 3 of 5 columns of points leave it:

        >>> import jax.numpy as jnp
        >>> from jaxcell import drift, examples
        >>> water = examples.water([[1]])
        >>> flow = drift.Flow(jnp.array([0.5, 0.0]).reshape(1, 2, 1, 1), jnp.zeros(1))
        >>> step = drift.METHODS["drifters"].lasting(1.0)
        >>> chain = drift.drift_maps(water, flow, step)
        >>> drift.exit_shares(water, flow, step, chain).round(1).tolist()
        [[0.0], [0.0], [0.6], [0.0], [0.0], [0.0]]
    """
    step, starts = _phases(water, flow, step)
    lost = leaving_rows(chain.to_scipy()).reshape(len(starts), -1)
    phases = zip(starts, lost, strict=True)
    return np.concatenate([_exit_shares(water, flow, step, *one) for one in phases], axis=1)


def _exit_shares(
    water: Water, flow: Flow, step: DriftStep, start: float, lost: Float[np.ndarray, "cells"]
) -> Float[np.ndarray, "exits cells"]:
    """Divide the probability of leaving the map in a step, `lost`, among the exits."""
    shares = np.zeros((len(EXITS), water.cells))
    origin = np.flatnonzero(lost > 0)
    if not origin.size:
        return shares
    for x, y, share in _ends(water, flow, step, start, origin):
        if step.spread == "all":
            image = water.landing(x, y, origin=origin, exits=True)
            row, column = squares_around(water, image, x, y)
        else:
            row, column = square(x, y)
        cell, land = water.at(row, column)
        on = on_grid(water.number.shape, water.wraps, column, row)
        edge = np.where(on, -1, _edge(water, origin, row, column))
        off = [edge == side for side in range(len(EDGES))]
        ways = on & ~land, land & (water.coast == "strand"), *off
        shares[:, origin] += [(share * (way & (cell < 0))).sum(axis=0) for way in ways]
    total = shares[:, origin].sum(axis=0)
    shares[:, origin] *= lost[origin] / np.where(total > 0, total, 1)
    return shares


def _edge(water: Water, origin: Origin, row: Squares, column: Squares) -> Squares:
    """Find the edge, an index of `EDGES`, that drifters from `origin` cross to reach a square."""
    up, right = (
        at - at.clip(0, size - 1)
        for at, size in zip((row, column), water.number.shape, strict=True)
    )
    turned = np.arctan2(up, right * (not water.wraps))
    angle = turned + water.angle[water.row[origin], water.column[origin]]
    return np.round(2 * angle / math.pi).astype(int) % len(EDGES)


def _phases(water: Water, flow: Flow, step: DriftStep) -> tuple[DriftStep, list[float]]:
    """Set the duration and substeps of a step; return the new step, and when each phase begins."""
    duration = step.seconds(water, flow)
    needed = 2 * abs(duration) / crossing_time(water, flow) if step.method == "rk4" else 1.0
    if flow.period is None:
        return refined(step, duration, needed), [0.0]
    if not np.isclose(flow.fitted(duration), duration, rtol=1e-9):
        raise ValueError(
            f"duration: expected a whole part or multiple of the period, {float(flow.period):g} s, "
            f"such as {flow.fitted(duration):g} s, got {duration:g} s"
        )
    records = duration / float(np.diff(np.asarray(flow.time)).min())
    step = refined(step, duration, max(needed, records))
    starts = np.asarray(flow.time)[0] + np.arange(flow.phases(duration)) * duration
    return step, starts.tolist()


def _ends(
    water: Water, flow: Flow, step: DriftStep, start: Any, origin: Origin
) -> Iterator[tuple[Points, Points, Points]]:
    """Yield `x` and `y` of the end points of drifters from the cells `origin`, and their weights.

    The arrays have a row per sample point and a column per cell.
    """
    duration = step.seconds(water, flow)

    def carry(right: np.ndarray, up: np.ndarray) -> tuple[Points, Points]:
        """Move points with the flow; they begin `right` and `up` of each centre, in cells."""
        x, y = water.column[origin] + right[:, None], water.row[origin] + up[:, None]
        gone = water.gone if step.edge == "exit" and step.method == "rk4" else None
        return carried(flow, x, y, duration, start, step.method, step.substeps, gone)

    if step.spread != "sampled":
        x, y = carry(np.zeros(1), np.zeros(1))
        if step.spread == "turned":
            x, y = turned_ends(water, x, y, origin)
        yield x, y, np.ones(x.shape)
        return
    places = (np.arange(step.samples) + 0.5) / step.samples - 0.5
    right, up = (offset.ravel() for offset in np.meshgrid(places, places))
    chunk = max(step.samples, _POINTS // origin.size)
    deviation = diffused_cells(water, flow, duration)[:, origin]

    def left(_: Any, x: _Ends, y: _Ends) -> Any:
        """Mark the drifters that have left, which do not diffuse back."""
        return (step.edge == "exit") & water.left(x, y)

    for k in range(0, up.size, chunk):
        x, y = carry(right[k : k + chunk], up[k : k + chunk])
        if flow.diffusivity:
            for point in zip(x, y, strict=True):
                gone = on_host(left, like(bool, origin.size), (), *point)
                yield _diffused(*point, deviation, gone)
        else:
            yield x, y, np.ones(x.shape)


def refined(step: DriftStep, duration: float, needed: float) -> DriftStep:
    """Set the duration of a step, and double its substeps until there are at least `needed`."""
    finer = 2 ** max(0, math.ceil(math.log2(needed / step.substeps) - 1e-9))
    return dataclasses.replace(step, duration=duration, substeps=step.substeps * finer)


def diffused_cells(water: Water, flow: Flow, duration: Any) -> Float[np.ndarray, "axes cells"]:
    """Compute the standard deviation of the diffusion from each cell, in cells along x and y."""
    distance = math.sqrt(2 * flow.diffusivity * abs(duration)) if flow.diffusivity else 0.0
    return distance / water.sides


def _diffused(
    x: _Ends, y: _Ends, deviation: Points, left: Bool[Any, "some"]
) -> tuple[Points, Points, Points]:
    """Spread each cell's end point by a normal distribution, and integrate it over near squares.

    **Returns:** the columns and rows of the squares, and their shares.
    """
    xp = x.__array_namespace__()
    ndtr = scipy.special.ndtr if xp is np else jax.scipy.special.ndtr
    spread = xp.where(left[None], _TINY, deviation)
    reach = math.ceil(_TAILS * float((deviation if traced(left) else spread).max()))
    steps = np.arange(-reach, reach + 1.0)[:, None]
    sides = np.append(steps, [[reach + 1]], 0) - 0.5
    row, column = (at.astype(float)[None] for at in square(x, y))
    across, along = (
        xp.diff(ndtr((sides + centre - place[None]) / width[None]), axis=0)
        for centre, place, width in zip((column, row), (x, y), spread, strict=True)
    )
    across, along = (part / part.sum(axis=0, keepdims=True) for part in (across, along))
    right, up = (offset.ravel()[:, None] for offset in np.meshgrid(steps, steps))
    share = along[:, None] * across[None]
    return column + right, row + up, share.reshape(-1, x.size)


def _transitions(image: Squares, share: Points) -> scipy.sparse.csr_array:
    """Build a transition matrix from the images of each cell and their shares; -1 is the sink."""
    stays, cells = image >= 0, image.shape[1]
    origin = np.broadcast_to(np.arange(cells), image.shape)[stays]
    return scipy.sparse.csr_array((share[stays], (origin, image[stays])), shape=(cells, cells))
