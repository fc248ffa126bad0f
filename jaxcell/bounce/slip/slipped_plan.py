import dataclasses
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Float

from ...base.formatting import percent
from ...base.quantities import Checks, derived, quantity
from ..plans.plan import Plan


@dataclasses.dataclass(frozen=True, eq=False)
class SlippedPlan(Plan):
    """A plan to a goal, its probability of success if the robot slips, and a policy to the goal."""

    title: ClassVar[str] = "Plan of a bouncing robot that slips"

    fine_cells: Annotated[int, quantity("", "fine cells", kind="count")]
    plan_runs: Annotated[
        int, quantity("", "simulated runs of the plan, without cells", kind="count")
    ]
    plan_as_foretold: Annotated[
        float, quantity("", "probability that all observations are those of the plan", kind="share")
    ]
    plan_arrives: Annotated[
        float,
        quantity("", "probability that the robot is at the goal after the plan", kind="share"),
    ]
    plan_arrives_from: Annotated[
        float, quantity("", "lower bound of that probability (99 %)", kind="share")
    ]
    plan_arrives_to: Annotated[
        float, quantity("", "upper bound of that probability (99 %)", kind="share")
    ]
    policy_surely_arrives: Annotated[
        bool,
        quantity("", "whether the best policy surely arrives, given the fine cell", kind="flag"),
    ]
    policy_mean_steps: Annotated[
        float, quantity("", "mean observations, among fine cells, until arrival", kind="time")
    ]
    policy_arrival: Annotated[
        Float[np.ndarray, "observations"],
        quantity(
            "observation",
            "probability, among fine cells, that the policy has arrived",
            kind="share",
        ),
    ]
    simulated_runs: Annotated[int, quantity("", "runs of the emulated robot", kind="count")]
    simulated_plan_arrives: Annotated[
        float, quantity("", "share of runs in which the plan arrives", kind="share")
    ]
    simulated_policy_arrives: Annotated[
        float, quantity("", "share of runs in which the policy arrives", kind="share")
    ]
    simulated_policy_steps: Annotated[
        float, quantity("", "mean observations of the runs that arrive", kind="time")
    ]

    @property
    def answered(self) -> bool:
        return self.found or self.policy_surely_arrives

    @property
    def answer(self) -> tuple[str, ...]:
        surely = "surely arrives" if self.policy_surely_arrives else "does not surely arrive"
        policy = f"The best policy {surely}."
        if not self.found:
            return *super().answer, policy
        low, high = percent(self.plan_arrives_from), percent(self.plan_arrives_to)
        return (
            f"With slip this plan arrives with a probability of {percent(self.plan_arrives)} (99 % "
            f"of estimates: {low} to {high}); {policy[0].lower()}{policy[1:]}",
            *super().answer,
        )

    @derived("", "probability, among fine cells, of arriving as soon as the plan", kind="share")
    def policy_arrives_as_soon(self) -> float:
        return float(self.policy_arrival[min(self.actions.size, self.policy_arrival.size - 1)])

    def checks(self) -> Checks:
        # A robot that arrives has the observations of the plan.
        more = max(0.0, self.plan_arrives - self.plan_as_foretold)
        falls = max(0.0, float(-np.diff(self.policy_arrival).min(initial=0)))
        return {
            **super().checks(),
            "plan_arrives_unforetold": (more, 1e-12),
            "arrivals_taken_back": (falls, 1e-12),
        }
