import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Bool, Float, Int

from ...base.precision import require_x64
from ...base.quantities import PROBABILITY, Checks, Result, derived, quantity
from ...mapping import Chain
from ...markov import Arrivals, first_arrival, simulate_arrival
from ...optimize import Graph
from ..law.fit import GldFit, fit_gld
from .policies import Policy
from .regions import check_visible


# Targets that are gone through at once: their arrays, one number a cell and target, stay small.
_TARGETS = 512


@dataclasses.dataclass(frozen=True, eq=False)
class Vulnerability(Result):
    """How likely robots catch an adversary that attacks one cell, found in three ways."""

    title: ClassVar[str] = "Vulnerability of a cell"
    tables: ClassVar[Mapping[str, str]] = {"attack_time": "probabilities"}

    target: Annotated[int, quantity("", "cell that is attacked", kind="place")]
    view: Annotated[
        Bool[np.ndarray, "cells"],
        quantity("position", "whether the target is seen from there", kind="flag"),
    ]
    "As in the source, these are the cells that are wholly visible from the target."
    boundary: Annotated[
        Bool[np.ndarray, "cells"],
        quantity("position", "whether a robot from outside first sees it there", kind="flag"),
    ]
    attack_times: Int[np.ndarray, "times"]
    "The steps that an attack takes."
    exact: Annotated[
        Float[np.ndarray, "times"],
        quantity("attack_time", "probability of capture, exactly", "1", kind="share"),
    ]
    "The probability that a robot is in view of the target within that time."
    simulated: Annotated[
        Float[np.ndarray, "times"],
        quantity("attack_time", "share of simulated runs", "1", kind="share"),
    ]
    fitted: Annotated[
        Float[np.ndarray, "times"], quantity("attack_time", "by the law that is fitted", "1")
    ]
    "What the generalized lambda distribution that fits these runs says; NaN without one."
    law: Annotated[
        Float[np.ndarray, "steps"],
        quantity("step", "probability that the first robot is in view then", "1", kind="share"),
    ]
    "After `0, 1, ...` steps, to the longest attack."
    arrivals: Arrivals
    "The simulated runs."
    fit: GldFit | None
    "The fit to them."
    failure: Annotated[str | None, quantity("", "why no law is fitted")]

    @derived("attack_time", "steps of an attack", "steps", kind="coordinate")
    def attack_time(self) -> Int[np.ndarray, "times"]:
        return self.attack_times

    @derived("attack_time", "fitted less exact", "1")
    def fit_gap(self) -> Float[np.ndarray, "times"]:
        return self.fitted - self.exact

    @derived("run", "time until a robot is in view; infinite if given up", "steps", kind="time")
    def arrival(self) -> Float[np.ndarray, "runs"]:
        return np.asarray(self.arrivals.time)

    @derived("", "cells from which it is seen", kind="count")
    def cells_in_view(self) -> int:
        return int(self.view.sum())

    @derived("", "cells where a robot from outside first sees it", kind="count")
    def cells_of_boundary(self) -> int:
        return int(self.boundary.sum())

    def checks(self) -> Checks:
        runs = self.arrival.size
        spread = np.sqrt(np.maximum(self.exact * (1 - self.exact), 1 / runs) / runs)
        off = np.abs(np.cumsum(self.law)[self.attack_times] - self.exact)
        return {
            "exact_is_of_law": (float(off.max()), PROBABILITY),
            "law_beyond_1": (float(max(self.law.sum() - 1, 0.0)), PROBABILITY),
            "simulated_standard_deviations": (
                float((np.abs(self.simulated - self.exact) / spread).max()),
                np.inf,
            ),
        }


def vulnerability(
    key: jax.Array,
    graph: Graph,
    visible: Bool[np.ndarray, "cells cells"],
    policies: Sequence[Policy],
    target: int,
    attack_times: npt.ArrayLike,
    *,
    runs: int = 5000,
) -> Vulnerability:
    """How vulnerable one cell is (Alam 2018, section 4.4.6, Tables 4.6 and 4.7).

    The source simulates the time until the first robot is where the target is seen, fits a
    generalized lambda distribution to it, and reads the probabilities off that. They stand beside
    the exact ones here, so that one sees what the fit costs.

    **Arguments:**

    - `key`: of `jax.random`, for the simulation.
    - `graph`, `visible`, `policies`, `attack_times`: as in [`capture_probabilities`][].
    - `target`: the cell that is attacked.
    - `runs`: how often to simulate.

    **Returns:** [`Vulnerability`][].

    **Raises:** as [`capture_probabilities`][]; `ValueError` for a target that does not exist, and
    for fewer than two runs.

    One robot in a corridor of five cells, against attacks on cell 0 of one and of six steps. Five
    runs are too few for a fit:

        >>> import jax, numpy as np
        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([(i, i + 1) for i in range(4)], xy=[(i, 0) for i in range(5)])
        >>> visible = np.abs(np.subtract.outer(range(5), range(5))) <= 1
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> attack = jax.random.key(0), graph, visible, policies, 0, [1, 6]
        >>> found = patrol.vulnerability(*attack, runs=5)
        >>> found.exact.round(3).tolist(), found.fit
        ([0.167, 0.748], None)
        >>> found.failure
        'samples: expected at least 8, with 5 different values, got 5 with 4'
    """
    times = check_attack_times(attack_times)
    _check(graph, visible, policies)
    if not 0 <= target < graph.vertices:
        raise ValueError(
            f"target: cell {target} does not exist; cells are 0 to {graph.vertices - 1}"
        )
    view = visible[target]
    starts = [
        start if start.any() else np.isin(np.arange(view.size), policy.cells)
        for policy, start in zip(policies, outside(policies, view), strict=True)
    ]
    chains = [policy.chain for policy in policies]
    law = np.asarray(first_arrival(chains, starts, view, int(times.max())))
    arrivals = simulate_arrival(key, chains, starts, view, runs)
    arrived = np.asarray(arrivals.time)
    fit, failure = None, None
    try:
        fit = fit_gld(arrived, censored=True)
    except (ValueError, RuntimeError) as error:
        failure = str(error)
    # A whole number of steps stands for the interval of length 1 around it.
    fitted = np.full(times.size, np.nan) if fit is None else np.asarray(fit.law.cdf(times + 0.5))
    return Vulnerability(
        target=target,
        view=view,
        boundary=boundary(graph, view),
        attack_times=times,
        exact=np.cumsum(law)[times],
        simulated=(arrived[:, None] <= times).mean(axis=0),
        fitted=fitted,
        law=law,
        arrivals=arrivals,
        fit=fit,
        failure=failure,
    )


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

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([(i, i + 1) for i in range(4)], xy=[(i, 0) for i in range(5)])
        >>> visible = np.abs(np.subtract.outer(range(5), range(5))) <= 1
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

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([(i, i + 1) for i in range(4)], xy=[(i, 0) for i in range(5)])
        >>> visible = np.abs(np.subtract.outer(range(5), range(5))) <= 1
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> patrol.outside(policies, visible[:, 0]).tolist()
        [[False, False, True, True, True]]
    """
    cells = np.arange(view.shape[-1])
    walked = np.stack([np.isin(cells, policy.cells) for policy in policies])
    return ~view & walked.reshape(len(policies), *(1,) * (view.ndim - 1), -1)


def capture_probabilities(
    graph: Graph,
    visible: Bool[np.ndarray, "cells cells"],
    policies: Sequence[Policy],
    attack_times: npt.ArrayLike,
) -> Float[np.ndarray, "times cells"]:
    """The probability of catching an adversary that attacks a cell, for every cell at once.

    The attack begins with each robot at any of its cells from which the target is not seen, with
    equal chance, and succeeds unless one is first where it is seen within the attack time (Alam
    2018, section 4.4.6). The law of that time is exact: the robots are independent, and the
    probability that none has come is the product of those of each. A robot all of whose cells have
    the target in view has come already.

    **Arguments:**

    - `graph`: the cells and the ways between them.
    - `visible`: which cells are wholly visible from each, [`jaxcell.space.visible_cells`][].
    - `policies`: the policy of each robot.
    - `attack_times`: the steps that an attack takes, each at least 1.

    **Returns:** one row an attack time. The smallest number of a row is at the cell that an
    adversary would choose, who knows the policies.

    **Raises:** `ValueError` for no robots, for attack times that are not whole numbers from 1, for
    an array that does not match the graph; `RuntimeError` where JAX is set to 32 bits.

    One robot in a corridor of five cells, against attacks of one and of six steps:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([(i, i + 1) for i in range(4)], xy=[(i, 0) for i in range(5)])
        >>> visible = np.abs(np.subtract.outer(range(5), range(5))) <= 1
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> patrol.capture_probabilities(graph, visible, policies, [1, 6]).round(3).tolist()
        [[0.167, 0.4, 1.0, 0.4, 0.167], [0.748, 0.992, 1.0, 0.992, 0.748]]
    """
    require_x64("capture_probabilities")
    times = check_attack_times(attack_times)
    _check(graph, visible, policies)
    cells = graph.vertices
    chunk = min(_TARGETS, cells)
    caught = np.empty((times.size, cells))
    for first in range(0, cells, chunk):
        # The last chunk is full too, so that all have one shape.
        some = np.arange(min(first, cells - chunk), min(first, cells - chunk) + chunk)
        starts = outside(policies, visible[some])
        survive = np.ones((times.size, chunk))
        for policy, start in zip(policies, starts, strict=True):
            share = start / np.maximum(start.sum(axis=1, keepdims=True), 1)
            alone = _survival(
                policy.chain,
                jnp.asarray(visible[some].T),
                jnp.asarray(share.T),
                int(times.max()),
            )
            survive *= np.asarray(alone)[times]
        caught[:, some] = 1 - survive
    return caught


def _check(
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


@functools.partial(jax.jit, static_argnames="steps")
def _survival(
    chain: Chain,
    view: Bool[Array, "cells targets"],
    share: Float[Array, "cells targets"],
    steps: int,
) -> Float[Array, "{steps}+1 targets"]:
    """The probability by each time that a robot has not been in view of each of several targets."""
    stay = jnp.where(view, 0.0, 1.0)
    leaving = chain.leaving[:, None]
    pull = jax.vmap(chain.pull, in_axes=1, out_axes=1)

    def step(value, _):  # type: ignore[no-untyped-def]
        return stay * (pull(value) + leaving), jnp.sum(share * value, axis=0)

    return jax.lax.scan(step, stay, length=steps + 1)[1]
