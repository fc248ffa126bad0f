from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int

from ...optimize import Graph, shortest_tour
from .attack import Attack


def capture_by_tours(
    graph: Graph,
    visible: Bool[np.ndarray, "cells cells"],
    covers: Sequence[Sequence[int] | Int[np.ndarray, "_"]],
    attack: Attack,
) -> float | None:
    """Compute the least capture by robots that follow closed tours through their covers.

    An adversary who sees a robot on a tour knows when it returns. When an attack begins, all places
    on a tour out of view of the target are equally likely.

    **Arguments:**

    - `graph`, `visible`: as in [`jaxcell.patrol.capture_probabilities`][].
    - `covers`: the cells that each robot visits, on a tour by
        [`jaxcell.optimize.shortest_tour`][].
    - `attack`: the attack; only its first time counts.

    **Returns:** the least probability over the cells that can be seen, or `None` if a cover has a
    single cell.

    One robot in a corridor of five cells goes to and fro between cells 1 and 3, and sees each end
    again after at most 3 steps:

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
