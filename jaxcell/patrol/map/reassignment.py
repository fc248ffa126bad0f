import dataclasses
from typing import Annotated, ClassVar

import jax
import numpy as np
import scipy.optimize
from jaxtyping import Bool, Float, Int

from ...base.quantities import Result, derived, quantity
from ...markov.passage import survivals
from ...optimize import GraphLike
from .policies import Policy, centralized_policies, of_policies
from .regions import Regions, angular_regions


# Number of steps computed at once.
_CHUNK = 256
_MAX_STEPS = 2**20


@dataclasses.dataclass(frozen=True, eq=False)
class Reassignment(Result):
    """The new region and walk of each robot after another robot has stopped reporting."""

    title: ClassVar[str] = "Regions without a robot"

    silence_limit: Annotated[
        int, quantity("", "steps of silence that mean a loss", "steps", kind="count")
    ]
    regions: Regions
    robot: Annotated[
        Int[np.ndarray, "regions"],
        quantity("region", "robot that takes the region", kind="index", listed=True),
    ]
    policies: tuple[Policy, ...]

    sizes = of_policies("cells.size", "region", "cells of each region", kind="count", listed=True)
    weight = of_policies("weights", "region edge", "share of steps on the edge", "1", kind="share")

    @derived("region", "mean commute time between cells", "steps", kind="time", listed=True)
    def commute_times(self) -> Float[np.ndarray, "regions"]:
        return np.array([policy.commute_time for policy in self.policies])


def silence_limit(policy: Policy, alpha: float = 0.01) -> int:
    """Compute the number of steps without a report that a working robot hardly ever exceeds.

    The result is the least `t` such that, from any cell of its region, the robot misses its contact
    cell in the next `t` steps with a probability of at most `alpha`. From the contact cell itself,
    only a return counts as a visit.

    **Arguments:** the policy of a robot with a contact cell; and the probability of a false alarm,
    more than 0 and less than 1. **Returns:** the number of steps.

    A robot that alternates between two cells reports in every second step:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> regions = patrol.map.angular_regions(graph, 2, visible[2], 2)
        >>> policies = patrol.map.centralized_policies(graph, visible, regions)
        >>> patrol.map.silence_limit(policies[0])
        2
    """
    if policy.contact is None:
        raise ValueError("policy: expected a policy with a contact cell, where the robot reports")
    if not 0 < alpha < 1:
        raise ValueError(f"alpha: expected a probability, more than 0 and less than 1, got {alpha}")
    there = np.arange(policy.chain.cells) == policy.contact
    there, value = jax.device_put((there, (~there).astype(np.float64)))
    first = policy.chain.to_scipy()[[policy.contact]]
    for steps in range(0, _MAX_STEPS, _CHUNK):
        values, value = survivals(policy.chain, there, value, _CHUNK)
        before = np.asarray(values)
        after = np.concatenate([before[1:], np.asarray(value)[None]])
        back = before[:, first.indices] @ first.data
        late = np.maximum(after[:, policy.cells].max(axis=1), back)
        if late[-1] <= alpha:
            return steps + int(np.argmax(late <= alpha)) + 1
    raise RuntimeError(
        f"silence_limit: after {_MAX_STEPS} steps the robot has still not visited cell "
        f"{policy.contact} with probability {late[-1]:.3g}; expected at most {alpha}"
    )


def reassign(
    graph: GraphLike,
    visible: Bool[np.ndarray, "cells cells"],
    regions: Regions,
    policies: tuple[Policy, ...],
    lost: int,
    *,
    share: float = 0.8,
    alpha: float = 0.01,
) -> Reassignment:
    """Compute new regions and policies for the remaining robots when one robot stops reporting.

    Alam 2018, section 6.3, leaves this to future work. The base station keeps its place and divides
    the map among the remaining robots. The assignment of regions lets the robots keep as many of
    their cells as possible in total. Each robot is informed at its next report.

    **Arguments:**

    - `graph`, `visible`, `share`: as in [`centralized_policies`][].
    - `regions`, `policies`: the old region and policy of each robot.
    - `lost`: the robot that has stopped reporting.
    - `alpha`: as in [`silence_limit`][].

    **Returns:** [`Reassignment`][].

    Two robots around a base station at cell 2 of a room of 5 x 2 cells. Robot 1 falls silent, and
    robot 0 gets the only remaining region:

        >>> from jaxcell import patrol, space
        >>> room = space.Workspace([(0, 0), (5, 0), (5, 2), (0, 2)])
        >>> cells = space.CellSpace.of(room, 1.0, 1)
        >>> graph, visible = patrol.cell_graph(cells), space.visible_cells(cells, 2.2)
        >>> regions = patrol.map.angular_regions(graph, 2, visible[2], 2)
        >>> policies = patrol.map.centralized_policies(graph, visible, regions)
        >>> new = patrol.map.reassign(graph, visible, regions, policies, lost=1)
        >>> regions.count, new.regions.count, new.robot.tolist()
        (2, 1, [0])
    """
    if len(policies) != regions.count:
        raise ValueError(f"policies: expected {regions.count}, one per region, got {len(policies)}")
    if not 0 <= lost < regions.count:
        raise ValueError(f"lost: robot {lost} does not exist; robots are 0 to {regions.count - 1}")
    if regions.count == 1:
        raise ValueError("lost: robot 0 is the only robot; expected another to patrol")
    after = silence_limit(policies[lost], alpha)
    left = np.delete(np.arange(regions.count), lost)
    new = angular_regions(graph, regions.base, regions.view, left.size)
    kept = [
        [np.count_nonzero((new.region == k) & (regions.region == i)) for i in left]
        for k in range(new.count)
    ]
    _, taken = scipy.optimize.linear_sum_assignment(kept, maximize=True)
    return Reassignment(
        after, new, left[taken].astype(np.int32), centralized_policies(graph, visible, new, share)
    )
