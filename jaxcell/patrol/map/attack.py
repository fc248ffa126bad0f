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


# Where a robot may be as an attack begins.
_STARTS = ("uniform", "stationary", "worst")
# Of a probability: cells that differ by less are alike.
_ALIKE = 1e-9
# Targets that are gone through at once: their arrays, one number a cell and target, stay small.
_TARGETS = 512


def boundary(
    graph: Graph, view: Bool[np.ndarray, "*targets cells"]
) -> Bool[np.ndarray, "*targets cells"]:
    """Where a patroller that comes from outside first sees a target (Alam 2018, Fig. 4.3).

    **Arguments:**

    - `graph`: the cells and the ways between them.
    - `view`: the cells from which the target is seen, one row a target or for a single one.

    **Returns:** those of them that are next to one from which it is not.

    In a corridor of five cells, cell 0 is seen from itself and from cell 1, and a robot from
    outside comes by cell 1:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> patrol.boundary(graph, visible[:, 0]).nonzero()[0].tolist()
        [1]
    """
    beside = (~view).astype(np.float64) @ graph.matrix(np.ones(len(graph.edges)))
    return view & (beside > 0)


def outside(
    policies: Sequence[Policy], view: Bool[np.ndarray, "*targets cells"]
) -> Bool[np.ndarray, "robots *targets cells"]:
    """Where each robot may be when an attack begins: the cells that it walks on, out of view.

    **Arguments:**

    - `policies`: the policy of each robot.
    - `view`: the cells from which the target is seen, one row a target or for a single one.

    **Returns:** a mask over the cells for each robot, and for each target if `view` has a row each.

    In a corridor of five cells, cell 0 is out of view of a robot in cells 2 to 4:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> patrol.outside(policies, visible[:, 0]).tolist()
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
    """The cells where it depends on luck whether an attack succeeds.

    These are not the cells that a base station has in view, which it always watches, nor those that
    are out of sight wherever the robots walk, where an attack always succeeds.

    **Arguments:**

    - `visible`: which cells are seen from each, by a robot.
    - `policies`: the policy of each robot.
    - `regions`: those around a base station, if there is one.

    **Returns:** the cells, in order.

    The base station in the middle of a corridor of five cells sees 1 to 3, and only the ends are
    contested:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> regions = patrol.angular_regions(graph, 2, visible[2], 2)
        >>> policies = patrol.centralized_policies(graph, visible, regions)
        >>> patrol.contested(visible, policies, regions).tolist()
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
    """The probability of catching an adversary that attacks a cell, for every cell at once.

    The attack begins with each robot at any of its cells from which the target is not seen, by
    default with equal chance, and succeeds unless one is first where it is seen within the attack
    time (Alam 2018, section 4.4.6). The law of that time is exact: the robots are independent, and
    the probability that none has come is the product of those of each. A robot all of whose cells
    have the target in view has come already.

    **Arguments:**

    - `graph`: the cells and the ways between them.
    - `visible`: which cells are wholly visible from each, [`jaxcell.space.visible_cells`][].
    - `policies`: the policy of each robot.
    - `attack_times`: the steps that an attack takes, each at least 1.
    - `start`: where each robot is as the attack begins, out of view: with equal chance in any of
        its cells, `"uniform"`; as often as in the long run, `"stationary"`; or where it is least
        likely to come in time, `"worst"`, which an adversary chooses who sees the robots.

    **Returns:** one row an attack time. The smallest number of a row is at the cell that an
    adversary would choose, who knows the policies.

    **Raises:** `ValueError` for no robots, for attack times that are not whole numbers from 1, for
    an array that does not match the graph; `RuntimeError` where JAX is set to 32 bits.

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
        # The last chunk is full too, so that all have one shape.
        some = np.arange(min(first, cells - chunk), min(first, cells - chunk) + chunk)
        view = visible[some].T
        begins = shares(graph, policies, visible[some], start)
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
        caught[:, some] = np.maximum(0.0, 1 - survive)
    return caught


def weakest(
    caught: Float[np.ndarray, "times cells"], among: Int[np.ndarray, "some"]
) -> Int[np.ndarray, "times"]:
    """The cell of some where capture is least; of those that are alike but for rounding, the first.

    **Arguments:**

    - `caught`: the probability of capture at each cell.
    - `among`: the cells.
    """
    some = caught[:, among]
    alike = some <= some.min(axis=1, keepdims=True) + _ALIKE
    return among[alike.argmax(axis=1)]


def shares(
    graph: Graph,
    policies: Sequence[Policy],
    view: Bool[np.ndarray, "*targets cells"],
    start: str,
) -> list[Float[np.ndarray, "*targets cells"]]:
    """How often each robot begins where, out of view; for the worst start, where it may."""
    begins = []
    for policy, hidden in zip(policies, outside(policies, view), strict=True):
        share = hidden * (policy.share_of_time(graph) if start == "stationary" else 1.0)
        total = share.sum(axis=-1, keepdims=True)
        begins.append(share / np.where(total > 0, total, 1.0))
    return begins


def check_start(start: str) -> None:
    """**Raises:** `ValueError` for a start that is none."""
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
    """The probability that a robot from each cell is not in view of each of several targets.

    **Arguments:**

    - `late`: that up to some time.
    - `steps`: how much later.
    """
    stay = jnp.where(view, 0.0, 1.0)
    leaving = chain.leaving[:, None]
    pull = jax.vmap(chain.pull, in_axes=1, out_axes=1)
    return jax.lax.fori_loop(0, steps, lambda _, value: stay * (pull(value) + leaving), late)
