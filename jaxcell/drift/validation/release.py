"""The distance between a drift map and simulated drifters that are released in one cell."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ...base.shown import Pictured
from ...mapping import Chain, ChainSequence
from ...mapping.sequence import as_sequence
from ..flow import Flow, steps_in
from ..water import Water
from .replay import Replay, Sampling


# Drifters of all releases together; the points per side of a cell have no other limit.
_SAMPLING = Sampling(drifters=100_000, most=1000)
_TYPICAL = 9


@dataclasses.dataclass(frozen=True, eq=False)
class ReleaseDistance(Pictured):
    """The total variation between a map and drifters that are released uniformly in one cell."""

    cells: Int[np.ndarray, "releases"]
    "The cell of each release."
    hours: Float[np.ndarray, "times"]
    "The times of the comparison, in hours."
    total_variation: Float[np.ndarray, "releases times"]
    "The share of the drifters for which the map predicts a wrong cell, from 0 to 1."
    noise: Float[np.ndarray, "releases times"]
    "The total variation that this number of drifters would give even if the map were exact."
    replay: Replay
    "The simulated drifters."


def release_distance(
    water: Water,
    flow: Flow,
    chain: Chain | ChainSequence,
    seconds: float | int,
    cells: Int[np.ndarray, "releases"],
    hours: Sequence[float | int],
) -> ReleaseDistance:
    """Compare a map with simulated drifters, for releases in single cells.

    Drifters that are released everywhere stay nearly uniform, whatever a map does with them, so
    [`distances`][jaxcell.drift.distances] does not show how far a map spreads the drifters of one
    cell.

    **Arguments:**

    - `water`, `flow`: the cells, and the flow of the same layer at all records.
    - `chain`, `seconds`: the map and its seconds per step.
    - `cells`: the cells of the releases, such as those of
        [`typical_cells`][jaxcell.drift.typical_cells].
    - `hours`: the times of the comparison, each rounded to whole steps of the map.

    **Returns:** the [`ReleaseDistance`][], with a row per release.

    The map moves all drifters of cell 0 to the next cell, where half of them go:

        >>> import numpy as np
        >>> import jax.numpy as jnp
        >>> from jaxcell import drift, examples, mapping
        >>> water = examples.water([[1, 1, 1]])
        >>> rate = jnp.stack([jnp.full((1, 3), 0.5), jnp.zeros((1, 3))])[None]
        >>> flow = drift.Flow(rate, jnp.zeros(1))
        >>> chain = mapping.Chain(np.int32([[1, 2, 2]]), np.ones((1, 3)))
        >>> one = drift.release_distance(water, flow, chain, 1.0, np.array([0]), [1 / 3600])
        >>> one.total_variation.round(2).tolist()
        [[0.5]]
    """
    steps = sorted({steps_in(3600 * hour, seconds) for hour in hours})
    at = np.array(steps) * seconds / 3600
    replay = Replay.of(water, flow, at.tolist(), _SAMPLING, cells)
    sequence = as_sequence(chain)
    phases = range(min(sequence.phases, steps[-1]))
    matrices = [sequence.at(phase).to_scipy().T.tocsr() for phase in phases]
    by_map, mapped = (np.arange(water.cells)[:, None] == cells).astype(float), []
    for step in range(steps[-1]):
        by_map = matrices[step % sequence.phases] @ by_map
        if step + 1 in steps:
            mapped.append(by_map)
    variation, noise = np.zeros((2, cells.size, at.size))
    for number, cell in enumerate(cells.tolist()):
        among = replay.origin == cell
        for time, hour in enumerate(at.tolist()):
            one = replay.variation(hour, mapped[time][:, number], among)
            variation[number, time], noise[number, time] = one
    return ReleaseDistance(cells, at, variation, noise, replay)


def typical_cells(water: Water) -> Int[np.ndarray, "releases"]:
    """Choose up to nine cells, spread evenly over the cells of a layer.

    **Arguments:** the cells of the layer. **Returns:** the numbers of the chosen cells.

    Of ten cells in a row:

        >>> from jaxcell import drift, examples
        >>> drift.typical_cells(examples.water([[1] * 10])).tolist()
        [0, 1, 2, 3, 5, 6, 7, 8, 9]
    """
    count = min(_TYPICAL, water.cells)
    return ((np.arange(count) + 0.5) * water.cells / count).astype(np.int64)
