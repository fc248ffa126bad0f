import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Float, Int

from ...base.shown import Pictured, Shown
from ...currents.sphere import turned
from ...mapping import Chain, ChainSequence
from ...mapping.sequence import as_sequence
from ...markov.hitting import cell_mask
from ..advection import drifted
from ..drift_step import DriftStep
from ..flow import Flow, nearest_square
from ..water import Water


@dataclasses.dataclass(frozen=True, eq=False)
class Drifters(Shown):
    """The positions of simulated drifters, step by step."""

    x: Float[Array | np.ndarray, "steps drifters"]
    """Column of each drifter after each step, in cells. Drifters stop where they leave the map. On
    a grid that goes round the Earth, x grows beyond the last column with each turn."""
    y: Float[Array | np.ndarray, "steps drifters"]
    cell: Int[np.ndarray, "steps drifters"]
    "The cell of each drifter, or the nearest cell if it ran ashore; -1 off the map."
    duration: float
    "Seconds per step."

    def share(self, cells: int) -> Float[np.ndarray, "steps cells"]:
        """Compute the share of all drifters in each cell after each step."""
        return _share(self.cell, cells)


def simulate_drifters(
    key: jax.Array,
    water: Water,
    flow: Flow,
    cells: npt.ArrayLike | int,
    duration: float | int,
    steps: int,
    *,
    drifters: int = 10_000,
    rho: float | int = 1.0,
    start: float | int = 0.0,
    substeps: int = 8,
) -> Drifters:
    """Simulate drifters in the flow without cells, to check a drift map.

    Drifters move with the Runge-Kutta method, and do not return after they have left the map.

    **Arguments:**

    - `key`: a key of `jax.random`.
    - `water`, `flow`: as for [`jaxcell.drift.drift_map`][].
    - `cells`: a cell, several cells, or a mask of the cells in which drifters are released
        uniformly.
    - `duration`: seconds per step.
    - `steps`: number of steps.
    - `drifters`: number of drifters.
    - `rho`: the probability that a drifter follows the flow in a step; otherwise its drift is
        turned by 45 degrees to either side, the disturbance of `spread="turned"`.
    - `start`: the time of release, in seconds as in `Flow.time`.
    - `substeps`: least number of steps of the Runge-Kutta method in each step.

    **Returns:** [`Drifters`][], whose first row contains the points of release.

    Two hours at the surface of the bundled sea, from cell 100:

        >>> import jax
        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> moved = drift.simulate_drifters(jax.random.key(0), water, flow, 100, 3600.0, 2)
        >>> moved.cell.shape, set(moved.cell[0].tolist())
        ((3, 10000), {100})
    """
    duration = DriftStep(duration, rho=rho, substeps=substeps).seconds(water, flow)
    if steps < 0 or drifters < 1:
        raise ValueError(
            f"expected 0 steps or more and 1 drifter or more, got {steps} and {drifters}"
        )
    released = np.flatnonzero(cell_mask(water.cells, cells, "cells"))
    centre = np.stack([water.column, water.row]).astype(np.float64)[:, released]
    random = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    choice = random.integers(released.size, size=drifters)
    places = [centre[:, choice] + random.uniform(-0.5, 0.5, (2, drifters))]
    longest, turns = abs(duration) / substeps, np.array([0.0, np.pi / 4, -np.pi / 4])
    for number in range(steps):
        (x, y), begin, drawn = places[-1], start + number * duration, None
        if flow.diffusivity:
            drawn = jax.random.fold_in(key, number)
        end = np.stack(drifted(water, flow, x, y, begin, begin + duration, longest, drawn))
        if rho < 1:
            row, column = map(np.asarray, nearest_square(water.dx.shape, water.wraps, x, y))
            sides = np.stack([water.dx[row, column], water.dy[row, column]])
            angle = random.choice(turns, drifters, p=[rho, (1 - rho) / 2, (1 - rho) / 2])
            right, up = (end - places[-1]) * sides
            end = places[-1] + np.stack(turned(right, up, angle)) / sides
        places.append(end)
    x, y = np.stack(places, axis=1)
    cell = water.landing(x, y, origin=released[choice], exits=True)
    return Drifters(jax.device_put(x), jax.device_put(y), cell, duration)


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison(Pictured):
    """The distance between the distributions of a chain and of simulated drifters over time."""

    hours: Float[np.ndarray, "times"]
    total_variation: Float[np.ndarray, "times"]
    "The total variation: the share of drifters for which the chain predicts a wrong cell, 0 to 1."
    sampling: Float[np.ndarray, "times"]
    "The total variation between two halves of the drifters: the noise of the comparison."
    transport: Float[np.ndarray, "times"]
    "The larger of the Wasserstein distances along x and y, in cells."


def compare(
    water: Water,
    chain: Chain | ChainSequence,
    drifted: Drifters,
    hours: Sequence[float | int] = (1, 12, 24),
) -> Comparison:
    """Compare a drift map with simulated drifters that were released at phase 0.

    **Arguments:**

    - `water`: the cells.
    - `chain`: the map, whose steps are as long as the steps of the drifters.
    - `drifted`: the drifters.
    - `hours`: the times of the comparison, rounded to whole steps.

    **Returns:** [`Comparison`][], with one number per time.

    Two cells of 1 km. The chain moves all drifters to the second cell; one of two drifters moved:

        >>> import jax.numpy as jnp, numpy as np
        >>> from jaxcell import drift, examples, mapping
        >>> chain = mapping.Chain(np.int32([[1, 1]]), np.ones((1, 2)))
        >>> water = examples.water([[1, 1]])
        >>> x = jnp.array([[0.0, 0.0], [0.0, 1.0]])
        >>> drifted = drift.Drifters(x, 0 * x, np.int32([[0, 0], [0, 1]]), 3600.0)
        >>> drift.compare(water, chain, drifted, [0, 1]).total_variation.tolist()
        [0.0, 0.5]
    """
    if chain.cells != water.cells:
        raise ValueError(f"chain: expected one of {water.cells} cells, got one of {chain.cells}")
    wanted = np.rint(np.asarray(hours, float) * 3600 / drifted.duration).astype(int)
    last = len(drifted.cell) - 1
    if wanted.size == 0 or wanted.min() < 0 or wanted.max() > last:
        raise ValueError(
            f"hours: expected times from 0 to {last * drifted.duration / 3600:g}, got {list(hours)}"
        )
    share = drifted.share(water.cells)
    halves = [_share(drifted.cell[:, k::2], water.cells) for k in (0, 1)]
    pushed = as_sequence(chain).pushed(share[0], int(wanted.max()))
    by_map = {step: cells for step, cells in enumerate(pushed) if step in wanted}
    return Comparison(
        wanted * drifted.duration / 3600,
        np.array([total_variation(by_map[k], share[k]) for k in wanted]),
        np.array([total_variation(*(half[k] for half in halves)) for k in wanted]),
        np.array([_transport(water, by_map[k], share[k]) for k in wanted]),
    )


def _share(cell: Int[np.ndarray, "steps drifters"], cells: int) -> Float[np.ndarray, "steps cells"]:
    rows = [np.bincount(row[row >= 0], minlength=cells) for row in cell]
    return np.stack(rows) / cell.shape[1]


def total_variation(p: Float[np.ndarray, "cells"], q: Float[np.ndarray, "cells"]) -> float:
    """Compute the total variation of two distributions; off the map counts as one more cell."""
    return float((np.abs(p - q).sum() + abs(p.sum() - q.sum())) / 2)


def _transport(water: Water, p: Float[np.ndarray, "cells"], q: Float[np.ndarray, "cells"]) -> float:
    """Compute the Wasserstein distances over columns and over rows, and return the larger one.

    It is a lower bound on the distance over cells, and needs no linear program. Drifters off the
    grid are left out. On a grid that goes round the Earth, distances are measured along the shorter
    path.
    """
    if not (p.sum() > 0 and q.sum() > 0):
        return float("nan")
    apart = []
    columns = water.number.shape[1]
    for place, circle in ((water.column, water.wraps), (water.row, False)):
        size = columns if circle else 0
        over = [np.cumsum(np.bincount(place, v / v.sum(), size)) for v in (p, q)]
        moved = over[0] - over[1]
        if circle:
            # Any constant flow round the circle may be added; with a median of 0 the sum is least.
            moved = moved - np.median(moved)
        apart.append(float(np.abs(moved).sum()))
    return max(apart)
