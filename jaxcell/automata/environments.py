import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Int32

from ..base.shown import Shown
from .filter import Filter, FilterState, Observations, digits


class Environments:
    """Open-world filters of several maps, which find the map that a robot is on (Alam 2018, 2.4.4).

    A robot bumps every third step in one ring, and every second step in the other:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> def ring(cells):
        ...     image = np.roll(np.arange(cells), -1)
        ...     return automata.Filter.of(automata.subset_construction(image, image == 0))
        ...
        >>> rooms = automata.Environments({"three": ring(3), "two": ring(2)})
        >>> known = rooms.run("100")
        >>> known.remaining, known.refuted_at
        (('three',), {'two': 2})
    """

    def __init__(self, filters: Mapping[str, Filter]):
        """Combine the filters of several maps; the keys of `filters` are the names of the maps.

        A trap is added to each closed-world filter.

        **Raises:** `ValueError` if there are no filters.
        """
        if not filters:
            raise ValueError("filters: expected at least one map")
        self.filters = {name: filter.with_trap() for name, filter in filters.items()}

    def start(self) -> "EnvironmentsState":
        """Return the state of all filters before the first observation."""
        return EnvironmentsState({name: filter.start() for name, filter in self.filters.items()})

    def run(self, observations: Observations) -> "EnvironmentsState":
        """Return the state of all filters after an observation string.

        **Raises:** `ValueError` with the index of an observation that is neither 0 nor 1.
        """
        state = self.start()
        for observation in digits(observations):
            state = state.observe(observation)
        return state


@dataclasses.dataclass(frozen=True, eq=False)
class EnvironmentsState(Shown):
    """The maps and configurations that are possible after some observations."""

    states: Mapping[str, FilterState]
    "The state of the filter of each map."

    def observe(self, observation: int) -> "EnvironmentsState":
        """Return the state after one more observation, 0 or 1."""
        return EnvironmentsState(
            {name: state.observe(observation) for name, state in self.states.items()}
        )

    @property
    def remaining(self) -> tuple[str, ...]:
        """The maps not yet refuted, in the order of `states`."""
        return tuple(name for name, state in self.states.items() if not state.refuted)

    @property
    def cells(self) -> dict[str, Int32[np.ndarray, "_"]]:
        """The possible configurations of the robot, for each map not yet refuted."""
        return {name: self.states[name].cells for name in self.remaining}

    @property
    def refuted_at(self) -> dict[str, int]:
        """For each refuted map, the index of the observation that refuted it."""
        return {
            name: state.refuted_at
            for name, state in self.states.items()
            if state.refuted_at is not None
        }
