import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.quantities import PROBABILITY, Checks, Result, derived, quantity
from ...markov import Arrivals, first_arrival, simulate_arrival
from ...optimize import Graph, GraphLike
from ..law.fit import GldFit, fit_gld
from ..team.times import check_vertex
from .attack import Attack, boundary, check_policies
from .policies import Policy


@dataclasses.dataclass(frozen=True, eq=False)
class Vulnerability(Result):
    """The probability of capturing an adversary that attacks one cell, computed in three ways."""

    title: ClassVar[str] = "Vulnerability of a cell"
    tables: ClassVar[Mapping[str, str]] = {"attack_time": "probabilities"}

    target: Annotated[int, quantity("", "cell that is attacked", kind="place")]
    view: Annotated[
        Bool[np.ndarray, "cells"],
        quantity("position", "whether the target is seen from there", kind="flag"),
    ]
    boundary: Annotated[
        Bool[np.ndarray, "cells"],
        quantity("position", "whether a robot from outside first sees it there", kind="flag"),
    ]
    attack_time: Annotated[
        Int[np.ndarray, "times"],
        quantity("attack_time", "steps of an attack", "steps", kind="coordinate"),
    ]
    exact: Annotated[
        Float[np.ndarray, "times"],
        quantity("attack_time", "probability of capture, exactly", "1", kind="share"),
    ]
    simulated: Annotated[
        Float[np.ndarray, "times"],
        quantity("attack_time", "share of simulated runs", "1", kind="share"),
    ]
    fitted: Annotated[
        Float[np.ndarray, "times"], quantity("attack_time", "by the law that is fitted", "1")
    ]
    "The probability from the fitted generalized lambda distribution; NaN without a fit."
    law: Annotated[
        Float[np.ndarray, "steps"],
        quantity("step", "probability that the first robot is in view then", "1", kind="share"),
    ]
    "The distribution of the time when a robot first sees the cell, up to the longest attack time."
    arrivals: Arrivals
    fit: GldFit | None
    "The distribution fitted to the simulated times, or `None` if the fit failed."
    failure: Annotated[str | None, quantity("", "reason why no law is fitted")]

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
        off = np.abs(np.cumsum(self.law)[self.attack_time] - self.exact)
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
    graph: GraphLike,
    visible: Bool[np.ndarray, "cells cells"],
    policies: Sequence[Policy],
    target: int,
    attack: Attack,
    *,
    runs: int = 5000,
) -> Vulnerability:
    """Compute how vulnerable one cell is (Alam 2018, section 4.4.6, Tables 4.6 and 4.7).

    It runs on the host, because it fits a law to samples, or says why none is fitted.

    The source simulates the time until the first robot sees the target, fits a generalized lambda
    distribution to the times, and takes the probabilities from the fit. The result also contains
    the exact probabilities, and so shows the error of the fit;
    [`jaxcell.patrol.capture_probabilities`][] of all cells can be traced.

    **Arguments:**

    - `key`: random key of `jax.random` for the simulation.
    - `graph`, `visible`, `policies`: as in [`jaxcell.patrol.capture_probabilities`][].
    - `target`: the cell that is attacked.
    - `attack`: the attack; the start `worst` is each robot's worst cell for the first attack time.
    - `runs`: number of simulated runs.

    **Returns:** [`Vulnerability`][].

    One robot in a corridor of five cells, with attacks on cell 0; five runs are too few for a fit:

        >>> import jax
        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> problem = jax.random.key(0), graph, visible, policies, 0
        >>> result = patrol.vulnerability(*problem, patrol.Attack([1, 6]), runs=5)
        >>> result.exact.round(3).tolist(), result.fit
        ([0.286, 0.794], None)
        >>> result.failure
        'samples: expected at least 8, with 5 different values, got 5 with ...'
    """
    times = attack.times
    check_policies(graph, visible, policies)
    check_vertex("target", target, graph.vertices)
    view = visible[:, target]
    starts = [
        share if share.any() else np.isin(np.arange(view.size), policy.cells)
        for policy, share in zip(policies, _begin(graph, policies, view, attack), strict=True)
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
    fitted = np.full(times.size, np.nan) if fit is None else fit.cdf(times + 0.5)
    return Vulnerability(
        target=target,
        view=view,
        boundary=boundary(graph, view),
        attack_time=times,
        exact=np.cumsum(law)[times],
        simulated=(arrived[:, None] <= times).mean(axis=0),
        fitted=fitted,
        law=law,
        arrivals=arrivals,
        fit=fit,
        failure=failure,
    )


def _begin(
    graph: Graph, policies: Sequence[Policy], view: Bool[np.ndarray, "cells"], attack: Attack
) -> list[Float[np.ndarray, "cells"]]:
    begins = attack.begins(graph, policies, view)
    if attack.start != "worst":
        return begins
    worst = []
    for policy, share in zip(policies, begins, strict=True):
        late = np.where(view, 0.0, 1.0)
        steps = policy.chain.to_scipy()
        for _ in range(int(attack.times[0])):
            late = np.where(view, 0.0, steps @ late)
        only = np.zeros_like(share)
        only[np.argmax(np.where(share > 0, late, -1.0))] = float(share.any())
        worst.append(only)
    return worst
