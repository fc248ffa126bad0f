from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from ..optimize import Graph
from ..patrol.walks.game import StrategyGame
from ..patrol.walks.measures import Measures
from .chain_checks import patrol_graph_checks
from .checks import with_checks
from .provenance import provenance


# What a solver or a scaling leaves of a probability that is 0.
_NOTHING = 1e-9


def patrol_graph_dataset(
    graph: Graph,
    measures: Measures,
    *,
    names: Sequence[str] | None = None,
    game: StrategyGame | None = None,
    spec: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """A patroller's random walk on a graph as a labelled dataset.

    Over `start` and `target`, vertices by name: `transition`, `hitting_time` and `commute_time`.
    Over `vertex`: `stationary`. Over `edge`: its two `end`s, and the `weight`, the share of steps
    that go along it; where the walk is reversible these are its weights. If there is a game, over
    `strategy`: the `mixture`; with `vertex`, `patroller_payoff`, `adversary_payoff` and `rank`; and
    with `edge`, `strategy_weight`.

    **Arguments:**

    - `graph`: the graph.
    - `measures`: those of the patroller's chain, of [`jaxcell.patrol.measure`][].
    - `names`: the name of each vertex; by default its number.
    - `game`: the game between strategies, if there is one.
    - `spec`: what was asked for, kept as JSON in the attribute `spec`.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    **Raises:** `ValueError` if the measures or the game are not of the vertices of the graph, the
    chain takes other ways than its edges, or `spec` is not JSON.

    A random walk on a line of three vertices:

        >>> from jaxcell import patrol, record
        >>> graph = patrol.Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [2, 0]])
        >>> measures = patrol.measure(patrol.random_walk(graph, [1, 1]))
        >>> dataset = record.patrol_graph_dataset(graph, measures, names=["a", "b", "c"])
        >>> round(dataset.hitting_time.sel(start="a", target="c").item(), 6)
        4.0
    """
    check_measures(graph, measures, game)
    names = vertex_names(graph, names)
    pairs = ("start", "target")
    steps = {"units": "steps"}
    share = edge_shares(graph, measures)
    dataset = xr.Dataset(
        {
            "transition": (pairs, measures.transition, {"long_name": "probability", "units": "1"}),
            "hitting_time": (pairs, measures.hitting_times, {"long_name": "expected", **steps}),
            "commute_time": (pairs, measures.commute_times, {"long_name": "expected", **steps}),
            "stationary": (
                "vertex",
                measures.stationary,
                {"long_name": "share of time in the long run", "units": "1"},
            ),
            "end": (("edge", "side"), graph.edges, {"long_name": "number of a vertex, from 0"}),
            "weight": ("edge", share, {"long_name": "share of steps along it", "units": "1"}),
        },
        coords={name: (name, list(names)) for name in ("vertex", *pairs)},
        attrs={
            **provenance("Random walk of a patroller on a graph", None, spec),
            "source": "jaxcell; after Alam 2018, section 4.4",
            "mean_hitting_time": measures.mean_hitting_time,
            "mean_commute_time": measures.mean_commute_time,
            "kemeny_constant": measures.kemeny_constant,
            "entropy_rate_nats": measures.entropy_rate,
            "slem": measures.slem,
            "mixing_time": measures.mixing_time,
        },
    )
    if graph.xy is not None:
        metres = {"units": "m"}
        x, y = graph.xy.T
        dataset = dataset.assign_coords(x=("vertex", x, metres), y=("vertex", y, metres))
    if game is not None:
        dataset = dataset.merge(_game(game, names))
    return with_checks(dataset, patrol_graph_checks(dataset))


def _game(game: StrategyGame, names: Sequence[str]) -> xr.Dataset:
    by_vertex = ("strategy", "vertex")
    rank = np.argsort(game.order, axis=1) + 1
    commitment = game.commitment
    return xr.Dataset(
        {
            "mixture": ("strategy", np.asarray(commitment.weights), {"units": "1"}),
            "patroller_payoff": (by_vertex, game.patroller),
            "adversary_payoff": (by_vertex, game.adversary),
            "rank": (by_vertex, rank, {"long_name": "from the closest vertex, 1"}),
            "strategy_weight": (("strategy", "edge"), game.weights, {"units": "1"}),
            "patroller_value": ((), commitment.value),
            "adversary_value": ((), float(commitment.follower_value[0])),
            "attacked": ((), names[int(commitment.answer[0])]),
        },
        coords={"strategy": ("strategy", game.labels(names))},
    )


def vertex_names(graph: Graph, names: Sequence[str] | None) -> Sequence[str]:
    """The names of the vertices, by default their numbers.

    **Raises:** `ValueError` if they are not one a vertex.
    """
    if names is None:
        return [str(vertex) for vertex in range(graph.vertices)]
    if len(names) != graph.vertices:
        raise ValueError(f"names: expected {graph.vertices}, one a vertex, got {len(names)}")
    return names


def edge_shares(graph: Graph, measures: Measures) -> Float[np.ndarray, "edges"]:
    """The share of steps that go along each edge, in either direction."""
    flow = measures.stationary[:, None] * measures.transition
    tail, head = graph.edges.T
    return flow[tail, head] + flow[head, tail]


def check_measures(graph: Graph, measures: Measures, game: StrategyGame | None) -> None:
    """Raises `ValueError` if measures or a game are not of a graph."""
    if measures.stationary.size != graph.vertices:
        raise ValueError(
            f"measures: expected those of {graph.vertices} vertices, got {measures.stationary.size}"
        )
    ways = graph.matrix(np.ones(len(graph.edges))).toarray() + np.eye(graph.vertices)
    wrong = np.argwhere((ways == 0) & (measures.transition > _NOTHING))
    if len(wrong):
        raise ValueError(
            f"measures: the chain goes from vertex {wrong[0, 0]} to {wrong[0, 1]}, between which "
            "there is no edge"
        )
    if game is not None and game.weights.shape[1] != len(graph.edges):
        raise ValueError(
            f"game: expected walks on {len(graph.edges)} edges, got {game.weights.shape[1]}"
        )
