import dataclasses
import functools

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..base.certificate import Solution
from ..mapping import (
    SINK,
    Chain,
    ChainSequence,
    PersistentGroups,
    TransientGroups,
    persistent_groups,
    transient_groups,
)
from ..markov import (
    Absorption,
    LimitingDistribution,
    absorption_probabilities,
    absorption_times,
    limiting_distribution,
)


@dataclasses.dataclass(frozen=True, eq=False)
class LongTermBehaviour:
    """Where drifters of one layer end up, and when (Alam 2018, Alg. 5.1).

    In a current that repeats itself that depends on when they are released. Groups, times and
    probabilities are then of the `unrolled` map, of the cells at each phase of the current, phase
    after phase; `begins` has those of phase 0.
    """

    chain: Chain | ChainSequence
    "The generalized map, or those that follow on one another."
    duration: float
    "Seconds that one step of it takes."
    groups: PersistentGroups
    "Where drifters stay for ever."
    transient: TransientGroups
    "The other cells, by where they may end: the single- and multiple-domicile groups."
    absorption: Solution
    "The expected number of steps until a drifter is in a persistent group or has left the grid."
    throw: bool = False
    "Whether `probability` and `limiting` raise when they are not good enough."

    @property
    def unrolled(self) -> Chain:
        """The map, of the cells at each phase."""
        return _unrolled(self.chain)

    @functools.cached_property
    def begins(self) -> "LongTermBehaviour":
        """The same with groups and times of drifters that are released at phase 0 only."""
        cells = self.chain.cells
        value = jax.device_put(np.asarray(self.absorption.value)[:cells])
        steps = Solution(value, self.absorption.certificate)
        groups, transient = self.groups.first(cells), self.transient.first(cells)
        return dataclasses.replace(self, groups=groups, transient=transient, absorption=steps)

    @property
    def hours(self) -> Float[Array, "cells"]:
        """The expected time until a drifter is in a persistent group or has left, in hours."""
        return jax.device_put(np.asarray(self.absorption.value) * (self.duration / 3600))

    @functools.cached_property
    def probability(self) -> Absorption:
        """The probability of ending in each persistent group, or off the grid.

        It takes a solve and 8 bytes a cell for every group. Its `certificate` says how good it is.

        **Raises:** `RuntimeError` if the solve stalls and `throw` is set.
        """
        return absorption_probabilities(self.unrolled, self.groups, throw=self.throw)

    @functools.cached_property
    def sure_to_leave(self) -> Float[np.ndarray, "cells"]:
        """The probability of ending off the grid where no solve is needed for it: 0 or 1.

        It is NaN in cells from which a drifter may leave or be in a persistent group in the end.
        """
        chance = [
            0.0 if SINK not in homes else 1.0 if len(homes) == 1 else np.nan
            for homes in self.transient.domiciles
        ]
        # The last one stands for what is persistent, whose transient group is -1.
        return np.array([*chance, 0.0])[np.asarray(self.transient.group)]

    @functools.cached_property
    def limiting(self) -> LimitingDistribution:
        """Where drifters that were released in all cells alike are in the long run.

        **Raises:** `RuntimeError` if a solve stalls and `throw` is set.
        """
        return limiting_distribution(self.unrolled, self.groups, throw=self.throw)

    @property
    def basin(self) -> Int[Array, "cells"]:
        """The one persistent group in which a drifter ends up for sure; -1 if there is none such.

        These are the domains of attraction, with the groups themselves.
        """
        transient = self.transient
        home = np.array([d[0] if len(d) == 1 else -1 for d in transient.domiciles] or [-1])
        alone = home[np.asarray(transient.group)]
        group = np.asarray(self.groups.group)
        return jax.device_put(np.where(group >= 0, group, alone).astype(np.int32))


def long_term_behaviour(
    chain: Chain | ChainSequence, duration: float | int, *, throw: bool = False
) -> LongTermBehaviour:
    """The long-term behaviour of the water of one layer (Alam 2018, Alg. 5.1).

    **Arguments:**

    - `chain`: the map, from [`jaxcell.drift.drift_map`][], or maps that follow on one another,
        from [`jaxcell.drift.drift_maps`][].
    - `duration`: seconds that one step of it takes.
    - `throw`: whether to raise when the absorption times are not good enough, and the probabilities
        and the limiting distribution once they are asked for.
        Not so by default: times from some 10^9 steps on, where an eddy that is no group holds
        drifters almost for ever, are beyond 64-bit numbers. The `certificate` of each says so.

    **Returns:** [`LongTermBehaviour`][]; probabilities and the limiting distribution are computed
    when they are asked for.

    **Raises:** `ValueError` for a duration that is not positive; `RuntimeError` if the solve
    stalls and `throw` is set.

    From cell 0 drifters go on half of the time, to cell 1, and from there to 2 or 3:

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
    groups = persistent_groups(unrolled)
    return LongTermBehaviour(
        chain,
        float(duration),
        groups,
        transient_groups(unrolled, groups),
        absorption_times(unrolled, groups, throw=throw),
        throw,
    )


def _unrolled(chain: Chain | ChainSequence) -> Chain:
    return chain.unrolled if isinstance(chain, ChainSequence) else chain
