import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float

from ...base.certificate import Certificate, Outcome
from ...base.quantities import derived, quantity
from ...mapping import Chain
from ...markov import mean_first_arrival
from ...optimize import Graph
from ..team.charging import Charged
from ..team.division import Division
from ..team.durations import Timed
from ..team.idleness import (
    Idleness,
    idleness_over_vertices,
    long_run,
    steps_between_visits,
)
from ..team.news import News
from ..team.times import move_times
from .arrival import captured_by_any, walk_capture_probabilities
from .game import StrategyGame
from .measures import Measures, measure
from .optimal.constraints import MetConstraints


# What a solver or a scaling leaves of a probability that is 0.
_NOTHING = 1e-9
# Of all steps: less is what a solver leaves of an edge that is not used.
_USED = 1e-6
# Nats a step: with less, the next step is known.
_FORESEEN = 0.01
# Vertices to which the first arrivals of several robots are found, each by itself, in 10 s.
_MAX_ARRIVALS = 256


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class GraphPatrol(Measures):
    """The random walk with which robots patrol a graph, each by itself, and what it achieves."""

    title: ClassVar[str] = "Random walk of a patroller on a graph"
    tables: ClassVar[Mapping[str, str]] = {"vertex": "vertices", "edge": "edges"}

    graph: Graph
    names: Sequence[str]
    "Of the vertices."
    goal: Annotated[str | None, quantity("", "what the walk makes large")] = None
    value: Annotated[float | None, quantity("", "how large that is")] = None
    certificate: Certificate | None = None
    "How good the walk is at what it is for, as far as that is known."
    local: bool = False
    "Whether it is only a local optimum, because the problem is not convex."
    bounds: MetConstraints | None = None
    "How it meets the constraints on it."
    game: StrategyGame | None = None
    shares: Annotated[
        Float[np.ndarray, "robots vertices"],
        quantity("robot vertex", "share of time in the long run of each robot", "1", kind="share"),
    ]
    team: Float[np.ndarray, "robots vertices vertices"] | None = None
    "The transition matrix of each robot, where they differ; the measures are those of the first."
    timed: Timed | None = None
    "The walk in seconds, if edges have travel times."
    by_steps: bool = False
    "Whether the walk was chosen by steps although they take times that differ."
    division: Division | None = None
    "What robots achieve that share the graph, and that divide it."
    news: News | None = None
    "How old news are at a base."
    charged: Charged | None = None
    "The walks, kept near enough to a charger."
    idleness: Idleness | None = None
    "How long vertices wait for visits, beside three other patrols."
    weights_unused: bool = False
    "Whether the file of the graph has weights on edges, which a walk has of its own."
    robots: int = 1
    "How many walk, each by itself."
    first_arrival: Annotated[
        Float[np.ndarray, "vertices"] | None,
        quantity("vertex", "mean steps until one patroller is there", "steps", kind="time"),
    ] = None
    "From places drawn from the shares of time; for one patroller its own mean time says as much."
    captured: Annotated[
        Float[np.ndarray, "vertices"] | None,
        quantity("vertex", "least chance of capture there", "1", kind="share"),
    ] = None
    "That one patroller comes there in time, wherever all are as the attack begins."
    seed: int = 0
    "Of the walks that are recorded."

    @classmethod
    def of(
        cls,
        graph: Graph,
        chain: Chain,
        *,
        names: Sequence[str] | None = None,
        robots: int = 1,
        attack_time: Any = None,
        **more: Any,
    ) -> "GraphPatrol":
        """Measure the chain of a patroller, or of several that each walk by themselves.

        **Arguments:**

        - `graph`: a connected graph.
        - `chain`: a chain that moves along its edges, or stays.
        - `names`: of the vertices; by default their numbers.
        - `robots`: how many walk.
        - `attack_time`: the steps that an attack takes, a whole number, or array `[vertices]`.
        - further keywords: the other fields of [`GraphPatrol`][].

        **Raises:** `ValueError` if the chain or the names are not those of the vertices, if the
        chain moves where there is no edge, if the game is one of another graph, or for no robots.

        Two random walks on a line of three vertices:

            >>> from jaxcell import patrol, record
            >>> graph = patrol.Graph([[0, 1], [1, 2]])
            >>> walk = patrol.random_walk(graph, [1, 1])
            >>> found = patrol.GraphPatrol.of(graph, walk, names="abc", robots=2, attack_time=2)
            >>> round(record.dataset(found).hitting_time.sel(start="a", target="c").item(), 6)
            4.0
            >>> found.captured.tolist()
            [0.75, 1.0, 0.75]
        """
        if robots < 1:
            raise ValueError(f"robots: expected at least 1, got {robots}")
        names = [str(vertex) for vertex in range(graph.vertices)] if names is None else names
        found = measure(chain)
        team = more.get("team")
        if robots > 1 and team is None and graph.vertices <= _MAX_ARRIVALS:
            start = [found.stationary] * robots
            arrivals = [
                mean_first_arrival([chain] * robots, start, vertex, throw=False).value
                for vertex in range(graph.vertices)
            ]
            more["first_arrival"] = np.array(arrivals)
        if attack_time is not None:
            each = np.stack(
                [
                    walk_capture_probabilities(graph, matrix, attack_time)
                    for matrix in ([found.transition] if team is None else team)
                ]
            )
            whole = np.broadcast_to(each, (robots, *each.shape[1:]))
            more["captured"] = captured_by_any(whole)
        alike = np.broadcast_to(found.stationary, (robots, found.stationary.size))
        more["shares"] = alike if team is None else long_run(team)
        return cls(**vars(found), graph=graph, names=list(names), robots=robots, **more)

    def __post_init__(self) -> None:
        graph, vertices = self.graph, self.stationary.size
        if vertices != graph.vertices:
            raise ValueError(f"chain: expected one of {graph.vertices} vertices, got {vertices}")
        if len(self.names) != vertices:
            raise ValueError(f"names: expected {vertices}, one a vertex, got {len(self.names)}")
        wrong = np.argwhere((move_times(graph) == 0) & (self.transition > _NOTHING))
        if len(wrong):
            raise ValueError(
                f"chain: it goes from vertex {wrong[0, 0]} to {wrong[0, 1]}, between which there "
                "is no edge"
            )
        if self.game is not None and self.game.weight.shape[1] != len(graph.edges):
            raise ValueError(
                f"game: expected walks on {len(graph.edges)} edges, got {self.game.weight.shape[1]}"
            )
        if self.team is not None and self.team.shape != (self.robots, vertices, vertices):
            raise ValueError(f"team: expected {self.robots} matrices, got {self.team.shape}")

    @property
    def matrices(self) -> Float[np.ndarray, "robots vertices vertices"]:
        """The transition matrix of each robot."""
        if self.team is not None:
            return self.team
        return np.broadcast_to(self.transition, (self.robots, *self.transition.shape))

    @property
    def remarks(self) -> tuple[str, ...]:
        found = []
        if self.team is not None:
            found.append("robots walk differently; times and entropy are those of robot 0")
        if self.weights_unused:
            found.append("the weights of edges in the file are not used; the walk has its own")
        if self.by_steps:
            found.append("the walk is chosen by steps; the times in seconds are those it then has")
        if self.timed is not None and self.game is not None:
            found.append("the game counts steps, not seconds")
        if self.local:
            found.append(
                "the walk is a local optimum, the best that several starts lead to; another may be "
                "better"
            )
        if self.certificate is not None and self.certificate.outcome is not Outcome.CONVERGED:
            found.append(
                f"{self.certificate.outcome.value} (residual {self.certificate.residual:.3g}, "
                f"tolerance {self.certificate.tolerance:.3g})"
            )
        if self.robots > 1 and self.team is None and self.first_arrival is None:
            found.append(
                f"when the first patroller comes is found on graphs of up to {_MAX_ARRIVALS} "
                "vertices; other times are of one patroller"
            )
        left_out = int((self.stationary <= 0).sum())
        if left_out:
            found.append(f"in the long run the walk leaves out {left_out:,} of the vertices")
        if self.entropy_rate_nats < _FORESEEN:
            found.append(
                f"the walk is deterministic but for {self.entropy_rate_nats:.1g} nats a step: who "
                "watches it knows where the patroller goes"
            )
        return tuple(found)

    @derived("", "mean steps until the first patroller is at a vertex", "steps", kind="time")
    def mean_first_arrival(self) -> float | None:
        return None if self.first_arrival is None else float(self.first_arrival.mean())

    @derived("vertex", "vertex", kind="coordinate")
    def vertex(self) -> list[str]:
        return list(self.names)

    @derived("start", "vertex of the row", kind="coordinate")
    def start(self) -> list[str]:
        return list(self.names)

    @derived("target", "vertex of the column", kind="coordinate")
    def target(self) -> list[str]:
        return list(self.names)

    @derived("vertex", "x", "m", kind="coordinate")
    def x(self) -> Float[np.ndarray, "vertices"] | None:
        return None if self.graph.xy is None else self.graph.xy[:, 0]

    @derived("vertex", "y", "m", kind="coordinate")
    def y(self) -> Float[np.ndarray, "vertices"] | None:
        return None if self.graph.xy is None else self.graph.xy[:, 1]

    @derived("edge side", "ends", listed=True)
    def ends(self) -> list[list[str]]:
        return [[self.names[end] for end in edge] for edge in self.graph.edges.tolist()]

    @derived("edge side", "probability of taking it from each end", "1", kind="share", listed=True)
    def probabilities(self) -> Float[np.ndarray, "edges 2"]:
        return np.stack([self.transition[i, j] for i, j in self._directions], axis=1)

    @derived("edge", "share of steps along it, mean over robots", "1", kind="share")
    def weight(self) -> Float[np.ndarray, "edges"]:
        flow = (self.shares[:, :, None] * self.matrices).mean(axis=0)
        return sum(flow[i, j] for i, j in self._directions)

    @derived("", "largest share of the steps on one edge", kind="share")
    def largest_weight(self) -> float:
        return float(self.weight.max())

    @derived("", "edges with a share of the steps above 1e-6", kind="count")
    def edges_used(self) -> int:
        return int((self.weight > _USED).sum())

    @derived("", "by what share a walk is better, to first order, at most", kind="residual")
    def gap(self) -> float | None:
        return None if self.certificate is None else float(self.certificate.residual)

    @derived("", "steps of the solver", kind="count")
    def iterations(self) -> int | None:
        return None if self.certificate is None else int(self.certificate.iterations)

    mean_idleness, worst_idleness = idleness_over_vertices(
        "steps", lambda self: steps_between_visits(self.shares)
    )

    @property
    def _directions(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The starts and the ends of the edges, in both directions."""
        tail, head = self.graph.edges.T
        return [(tail, head), (head, tail)]
