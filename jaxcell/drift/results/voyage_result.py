import dataclasses
import functools
from typing import Annotated

import numpy as np
import numpy.typing as npt
from jaxtyping import Float, Int

from ...base.quantities import Result, derived, from_part, quantity
from ..layered_cells import Sea
from ..voyage_policies import Voyage


_squares = functools.partial(derived, "layer y x")


@dataclasses.dataclass(frozen=True, eq=False)
class SeaVoyage(Result):
    """The voyages to a goal under one policy, with probabilities and times of arrival."""

    sea: Sea
    policy: Voyage
    hours: float
    "The duration of a step, in hours."
    goal: Annotated[
        tuple[float, float, float],
        quantity("place", "longitude, latitude and depth of the goal", listed=True),
    ]
    start: int | None = None
    "The cell where a drifter is dropped; `None` if there is no start."

    @property
    def arrives(self) -> bool:
        """True if a drifter from the start may arrive, or if there is no start."""
        return self.start_probability is None or self.start_probability > 0

    @derived("", "probability of arriving from the start", kind="share")
    def start_probability(self) -> float | None:
        return self._at_start(self.policy.probability)

    @derived("", "time from the start; infinite if it may fail", "h", kind="time")
    def start_hours(self) -> float | None:
        return self._at_start(np.asarray(self.policy.time) * self.hours)

    @derived("", "time from the start, if it arrives", "h", kind="time")
    def start_hours_if_it_arrives(self) -> float | None:
        return self._at_start(np.asarray(self.policy.conditional_time) * self.hours)

    def _at_start(self, values: npt.ArrayLike) -> float | None:
        return None if self.start is None else float(np.asarray(values)[self.start])

    @derived("", "probability of arriving, mean over all cells", kind="share")
    def mean_probability(self) -> float:
        return float(np.asarray(self.policy.probability).mean())

    @derived("", "cells that arrive for sure", kind="count")
    def cells_that_arrive_for_sure(self) -> int:
        return int((np.asarray(self.policy.probability) == 1).sum())

    @derived("", "mean time of these cells", "h", kind="time")
    def their_mean_hours(self) -> float:
        sure = np.asarray(self.policy.probability) == 1
        return float(np.asarray(self.policy.time)[sure].mean()) * self.hours

    @derived("", "choices of a policy", kind="count")
    def iterations(self) -> int | None:
        return None if self.policy.value is None else self.policy.certificate.iterations

    @derived("", "bound of the error of a value, relative to the largest", kind="residual")
    def value_error(self) -> float | None:
        return None if self.policy.value is None else self.policy.certificate.residual

    policy_certified = from_part(
        "policy.certificate.converged", "", "whether the policy is certified", kind="flag"
    )
    times_certified = from_part(
        "policy.arrival.converged", "", "whether all times are certified", kind="flag"
    )

    @_squares(
        "action of the drifter",
        padding="-2: no water",
        meaning_of_values="-1: up, 0: drift, 1: down",
    )
    def action(self) -> Int[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(self.policy.action, -2)

    @_squares("value function", "1", padding="NaN: no water")
    def value(self) -> Float[np.ndarray, "layers rows columns"] | None:
        return None if self.policy.value is None else self.sea.on_squares(self.policy.value)

    @_squares("probability of arriving", "1", kind="share", padding="NaN: no water")
    def arrival_probability(self) -> Float[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(self.policy.probability)

    @_squares("expected time to arrive; inf where it may fail", "h", kind="time")
    def arrival_time(self) -> Float[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(np.asarray(self.policy.time) * self.hours)

    @_squares("expected time to arrive, if it arrives", "h", kind="time")
    def conditional_arrival_time(self) -> Float[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(np.asarray(self.policy.conditional_time) * self.hours)
