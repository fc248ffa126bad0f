"""The change of groups and times of a map with the duration of its steps."""

import dataclasses
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int

from ...base.quantities import Result, quantity
from ..long_term import long_term_behaviour
from ..maps import drift_maps
from ..validation.diagnosis import group_counts
from ..validation.distance import MOST_CELLS
from .current_layer import Layer
from .layer_ends import LayerEnds


# The factors by which the durations of other steps differ.
_FACTORS = (0.5, 1.0, 2.0)
_groups = quantity("other_step", "persistent groups at the surface", kind="count")
_known = quantity("other_step", "persistent groups, by the centres of cells alone", kind="count")
_hours = quantity(
    "other_step", "in the long run: time to a group or off the map, median", "h", kind="time"
)


@dataclasses.dataclass(frozen=True, eq=False)
class StepSensitivity(Result):
    """The groups and times at the surface, for steps that are shorter or longer than the map's.

    With diffusion only the times are known, because then each piece of water is one group.
    """

    median_hours: Annotated[Float[np.ndarray, "steps"], _hours]
    duration: Annotated[
        Float[np.ndarray, "steps"] | None,
        quantity("other_step", "duration of another step", "s"),
    ] = None
    "The second duration is that of the maps."
    groups: Annotated[Int[np.ndarray, "steps"] | None, _groups] = None
    groups_if_known: Annotated[Int[np.ndarray, "steps"] | None, _known] = None

    @classmethod
    def of(cls, surface: Layer) -> "StepSensitivity | None":
        """Map the surface with other steps; the result is `None` for large maps."""
        water, by, step = surface.water, surface.by, surface.behaviour.duration
        durations = [by.fitted(factor * step) for factor in _FACTORS]
        if water.cells * by.phases(durations[0]) > MOST_CELLS:
            return None

        def ends(seconds: float) -> LayerEnds:
            if np.isclose(seconds, step):
                return surface
            chain = drift_maps(water, by, surface.step.lasting(seconds))
            return LayerEnds(water, long_term_behaviour(chain, seconds))

        others = [*map(ends, durations)]
        hours = np.array([one.median_hours for one in others])
        if by.diffusivity:
            return cls(hours)
        groups = np.array([one.behaviour.groups.count for one in others])
        # With `rho` = 1 there is no disturbance, and each cell has one image.
        centres = dataclasses.replace(surface.step, rho=1.0, spread="turned")
        by_centres = group_counts(water, by, [centres.lasting(seconds) for seconds in durations])
        return cls(hours, np.array(durations), groups, by_centres)
