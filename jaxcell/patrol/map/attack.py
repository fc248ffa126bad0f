from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Bool, Float, Int

from ...base.precision import require_x64
from ...mapping import Chain
from ...optimize import Graph
from .policies import Policy
from .regions import Regions, check_visible


# The places where a robot may be as an attack begins.
_STARTS = ("uniform", "stationary", "worst")
# Probabilities of capture that differ by less are equal.
_ALIKE = 1e-9
# The number of targets computed at once: their arrays, one number per cell and target, stay small.
_TARGETS = 512


def boundary(
    graph: Graph, view: Bool[np.ndarray, "*targets cells"]
) -> Bool[np.ndarray, "*targets cells"]:
    """Return the cells where a patroller from outside first sees a target (Alam 2018, Fig. 4.3).

    **Arguments:**

    - `graph`: the cells and the edges between them.
    - `view`: the cells from which the target is seen, one row per target, or a single row.

    **Returns:** the cells in view that are next to a cell out of view.

    In a corridor of five cells, cell 0 is seen from cells 0 and 1; robots enter by cell 1:

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

    **Arguments:**

    - `policies`: the policy of each robot.
    - `view`: the cells from which the target is seen, one row per target, or a single row.

    **Returns:** a mask over the cells for each robot, and for each target if `view` has several.

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

    Cells that a base station has in view are excluded, because it always watches them, and so are
    cells that no robot can see from its walk, where an attack always succeeds.

    **Arguments:**

    - `visible`: which cells a robot sees from each cell.
    - `policies`: the policy of each robot.
    - `regions`: the regions around a base station, or `None`.

    **Returns:** the cells, in order.

    The base station in the middle of a corridor of five cells sees all but the ends:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> regions = patrol.map.angular_regions(graph, 2, visible[2], 2)
        >>> policies = patrol.map.centralized_policies(graph, visible, regions)
        >>> patrol.map.contested(visible, policies, regions).tolist()
        [0, 4]
    """
    walked = np.unique(np.concatenate([policy.cells for policy in policies]))
    open_ = visible[:, walked].any(axis=1)
    if regions is not None:
        open_ &= ~regions.view
    return np.flatnonzero(open_).astype(np.int32)


def capture_probabilities(
    graph: Graph,
    visible: Bool[np.ndarray, "cells cells"],
    policies: Sequence[Policy],
    attack_times: npt.ArrayLike,
    start: str = "uniform",
) -> Float[np.ndarray, "times cells"]:
    """Compute the probability of capturing an adversary that attacks a cell, for every cell.

    The attack begins with each robot in a cell from which the target is not seen, by default with
    equal probability, and fails if a robot sees the target within the attack time (Alam 2018,
    section 4.4.6). The law of that time is exact, a product over the independent robots. A robot
    that sees the target from all of its cells has arrived at once.

    **Arguments:**

    - `graph`: the cells and the edges between them.
    - `visible`: which cells are wholly visible from each cell, [`jaxcell.space.visible_cells`][].
    - `policies`: the policy of each robot.
    - `attack_times`: number of steps that an attack takes, each at least 1.
    - `start`: distribution of each robot over its cells out of view as the attack begins: equal
        probabilities, `"uniform"`; its share of time in the long run, `"stationary"`; or the cell
        from which it is least likely to arrive in time, `"worst"`, if the adversary sees the
        robots.

    **Returns:** one row per attack time. The smallest number of a row is at the cell that an
    adversary chooses who knows the policies.

    **Raises:** `ValueError` for wrong arguments; `RuntimeError` where JAX is set to 32 bits.

    One robot in a corridor of five cells, against attacks of one and of six steps:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> patrol.capture_probabilities(graph, visible, policies, [1, 6]).round(3).tolist()
        [[0.167, 0.4, 1.0, 0.4, 0.167], [0.748, 0.992, 1.0, 0.992, 0.748]]
    """
    require_x64("capture_probabilities")
    times = check_attack_times(attack_times)
    check_start(start)
    check_policies(graph, visible, policies)
    cells = graph.vertices
    chunk = min(_TARGETS, cells)
    # Robots that move alike share their chain.
    chains = {id(policy.chain): policy.chain for policy in policies}
    caught = np.empty((times.size, cells))
    for first in range(0, cells, chunk):
        # The last chunk is full too, so that all chunks have one shape.
        targets = np.arange(min(first, cells - chunk), min(first, cells - chunk) + chunk)
        view = visible[targets].T
        begins = shares(graph, policies, visible[targets], start)
        survive = np.ones((times.size, chunk))
        late, before = dict.fromkeys(chains, np.where(view, 0.0, 1.0)), 0
        for time in np.unique(times):
            late = {
                key: np.asarray(_later(chain, view, late[key], time - before))
                for key, chain in chains.items()
            }
            before = time
            for policy, share in zip(policies, begins, strict=True):
                each = late[id(policy.chain)]
                if start == "worst":
                    alone = np.where(share.T > 0, each, 0.0).max(axis=0)
                else:
                    alone = (share.T * each).sum(axis=0)
                survive[times == time] *= alone
        caught[:, targets] = np.maximum(0.0, 1 - survive)
    return caught


def weakest(
    caught: Float[np.ndarray, "times cells"], among: Int[np.ndarray, "some"]
) -> Int[np.ndarray, "times"]:
    """Find the cell where capture is least; among equals up to rounding, the first.

    **Arguments:**

    - `caught`: the probability of capture at each cell.
    - `among`: the cells to choose from.
    """
    chosen = caught[:, among]
    alike = chosen <= chosen.min(axis=1, keepdims=True) + _ALIKE
    return among[alike.argmax(axis=1)]


def shares(
    graph: Graph,
    policies: Sequence[Policy],
    view: Bool[np.ndarray, "*targets cells"],
    start: str,
) -> list[Float[np.ndarray, "*targets cells"]]:
    """Compute the distribution of each robot over its cells out of view as an attack begins."""
    begins = []
    for policy, hidden in zip(policies, outside(policies, view), strict=True):
        share = hidden * (policy.share_of_time(graph) if start == "stationary" else 1.0)
        total = share.sum(axis=-1, keepdims=True)
        begins.append(share / np.where(total > 0, total, 1.0))
    return begins


def check_start(start: str) -> None:
    """**Raises:** `ValueError` for an unknown start."""
    if start not in _STARTS:
        raise ValueError(f"start: expected one of {', '.join(_STARTS)}, got {start!r}")


def check_policies(
    graph: Graph, visible: Bool[np.ndarray, "rows cells"], policies: Sequence[Policy]
) -> None:
    check_visible(graph, visible)
    if not policies:
        raise ValueError("policies: expected one for each robot, got none")
    for robot, policy in enumerate(policies):
        if policy.chain.cells != graph.vertices:
            raise ValueError(
                f"policies: that of robot {robot} is for {policy.chain.cells} cells, and the graph "
                f"has {graph.vertices}"
            )


def check_attack_times(attack_times: npt.ArrayLike) -> Int[np.ndarray, "times"]:
    """**Raises:** `ValueError` for attack times that are not whole numbers from 1."""
    given = np.atleast_1d(np.asarray(attack_times))
    if given.size == 0 or not np.issubdtype(given.dtype, np.integer):
        raise ValueError(f"attack_times: expected whole numbers of steps, got {attack_times!r}")
    if given.min() < 1:
        raise ValueError(f"attack_times: expected at least 1 step, got {given.min()}")
    return given.astype(np.int32)


@jax.jit
def _later(
    chain: Chain,
    view: Bool[Array, "cells targets"],
    late: Float[Array, "cells targets"],
    steps: int | Int[Array, ""],
) -> Float[Array, "cells targets"]:
    """Compute the probability that a robot from each cell has not seen each target.

    **Arguments:**

    - `late`: that probability for an earlier time.
    - `steps`: number of steps after that time.
    """
    stay = jnp.where(view, 0.0, 1.0)
    leaving = chain.leaving[:, None]
    pull = jax.vmap(chain.pull, in_axes=1, out_axes=1)
    return jax.lax.fori_loop(0, steps, lambda _, value: stay * (pull(value) + leaving), late)
