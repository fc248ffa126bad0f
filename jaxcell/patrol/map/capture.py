import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...base.certificate import Numbers
from ...base.precision import require_x64
from ...base.quantities import PROBABILITY, Checks, Result, derived, from_part, quantity
from ...base.wide import traced
from ...mapping import Chain
from ...optimize import Graph, GraphLike, shortest_tour
from .attack import Attack, check_policies, contested
from .policies import Policy
from .regions import Regions


# Probabilities of capture that differ by less count as equal.
_ALIKE = 1e-9
# Number of targets computed at once, which limits the arrays of one number per cell and target.
_TARGETS = 512


@dataclasses.dataclass(frozen=True, eq=False)
class Capture(Result):
    """The probability of capturing an adversary, for each attack time and attacked cell."""

    title: ClassVar[str] = "Probability of capture"
    tables: ClassVar[Mapping[str, str]] = {"attack_time": "attacks"}

    attack: Attack
    probability: Annotated[
        Float[np.ndarray, "times attacked"],
        quantity("attack_time position", "probability of capture", "1", kind="share"),
    ]
    at_first: Float[np.ndarray, "times cells"]
    "The probability of capture if robots start with equal probability in any cell out of view."
    at_worst: Float[np.ndarray, "times cells"]
    "The probability of capture if the adversary sees the robots, and waits until all are far away."
    contested: Int[np.ndarray, "targets"]
    "The cells among which an adversary chooses, [`jaxcell.patrol.map.contested`][]."

    @classmethod
    def of(
        cls,
        graph: Graph,
        visible: Bool[np.ndarray, "cells cells"],
        policies: Sequence[Policy],
        attack: Attack,
        regions: Regions | None = None,
    ) -> "Capture":
        """Compute the probability of capture by robots with given policies.

        **Arguments:** those of [`capture_probabilities`][]; and the regions around a base station,
        if any, which always watches the cells in its view.
        """
        check_policies(graph, visible, policies)
        attacks = [attack, *(Attack(attack.times, start) for start in ("uniform", "worst"))]
        caught, at_first, at_worst = _captures(graph, visible, policies, attacks)
        return cls(attack, caught, at_first, at_worst, contested(visible, policies, regions))

    def at(self, row: int) -> "Capture":
        """Return the probabilities for one of the attack times."""
        attack = Attack(self.attack.times[[row]], self.attack.start)
        at_first, at_worst = self.at_first[[row]], self.at_worst[[row]]
        return Capture(attack, self.probability[[row]], at_first, at_worst, self.contested)

    attack_time = from_part(
        "attack.times", "attack_time", "steps of an attack", "steps", kind="coordinate"
    )

    @derived("attack_time", "weakest cell", kind="place")
    def weakest(self) -> Int[np.ndarray, "times"]:
        """The contested cell with the least probability at each attack time; the first in a tie."""
        return self._weakest(self.probability)

    @derived("attack_time", "probability of capture there", "1", kind="share")
    def least(self) -> Float[np.ndarray, "times"]:
        return self.probability[:, self.contested].min(axis=1, initial=1.0)

    @derived("attack_time", "mean over cells", "1", kind="share")
    def mean(self) -> Float[np.ndarray, "times"]:
        return self.probability[:, self.contested].mean(axis=1)

    @derived("attack_time", "least at the first attack", "1", kind="share")
    def least_at_first(self) -> Float[np.ndarray, "times"]:
        return self.at_first[:, self.contested].min(axis=1, initial=1.0)

    @derived("attack_time", "least if the adversary sees the robots", "1", kind="share")
    def least_watched(self) -> Float[np.ndarray, "times"]:
        return self.at_worst[:, self.contested].min(axis=1, initial=1.0)

    @derived("attack_time", "cell where that is least", kind="place")
    def weakest_watched(self) -> Int[np.ndarray, "times"]:
        return self._weakest(self.at_worst)

    def _weakest(self, probability: Float[np.ndarray, "times cells"]) -> Int[np.ndarray, "times"]:
        chosen = probability[:, self.contested]
        alike = chosen <= chosen.min(axis=1, keepdims=True) + _ALIKE
        return self.contested[alike.argmax(axis=1)]

    def checks(self) -> Checks:
        order = np.argsort(self.attack.times, kind="stable")
        later = np.diff(self.probability[order], axis=0)
        return {"falls_with_time": (float(np.max(-later, initial=0.0)), PROBABILITY)}


def capture_probabilities(
    graph: GraphLike,
    visible: Bool[np.ndarray, "cells cells"],
    policies: Sequence[Policy],
    attack: Attack,
) -> Float[Numbers, "times cells"]:
    """Compute the probability of capturing an adversary that attacks a cell, for every cell.

    The attack begins with each robot in a cell from which the target is not seen, and fails if a
    robot sees the target within the attack time (Alam 2018, section 4.4.6). A robot that sees the
    target from all of its cells captures every attack.

    **Arguments:**

    - `graph`: the cells and the edges between them.
    - `visible`: `visible[i, j]` is true if a robot in cell `i` sees cell `j`, as
        [`jaxcell.space.visible_cells`][] returns it. The dissertation instead tests whether the
        target sees the whole cell of the robot: its mask is the transpose.
    - `policies`: the policy of each robot.
    - `attack`: the attack times, and the places of robots when an attack begins.

    **Returns:** one row per attack time, one column per attacked cell. An adversary who knows the
    policies attacks the cell with the smallest number of a row. The chains and the weights of
    policies may be traced by `jit`, `vmap` and `grad`.

    One robot in a corridor of five cells, with attacks of one and of six steps:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> attack = patrol.Attack([1, 6])
        >>> patrol.capture_probabilities(graph, visible, policies, attack).round(3).tolist()
        [[0.286, 0.667, 1.0, 0.667, 0.286], [0.794, 0.992, 1.0, 0.992, 0.794]]
    """
    check_policies(graph, visible, policies)
    return _captures(graph, visible, policies, [attack])[0]


def capture_by_tours(
    graph: GraphLike,
    visible: Bool[np.ndarray, "cells cells"],
    covers: Sequence[Sequence[int] | Int[np.ndarray, "_"]],
    attack: Attack,
) -> float | None:
    """Compute the least probability of capture by robots that follow closed tours of their covers.

    The phases of the tours are independent: the attack begins with each robot at a random place of
    its tour from which the target is not seen. With a shared clock robots capture more, see
    [`jaxcell.patrol.team.round_on_map`][]. An adversary who sees a robot would do better, because
    it knows when the robot returns.

    **Arguments:** the graph and the visibility, as in [`capture_probabilities`][]; the cells that
    each robot visits, on a tour from [`jaxcell.optimize.shortest_tour`][]; and the attack, of which
    only the first time counts. **Returns:** the least probability over the cells that can be seen,
    or `None` if a cover has a single cell.

    One robot in a corridor of five cells goes back and forth between cells 1 and 3. It sees each
    end again after at most 3 steps:

        >>> from jaxcell import examples, patrol
        >>> graph, visible = examples.patrol()
        >>> patrol.map.capture_by_tours(graph, visible, [[1, 3]], patrol.Attack(2))
        0.6666666666666667
    """
    if any(len(cover) < 2 for cover in covers):
        return None
    missed = np.ones(graph.vertices)
    steps = int(attack.times[0])
    for cover in covers:
        seen = visible[shortest_tour(graph, [int(cell) for cell in cover])]
        late = ~seen
        for _ in range(min(steps, len(seen))):
            late = ~seen & np.roll(late, -1, axis=0)
        hidden = (~seen).sum(axis=0)
        missed *= np.where(hidden > 0, late.sum(axis=0) / np.maximum(hidden, 1), 0)
    return float(1 - missed[visible.any(axis=0)].max(initial=0.0))


def _captures(
    graph: Graph,
    visible: Bool[np.ndarray, "cells cells"],
    policies: Sequence[Policy],
    attacks: Sequence[Attack],
) -> Float[Numbers, "attacks times cells"]:
    """Compute the probabilities of capture for attacks that differ in `start`, not in `times`."""
    require_x64("capture_probabilities")
    times = attacks[0].times
    cells = graph.vertices
    chunk = min(_TARGETS, cells)
    # Robots with the same walk share their chain.
    chains = {id(policy.chain): policy.chain for policy in policies}
    given = traced(list(chains.values()), [policy.weights for policy in policies])
    xp = jnp if given else np
    # A program that is traced gets the number of steps, so that its loop has a derivative.
    later: Any = _later if given else jax.jit(_later)
    caught = []
    for first in range(0, cells, chunk):
        # The last chunk is full too, so that all chunks have one shape.
        begin = min(first, cells - chunk)
        view = visible[:, begin : begin + chunk]
        begins = [attack.begins(graph, policies, view.T) for attack in attacks]
        survive = [[xp.ones(chunk)] * times.size for _ in attacks]
        late, before = dict.fromkeys(chains, np.where(view, 0.0, 1.0)), 0
        for time in np.unique(times):
            late = {
                key: xp.asarray(later(chain, view, late[key], int(time - before)))
                for key, chain in chains.items()
            }
            before = time
            for attack, shares, alive in zip(attacks, begins, survive, strict=True):
                for policy, share in zip(policies, shares, strict=True):
                    each = late[id(policy.chain)]
                    if attack.start == "worst":
                        alone = xp.where(share.T > 0, each, 0.0).max(axis=0)
                    else:
                        alone = (share.T * each).sum(axis=0)
                    for row in np.flatnonzero(times == time):
                        alive[row] = alive[row] * alone
        caught.append(xp.maximum(0.0, 1 - xp.asarray(survive))[..., first - begin :])
    return xp.concatenate(caught, axis=2)


def _later(
    chain: Chain,
    view: Bool[Array | np.ndarray, "cells targets"],
    late: Float[Array | np.ndarray, "cells targets"],
    steps: int | Int[Array, ""],
) -> Float[Array, "cells targets"]:
    """Extend by `steps` steps the probability `late` that a robot from a cell misses a target."""
    stay = jnp.where(view, 0.0, 1.0)
    leaving = chain.leaving[:, None]
    pull = jax.vmap(chain.pull, in_axes=1, out_axes=1)
    return jax.lax.fori_loop(0, steps, lambda _, value: stay * (pull(value) + leaving), late)
