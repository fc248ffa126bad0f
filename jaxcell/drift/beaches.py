"""Beaching: drifters strand at a coast, and may float again."""

import dataclasses
import functools

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ..base.quantities import Result, derived
from ..mapping import Chain, ChainSequence
from ..mapping.sequence import as_sequence
from .flow import steps_in
from .long_term import LongTermBehaviour
from .water import NEIGHBORS, Water


def coast(water: Water) -> Bool[np.ndarray, "cells"]:
    """Mark the cells with land beside them. An open edge of the map is not a coast.

    **Arguments:** the water of a layer. **Returns:** a mask over its cells.

    A sea of two cells with land at one end:

        >>> from jaxcell import drift, examples
        >>> drift.coast(examples.water([[0, 1, 1]])).tolist()
        [True, False]
    """
    around = (water.at(water.row + up, water.column + right) for up, right in NEIGHBORS)
    return np.any([land for _, land in around], axis=0)


def beaching(
    chain: Chain | ChainSequence,
    at_coast: Bool[np.ndarray, "cells"],
    duration: float | int,
    *,
    afloat: float | int,
    stranded: float | int = np.inf,
) -> tuple[Chain | ChainSequence, Int[np.ndarray, "coast"]]:
    """Add a beach to the drift map for each cell at a coast.

    A beach is an additional state of the chain. In a step, a drifter in a cell at a coast strands
    with probability `1 - 2^(-duration / afloat)`, and otherwise drifts on; a drifter on a beach
    returns to its cell with probability `1 - 2^(-duration / stranded)`.

    **Arguments:**

    - `chain`: the map of a layer, from [`jaxcell.drift.drift_maps`][].
    - `at_coast`: the mask of the cells that get a beach, from [`coast`][].
    - `duration`: duration of a step, in seconds.
    - `afloat`: the time in seconds in which half of the drifters strand if they stay at a coast.
    - `stranded`: the time in seconds in which half of the drifters on a beach float again; infinite
        by default, so that beaches are persistent groups.

    **Returns:** the new map, whose states are the cells and then the beaches; and the cell of each
    beach.

    In still water, half of the drifters in the cell at the coast strand in an hour:

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
    shares = [-np.expm1(-np.log(2) * duration / half) for half in (afloat, stranded)]
    if isinstance(chain, ChainSequence):
        phases = [_with_beaches(chain.at(k), cell, *shares) for k in range(chain.phases)]
        return ChainSequence.of(phases), cell
    return _with_beaches(chain, cell, *shares), cell


def _with_beaches(
    chain: Chain, cell: Int[np.ndarray, "coast"], strands: float, floats: float
) -> Chain:
    ashore = scipy.sparse.eye_array(chain.cells, format="csc")[:, cell]
    afloat = scipy.sparse.diags_array(1 - strands * ashore.sum(axis=1)) @ chain.to_scipy()
    stay = (1 - floats) * scipy.sparse.eye_array(cell.size)
    blocks = [[afloat, strands * ashore], [floats * ashore.T, stay]]
    return Chain.from_scipy(scipy.sparse.block_array(blocks))


_DRY = "NaN: no water"


@dataclasses.dataclass(frozen=True, eq=False)
class Stranded(Result):
    """The stranding of drifters that are released uniformly in all cells of a layer.

    Still water beside land: half of the drifters afloat strand in an hour, and half of the
    stranded drifters float again in an hour:

        >>> import numpy as np
        >>> from jaxcell import drift, examples, mapping
        >>> water = examples.water([[0, 1]])
        >>> still = drift.long_term_behaviour(mapping.Chain.from_scipy(np.eye(1)), 3600)
        >>> stranded = drift.Stranded.of(water, still, 2 * 3600, afloat=3600, stranded=3600)
        >>> stranded.beaches, stranded.share_by_step.tolist(), stranded.share
        (1, [0.0, 0.5, 0.5], 0.5)
    """

    water: Water
    chain: Chain | ChainSequence
    "The drift map, whose states are the cells and then the beaches, from [`beaching`][]."
    cell: Int[np.ndarray, "beaches"]
    "The cell of each beach."
    hours: float | int
    "The duration of a step, in hours."
    steps: int
    "The number of steps from the release until the stranded drifters are counted."

    @classmethod
    def of(
        cls,
        water: Water,
        behaviour: LongTermBehaviour,
        seconds: float | int,
        *,
        afloat: float | int,
        stranded: float | int = np.inf,
    ) -> "Stranded":
        """Compute the share of drifters that are stranded after `seconds` (rounded to whole steps).

        The drift map is that of `behaviour`; `afloat` and `stranded` are as for [`beaching`][].
        """
        step = behaviour.duration
        both = beaching(behaviour.chain, coast(water), step, afloat=afloat, stranded=stranded)
        return cls(water, *both, step / 3600, steps_in(seconds, step))

    @derived("", "time between release and the answer", "h", kind="time")
    def after_hours(self) -> float:
        return float(self.steps * self.hours)

    @derived("", "drifters on a beach then", kind="share")
    def share(self) -> float:
        return float(self.share_by_step[-1])

    @derived("", "drifters off the map then", kind="share")
    def left(self) -> float:
        return max(0.0, float(1 - self._shares[-1].sum()))

    @derived("", "cells at a coast", kind="count")
    def beaches(self) -> int:
        return self.cell.size

    @derived("beaching_step", "drifters on a beach after each step", "1", kind="share")
    def share_by_step(self) -> Float[np.ndarray, "steps"]:
        return self._shares[:, self.water.cells :].sum(axis=1)

    @derived("y x", "share of all drifters on the beach then", "1", padding="NaN: no beach")
    def on_beach(self) -> Float[np.ndarray, "rows columns"]:
        share = np.full(self.water.cells, np.nan)
        share[self.cell] = self._shares[-1, self.water.cells :]
        return self.water.on_grid(share)

    @derived("y x", "probability to be on a beach then, by the cell of release", "1", padding=_DRY)
    def chance(self) -> Float[np.ndarray, "rows columns"]:
        ashore = np.arange(self.chain.cells) >= self.water.cells
        later = as_sequence(self.chain).pull(ashore.astype(float), self.steps)
        return self.water.on_grid(np.asarray(later)[: self.water.cells].clip(0, 1))

    @functools.cached_property
    def _shares(self) -> Float[np.ndarray, "steps states"]:
        """The share of the drifters in each cell and on each beach after each step."""
        cells = self.water.cells
        share = np.where(np.arange(self.chain.cells) < cells, 1 / cells, 0.0)
        return np.stack([*as_sequence(self.chain).pushed(share, self.steps)])
