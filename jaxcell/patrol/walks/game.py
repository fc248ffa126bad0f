import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ...base.quantities import Result, derived, from_part, quantity
from ...markov import dense
from ...optimize import Commitment, GraphLike, Stakes, minimum_commute, payoffs, stackelberg
from ..team.times import names_of
from .paths import toward
from .walk import edge_shares, random_walk


# Tolerance relative to the longest time: the times of symmetric vertices differ by rounding.
_SAME = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class StrategyGame(Result):
    """A game between a patroller, who mixes walks, and an adversary, who attacks a vertex."""

    title: ClassVar[str] = "Game between walks on a graph and an adversary"
    tables: ClassVar[Mapping[str, str]] = {"strategy": "strategies"}

    names: Sequence[str]
    preferred: tuple[tuple[int, ...], ...]
    "For each strategy, its target, or the vertices that it emphasises, or all vertices."
    weight: Annotated[
        Float[np.ndarray, "strategies edges"],
        quantity("strategy edge", "share of steps along the edge", "1", kind="distribution"),
    ]
    closest: Int[np.ndarray, "strategies vertices"]
    "For each strategy, the vertices in order of their mean hitting time, the closest first."
    patroller_payoff: Annotated[
        Float[np.ndarray, "strategies vertices"],
        quantity("strategy vertex", "payoff of the patroller for an attack on the vertex"),
    ]
    adversary_payoff: Annotated[
        Float[np.ndarray, "strategies vertices"],
        quantity("strategy vertex", "payoff of the adversary for an attack on the vertex"),
    ]
    commitment: Commitment
    "The best mixture of the strategies, and the vertex that the adversary then attacks."

    @property
    def answer(self) -> tuple[str, ...]:
        return (
            f"The best mixture of walks pays the patroller {self.value:.3g}, and the best walk "
            f"alone {self.alone:.3g}; the adversary attacks vertex {self.attacked}.",
        )

    @derived("strategy", "strategy", kind="coordinate")
    def strategy(self) -> list[str]:
        labels = []
        for preferred in self.preferred:
            if len(preferred) == 1:
                labels.append(f"toward {self.names[preferred[0]]}")
            elif len(preferred) == len(self.names):
                labels.append("all vertices")
            else:
                listed = ", ".join(self.names[vertex] for vertex in preferred)
                labels.append(f"emphasis {listed}")
        return labels

    @derived("strategy", "share", "1", kind="distribution")
    def share(self) -> Float[np.ndarray, "strategies"]:
        return np.asarray(self.commitment.weights)

    @derived("strategy place", "vertices from the closest", listed=True)
    def order(self) -> list[list[str]]:
        return [[self.names[vertex] for vertex in row] for row in self.closest.tolist()]

    @derived("strategy vertex", "rank of the vertex, 1 for the closest", kind="count")
    def rank(self) -> Int[np.ndarray, "strategies vertices"]:
        return np.argsort(self.closest, axis=1) + 1

    value = from_part("commitment.value", "", "payoff of the patroller")

    @derived("", "payoff of the patroller with the best strategy alone")
    def alone(self) -> float:
        # Among vertices with equal payoffs the adversary attacks the patroller's favourite.
        most = self.adversary_payoff.max(axis=1, keepdims=True)
        answers = np.isclose(self.adversary_payoff, most, rtol=0, atol=1e-9)
        return float(self.patroller_payoff.max(where=answers, initial=-np.inf, axis=1).max())

    @derived("", "payoff of the adversary")
    def adversary_value(self) -> float:
        return float(self.commitment.follower_value[0])

    @derived("", "vertex that it attacks")
    def attacked(self) -> str:
        return self.names[int(self.commitment.answer[0])]

    @derived("", "optimality gap of the mixture, relative", kind="residual")
    def gap(self) -> float:
        return self.commitment.certificate.residual


def strategy_game(
    graph: GraphLike,
    emphasis: Sequence[int] | None = None,
    share: float = 0.8,
    *,
    paths: int = 1,
    names: Sequence[str] | None = None,
    stakes: Stakes | None = None,
) -> StrategyGame:
    """Solve the game of patroller and adversary on a graph (Alam 2018, section 4.4.2, Alg. 4.2).

    The strategies of the patroller are the walk toward each vertex, [`jaxcell.patrol.toward`][],
    the walk with the least commute time, [`jaxcell.optimize.minimum_commute`][], and, if there is
    an emphasis, the walk with the least commute time under that emphasis. Each strategy sorts the
    vertices by a mean hitting time. This is the time from a vertex to those that the walk prefers;
    if the walk prefers all vertices, it is the time to a vertex from all others.

    **Arguments:**

    - `graph`: a connected graph whose vertices have positions.
    - `emphasis`: two or more vertices to emphasise, or `None` to leave out the last strategy.
    - `share`: the least sum of the weights on the shortest closed tour through these vertices.
    - `paths`: number of shortest paths from each vertex to the target of a walk.
    - `names`: names of the vertices; by default their numbers.
    - `stakes`: the stakes of the game at each vertex, as in [`jaxcell.optimize.payoffs`][].

    **Returns:** [`StrategyGame`][].

    On a line of three vertices, the walk toward `a` is closest to `a`, then to `b`, then to `c`:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [2, 0]])
        >>> game = patrol.strategy_game(graph, names="abc")
        >>> game.strategy, game.order[0]
        (['toward a', 'toward b', 'toward c', 'all vertices'], ['a', 'b', 'c'])
        >>> round(game.value, 3)
        2.083
    """
    every = range(graph.vertices)
    preferred = [*((v,) for v in every), tuple(every)]
    chains = [toward(graph, v, paths) for v in every]
    chains.append(random_walk(graph, minimum_commute(graph).weights))
    if emphasis is not None:
        preferred.append(tuple(emphasis))
        chains.append(random_walk(graph, minimum_commute(graph, emphasis, share).weights))
    order = []
    for prefers, chain in zip(preferred, chains, strict=True):
        time = np.asarray(dense.hitting(chain.to_scipy().toarray()))
        mean = time.mean(axis=0) if len(prefers) == graph.vertices else time[:, prefers].mean(1)
        order.append(np.argsort(np.round(mean / (_SAME * mean.max())), kind="stable"))
    patroller, adversary = payoffs(np.stack(order), stakes)
    return StrategyGame(
        names=names_of(graph.vertices, names),
        preferred=tuple(preferred),
        weight=np.stack([edge_shares(graph, chain) for chain in chains]),
        closest=np.stack(order),
        patroller_payoff=np.asarray(patroller),
        adversary_payoff=np.asarray(adversary),
        commitment=stackelberg(patroller, adversary),
    )
