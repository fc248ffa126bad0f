import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.quantities import Result, derived, quantity
from ...optimize import Commitment, Graph, stackelberg
from .attack import capture_probabilities
from .policies import Policy
from .regions import Regions


@dataclasses.dataclass(frozen=True, eq=False)
class ShareGame(Result):
    """Robots that mix policies of several shares against an adversary that attacks a cell."""

    title: ClassVar[str] = "Mixture of shares against an adversary"
    tables: ClassVar[Mapping[str, str]] = {"share": "strategies"}

    shares: Float[np.ndarray, "shares"]
    "How much each strategy emphasises the covers."
    attack_time: Annotated[int, quantity("", "steps of the attack", "steps", kind="count")]
    targets: Int[np.ndarray, "targets"]
    "The cells that the adversary chooses from."
    capture: Annotated[
        Float[np.ndarray, "shares cells"],
        quantity("share position", "probability of capture by the share", "1", kind="share"),
    ]
    commitment: Commitment
    "The best mixture of the shares; its answer is a place in `targets`."

    @derived("share", "share of steps on the tours", "1", kind="coordinate")
    def share(self) -> Float[np.ndarray, "shares"]:
        return self.shares

    @derived("share", "how often it is drawn", "1", kind="distribution")
    def probability(self) -> Float[np.ndarray, "shares"]:
        return np.asarray(self.commitment.weights)

    @derived("share", "capture by it alone, at its weakest cell", "1", kind="share")
    def capture_alone(self) -> Float[np.ndarray, "shares"]:
        return self.capture[:, self.targets].min(axis=1)

    @derived("position", "probability of capture by the mixture", "1", kind="share")
    def mixed(self) -> Float[np.ndarray, "cells"]:
        return self.probability @ self.capture

    @derived("", "probability of capture where the adversary attacks", "1", kind="share")
    def value(self) -> float:
        return self.commitment.value

    @derived("", "more than by the best share alone", "1")
    def improvement(self) -> float:
        return self.value - float(self.capture_alone.max())

    @derived("", "cell that the adversary attacks", kind="place")
    def attacked(self) -> int:
        return int(self.targets[int(self.commitment.answer[0])])

    @derived("", "residual of the linear programs", kind="residual")
    def residual(self) -> float:
        return self.commitment.certificate.residual


def share_game(
    graph: Graph,
    visible: Bool[np.ndarray, "cells cells"],
    policies: Callable[[float], Sequence[Policy]],
    shares: Sequence[float],
    attack_time: int,
    targets: Int[np.ndarray, "targets"] | None = None,
) -> ShareGame:
    """The mixture of shares that is best against an adversary who knows it.

    The source lets the user choose how much policies emphasise their covers (Alam 2018, section
    4.4.4), and plays its game on the vertices of a graph (section 4.4.2). Here the robots draw one
    share for all of them each time, and the adversary attacks the cell where it is caught least
    likely, [`jaxcell.patrol.capture_probabilities`][]. It is paid the probability of success.

    **Arguments:**

    - `graph`, `visible`: as in [`jaxcell.patrol.capture_probabilities`][].
    - `policies`: the policies of a share, such as
        `lambda share: distributed_policies(graph, visible, 2, share)`.
    - `shares`: the strategies.
    - `attack_time`: the steps that an attack takes.
    - `targets`: the cells that the adversary chooses from; all by default.

    **Returns:** [`ShareGame`][].

    **Raises:** `ValueError` for no shares, for no targets or one that does not exist, and as
    `policies` and [`jaxcell.patrol.capture_probabilities`][]; `RuntimeError` as
    [`jaxcell.optimize.stackelberg`][].

    One robot in a corridor of five cells, that draws one of two shares, against attacks of six
    steps:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([(i, i + 1) for i in range(4)], xy=[(i, 0) for i in range(5)])
        >>> visible = np.abs(np.subtract.outer(range(5), range(5))) <= 1
        >>> def policies(share):
        ...     return patrol.distributed_policies(graph, visible, 1, share)
        >>> game = patrol.share_game(graph, visible, policies, [0.0, 0.9], 6)
        >>> game.capture_alone.round(3).tolist(), game.probability.round(3).tolist(), game.attacked
        ([0.61, 0.793], [0.0, 1.0], 4)
    """
    if not shares:
        raise ValueError("shares: expected at least one, got none")
    targets = np.arange(graph.vertices, dtype=np.int32) if targets is None else targets
    if targets.size == 0 or targets.min() < 0 or targets.max() >= graph.vertices:
        raise ValueError(
            f"targets: expected some of the cells 0 to {graph.vertices - 1}, got {targets.tolist()}"
        )
    capture = np.concatenate(
        [capture_probabilities(graph, visible, policies(share), [attack_time]) for share in shares]
    )
    # Each target is a linear program, and few are worth a thought.
    kept = targets[_undominated(capture[:, targets])]
    commitment = stackelberg(capture[:, kept], 1 - capture[:, kept])
    return ShareGame(np.array(shares, float), attack_time, kept, capture, commitment)


def _undominated(
    capture: Float[np.ndarray, "shares targets"],
) -> Bool[np.ndarray, "targets"]:
    """The targets for which no other is at most as likely to be defended, whatever the share.

    Of targets that are alike in this, the first is kept.
    """
    kept = np.ones(capture.shape[1], bool)
    # What comes later in this order does not dominate what comes before it.
    order = np.lexsort(capture[::-1])
    for place, target in enumerate(order):
        if kept[target]:
            later = order[place + 1 :]
            kept[later[(capture[:, later] >= capture[:, [target]]).all(axis=0)]] = False
    return kept


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

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([(i, i + 1) for i in range(4)], xy=[(i, 0) for i in range(5)])
        >>> visible = np.abs(np.subtract.outer(range(5), range(5))) <= 1
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
