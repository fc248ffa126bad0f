import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.certificate import Numbers
from ...base.shown import Shown
from ...optimize import Graph, GraphLike
from .policies import Policy
from .regions import Regions, check_visible


_STARTS = ("stationary", "uniform", "worst")


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Attack(Shown):
    """Attacks on cells of a map: their durations, and the places of robots at the start."""

    times: Int[np.ndarray, "times"]
    "Numbers of steps that an attack may take."
    start: str
    """The distribution of each robot, when an attack begins, over its cells out of view of the
    target. `stationary`: the shares of time in the long run. `uniform`: equal probabilities, as for
    robots that have just been placed. `worst`: the cell from which the robot is least likely to
    arrive in time, for an adversary who sees the robots."""

    def __init__(self, times: Any, start: str = "stationary") -> None:
        """Create attacks that take the given numbers of steps; `start` says where robots begin."""
        given = np.atleast_1d(np.asarray(times))
        if given.size == 0 or not np.issubdtype(given.dtype, np.integer):
            raise ValueError(f"times: expected whole numbers of steps, got {times!r}")
        if given.min() < 1:
            raise ValueError(f"times: expected at least 1 step, got {given.min()}")
        if start not in _STARTS:
            raise ValueError(f"start: expected one of {', '.join(_STARTS)}, got {start!r}")
        object.__setattr__(self, "times", given.astype(np.int32))
        object.__setattr__(self, "start", start)

    @property
    def first(self) -> "Attack":
        """A copy of this attack with only the first of its times."""
        return Attack(self.times[:1], self.start)

    def begins(
        self, graph: Graph, policies: Sequence[Policy], view: Bool[np.ndarray, "*targets cells"]
    ) -> list[Float[Numbers, "*targets cells"]]:
        """Compute the distribution of each robot over its cells out of view when an attack begins.

        `view` is the mask of the cells from which a target is seen, one row per target. For the
        start `worst`, cells out of view are equally probable, and callers choose the worst cell.
        """
        begins = []
        for policy, hidden in zip(policies, outside(policies, view), strict=True):
            share = hidden * 1.0
            if self.start == "stationary":
                # Each target has a row.
                rows = (1,) * (share.ndim - 1)
                share = share * policy.share_of_time(graph).reshape(*rows, -1)
            total = share.sum(axis=-1, keepdims=True)
            begins.append(share / (total + (total == 0).astype(float)))
        return begins


def boundary(
    graph: GraphLike, view: Bool[np.ndarray, "*targets cells"]
) -> Bool[np.ndarray, "*targets cells"]:
    """Return the cells where a patroller from outside first sees a target (Alam 2018, Fig. 4.3).

    **Arguments:** the graph of the cells; and the cells from which the target is seen, one row per
    target, or a single row. **Returns:** the cells in view that are next to a cell out of view.

    In a corridor of five cells, cell 0 is seen from cells 0 and 1; robots enter the view at cell 1:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> patrol.map.boundary(graph, visible[:, 0]).nonzero()[0].tolist()
        [1]
    """
    beside = (~view).astype(np.float64) @ graph.matrix(np.ones(len(graph.edges)))
    return view & (beside > 0)


def outside(
    policies: Sequence[Policy], view: Bool[np.ndarray, "*targets cells"]
) -> Bool[np.ndarray, "robots *targets cells"]:
    """Return the cells where each robot may be when an attack begins: its own cells out of view.

    **Arguments:** the policy of each robot; and the cells from which the target is seen, one row
    per target, or a single row. **Returns:** a mask over the cells for each robot and each row.

    In a corridor of five cells, cell 0 is out of view of a robot in cells 2 to 4:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> patrol.map.outside(policies, visible[:, 0]).tolist()
        [[False, False, True, True, True]]
    """
    cells = np.arange(view.shape[-1])
    walked = np.stack([np.isin(cells, policy.cells) for policy in policies])
    return ~view & walked.reshape(len(policies), *(1,) * (view.ndim - 1), -1)


def contested(
    visible: Bool[np.ndarray, "cells cells"],
    policies: Sequence[Policy],
    regions: Regions | None = None,
) -> Int[np.ndarray, "targets"]:
    """Return the cells where an attack may succeed or fail.

    Cells in view of a base station are excluded, because attacks on them always fail. Cells that no
    robot can see on its walk are excluded, because attacks on them always succeed.

    **Arguments:** `visible[i, j]` is true if a robot in cell `i` sees cell `j`; the policy of each
    robot; and the regions around a base station, if any. **Returns:** the cells, in order.

    The base station in the middle of a corridor of five cells sees all cells except the ends:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> regions = patrol.map.angular_regions(graph, 2, visible[2], 2)
        >>> policies = patrol.map.centralized_policies(graph, visible, regions)
        >>> patrol.map.contested(visible, policies, regions).tolist()
        [0, 4]
    """
    walked = np.unique(np.concatenate([policy.cells for policy in policies]))
    open_ = visible[walked].any(axis=0)
    if regions is not None:
        open_ &= ~regions.view
    return np.flatnonzero(open_).astype(np.int32)


def check_policies(
    graph: Graph, visible: Bool[np.ndarray, "rows cells"], policies: Sequence[Policy]
) -> None:
    check_visible(graph, visible)
    if not policies:
        raise ValueError("policies: expected one for each robot, got none")
    for robot, policy in enumerate(policies):
        if policy.chain.cells != graph.vertices:
            raise ValueError(
                f"policies: the policy of robot {robot} is for {policy.chain.cells} cells, and the "
                f"graph has {graph.vertices}"
            )
