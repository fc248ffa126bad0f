import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ...optimize import Commitment, Graph, minimum_commute, payoffs, stackelberg
from .paths import toward
from .walk import walk_hitting_times


# Of the longest time: vertices that are as close by symmetry differ by rounding.
_SAME = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class StrategyGame:
    """A patroller that mixes walks against an adversary that attacks a vertex."""

    preferred: tuple[tuple[int, ...], ...]
    "For each strategy the vertices it is for: one, all, or those with an emphasis."
    weights: Float[np.ndarray, "strategies edges"]
    "The weights of the edges of each strategy's walk."
    order: Int[np.ndarray, "strategies vertices"]
    "The vertices from the closest to the furthest, in mean hitting time."
    patroller: Float[np.ndarray, "strategies vertices"]
    "What the patroller is paid if the adversary attacks the vertex."
    adversary: Float[np.ndarray, "strategies vertices"]
    "What the adversary is paid then."
    commitment: Commitment
    "The best mixture of the strategies, and the vertex that the adversary then attacks."

    def labels(self, names: Sequence[str]) -> list[str]:
        """What people call the strategies, given the names of the vertices."""
        labels = []
        for preferred in self.preferred:
            if len(preferred) == 1:
                labels.append(f"toward {names[preferred[0]]}")
            elif len(preferred) == len(names):
                labels.append("all vertices")
            else:
                labels.append("emphasis " + ", ".join(names[vertex] for vertex in preferred))
        return labels


def strategy_game(
    graph: Graph,
    emphasis: Sequence[int] | None = None,
    share: float = 0.8,
    *,
    paths: int = 3,
) -> StrategyGame:
    """The game between the walks of a patroller on a graph (Alam 2018, section 4.4.2, Alg. 4.2).

    The strategies are the walk toward each vertex, [`jaxcell.patrol.toward`][], the walk that
    commutes fastest, [`jaxcell.optimize.minimum_commute`][], and, if there is an emphasis, the one
    that does so with it. In each, vertices are closer if their mean hitting time is less: the time
    from a vertex to the preferred ones, and in the strategy for all vertices, the time to a vertex
    from the others. Vertices that are as close are in the order of their numbers.

    **Arguments:**

    - `graph`: a connected graph whose vertices have positions.
    - `emphasis`: the vertices of the last strategy, two or more.
    - `share`: the least sum of the weights on the shortest closed tour through them.
    - `paths`: how many shortest paths lead from each vertex to the one that a walk is toward.

    **Returns:** [`StrategyGame`][].

    **Raises:** as [`jaxcell.optimize.minimum_commute`][], [`jaxcell.patrol.toward`][] and
    [`jaxcell.optimize.stackelberg`][].

    On a line of three, the walk toward `a` has `a` closest to the patroller, then `b`, then `c`:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [2, 0]])
        >>> game = patrol.strategy_game(graph)
        >>> game.labels(["a", "b", "c"]), game.order[0].tolist()
        (['toward a', 'toward b', 'toward c', 'all vertices'], [0, 1, 2])
        >>> round(game.commitment.value, 3)
        2.083
    """
    every = range(graph.vertices)
    preferred = [*((v,) for v in every), tuple(every)]
    weights = [toward(graph, v, paths) for v in every]
    weights.append(minimum_commute(graph).weights)
    if emphasis is not None:
        preferred.append(tuple(emphasis))
        weights.append(minimum_commute(graph, emphasis, share).weights)
    order = []
    for prefers, weight in zip(preferred, weights, strict=True):
        times = walk_hitting_times(graph, weight)
        mean = times.mean(axis=0) if len(prefers) == graph.vertices else times[:, prefers].mean(1)
        order.append(np.argsort(np.round(mean / (_SAME * mean.max())), kind="stable"))
    patroller, adversary = payoffs(np.stack(order))
    return StrategyGame(
        tuple(preferred),
        np.stack(weights),
        np.stack(order),
        np.asarray(patroller),
        np.asarray(adversary),
        stackelberg(patroller, adversary),
    )
