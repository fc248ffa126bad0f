import dataclasses
import functools

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from .. import mapping, markov
from ..base.certificate import Solution
from ..base.shown import Shown
from ..mapping import SINK, Chain, ChainSequence, PersistentGroups, TransientGroups
from ..markov import Absorption, LimitingDistribution


@dataclasses.dataclass(frozen=True, eq=False)
class LongTermBehaviour(Shown):
    """The groups of cells in which drifters of one layer end, and the times until they arrive.

    These are the results of Alg. 5.1 of Alam 2018. In a periodic current they depend on the time of
    release, so all arrays have an entry per phase and cell, phase after phase, as in the `unrolled`
    map; `begins` contains the results for drifters that are released at phase 0.
    """

    chain: Chain | ChainSequence
    "The drift map, or the sequence of the maps of all phases of a periodic current."
    duration: float
    "Seconds per step."
    groups: PersistentGroups
    "The sets of cells that drifters never leave."
    transient: TransientGroups
    "The other cells, grouped by the persistent groups that drifters from them can reach."
    absorption: Solution
    "The expected number of steps until a drifter is in a persistent group or has left the grid."
    throw: bool = False
    "True if `probability` and `limiting` raise an error when they are not accurate enough."

    @property
    def unrolled(self) -> Chain:
        """The chain whose states are the cells at each phase, phase after phase."""
        return _unrolled(self.chain)

    @functools.cached_property
    def begins(self) -> "LongTermBehaviour":
        """The behaviour of drifters that are released at phase 0."""
        cells = self.chain.cells
        value = jax.device_put(np.asarray(self.absorption.value)[:cells])
        steps = Solution(value, self.absorption.certificate)
        groups, transient = self.groups.first(cells), self.transient.first(cells)
        return dataclasses.replace(self, groups=groups, transient=transient, absorption=steps)

    @property
    def hours(self) -> Float[Array, "cells"]:
        """The expected time, in hours, until a drifter is in a persistent group or off the grid."""
        return jax.device_put(np.asarray(self.absorption.value) * (self.duration / 3600))

    @functools.cached_property
    def probability(self) -> Absorption:
        """The probability of ending in each persistent group, or off the grid.

        Each group requires a linear solve, and 8 bytes of memory per cell.

        **Raises:** `RuntimeError` if the solve stalls and `throw` is set.
        """
        return markov.absorption_probabilities(self.unrolled, self.groups, throw=self.throw)

    @functools.cached_property
    def sure_to_leave(self) -> Float[np.ndarray, "cells"]:
        """The probability of ending off the grid: 0 if no drifter can, 1 if all must, or else NaN.

        It follows from the possible moves alone, without a linear solve.
        """
        chance = [
            0.0 if SINK not in homes else 1.0 if len(homes) == 1 else np.nan
            for homes in self.transient.domiciles
        ]
        # Persistent cells have the transient group -1, which is the last one here.
        return np.array([*chance, 0.0])[np.asarray(self.transient.group)]

    @functools.cached_property
    def limiting(self) -> LimitingDistribution:
        """The long-term distribution of drifters that were released uniformly in all cells.

        **Raises:** `RuntimeError` if a solve stalls and `throw` is set.
        """
        return markov.limiting_distribution(self.unrolled, self.groups, throw=self.throw)

    @property
    def basin(self) -> Int[Array, "cells"]:
        """The persistent group in which all drifters from each cell end, or -1.

        It is -1 if drifters may end in several groups, or may leave the grid. The cells with the
        same number are the domain of attraction of a group, and include the group.
        """
        transient = self.transient
        home = np.array([d[0] if len(d) == 1 else -1 for d in transient.domiciles] or [-1])
        alone = home[np.asarray(transient.group)]
        group = np.asarray(self.groups.group)
        return jax.device_put(np.where(group >= 0, group, alone).astype(np.int32))


def long_term_behaviour(
    chain: Chain | ChainSequence, duration: float | int, *, throw: bool = False
) -> LongTermBehaviour:
    """Compute where the drifters of one layer end in the long term (Alam 2018, Alg. 5.1).

    It runs on the host, because the sets of groups in which drifters end have different sizes.

    **Arguments:**

    - `chain`: the map, from [`jaxcell.drift.drift_map`][] or [`jaxcell.drift.drift_maps`][].
    - `duration`: seconds per step.
    - `throw`: whether to raise an error if absorption times, probabilities or the limiting
        distribution are inaccurate, which their `certificate` reports in any case. This happens
        if absorption times exceed some 10^9 steps, as in an eddy that almost traps drifters.

    **Returns:** [`LongTermBehaviour`][], which computes probabilities and the limiting distribution
    when they are first read.

    **Raises:** `ValueError` for a duration that is not positive; `RuntimeError` if the solve
    stalls and `throw` is set.

    In each step, half of the drifters in cell 0 move to cell 1. From cell 1 they move to 2 or 3:

        >>> from jaxcell import drift, examples
        >>> chain = examples.stream()
        >>> behaviour = drift.long_term_behaviour(chain, duration=3600)
        >>> behaviour.groups.group.tolist(), behaviour.basin.tolist()
        ([-1, -1, 0, 1], [-1, -1, 0, 1])
        >>> behaviour.hours.round(6).tolist()
        [3.0, 1.0, 0.0, 0.0]
    """
    if not (np.isfinite(duration) and duration > 0):
        raise ValueError(f"duration: expected a positive number of seconds, got {duration}")
    unrolled = _unrolled(chain)
    groups = mapping.persistent_groups(unrolled)
    return LongTermBehaviour(
        chain,
        float(duration),
        groups,
        mapping.transient_groups(unrolled, groups),
        markov.absorption_times(unrolled, groups, throw=throw),
        throw,
    )


def _unrolled(chain: Chain | ChainSequence) -> Chain:
    return chain.unrolled if isinstance(chain, ChainSequence) else chain
