"""The change of groups and times of a map with the duration of its steps."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Float, Int

from ...base.quantities import Result, derived
from ..long_term import long_term_behaviour
from ..maps import drift_maps
from ..validation.diagnosis import group_counts
from ..validation.distance import MOST_CELLS
from .current_layer import Layer
from .layer_ends import LayerEnds


# The factors by which the durations of other steps differ.
_FACTORS = (0.5, 1.0, 2.0)


@dataclasses.dataclass(frozen=True, eq=False)
class StepSensitivity(Result):
    """The groups and times at the surface, for steps that are shorter or longer than the map's."""

    surface: Layer

    @derived("other_step", "duration of another step", "s")
    def duration(self) -> Float[np.ndarray, "steps"] | None:
        return None if self._counts is None else np.array(self._other_steps)

    @derived("other_step", "persistent groups at the surface", kind="count")
    def groups(self) -> Int[np.ndarray, "steps"] | None:
        return None if self._counts is None else self._counts[0]

    @derived("other_step", "persistent groups, by the centres of cells alone", kind="count")
    def groups_if_known(self) -> Int[np.ndarray, "steps"] | None:
        return None if self._counts is None else self._counts[1]

    @derived(
        "other_step", "in the long run: time to a group or off the map, median", "h", kind="time"
    )
    def median_hours(self) -> Float[np.ndarray, "steps"] | None:
        if self._by_other_steps is None:
            return None
        return np.array([ends.end_totals.median_hours for ends in self._by_other_steps])

    @functools.cached_property
    def _by_other_steps(self) -> list[LayerEnds] | None:
        """The ends of surface drifters for each step in `_other_steps`; `None` for large maps."""
        surface = self.surface
        if surface.water.cells * surface.by.phases(self._other_steps[0]) > MOST_CELLS:
            return None

        def ends(seconds: float) -> LayerEnds:
            if np.isclose(seconds, surface.behaviour.duration):
                return surface
            chain = drift_maps(surface.water, surface.by, surface.step.lasting(seconds))
            return LayerEnds(surface.water, long_term_behaviour(chain, seconds))

        return [*map(ends, self._other_steps)]

    @functools.cached_property
    def _counts(self) -> Int[np.ndarray, "2 steps"] | None:
        """The number of groups by duration: row 0 for the maps, row 1 if only cell centres move."""
        surface = self.surface
        # With diffusion each piece of water is one group.
        if self._by_other_steps is None or surface.by.diffusivity:
            return None
        # With `rho` = 1 there is no disturbance, and each cell has one image.
        centres = dataclasses.replace(surface.step, rho=1.0, spread="turned")
        steps = [centres.lasting(seconds) for seconds in self._other_steps]
        by_centres = group_counts(surface.water, surface.by, steps)
        return np.stack([[one.behaviour.groups.count for one in self._by_other_steps], by_centres])

    @property
    def _other_steps(self) -> list[float]:
        """The durations of steps to compare, in seconds; the second is the duration of the maps."""
        step = self.surface.behaviour.duration
        return [self.surface.by.fitted(factor * step) for factor in _FACTORS]
