import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float

from ...base.certificate import Certificate, Outcome
from ...base.quantities import derived, from_part, quantity
from ...mapping import Chain
from ...markov import mean_first_arrival
from ...optimize import Graph
from ...optimize.checked import check_count
from ..team.charging import Charged
from ..team.division import Division
from ..team.durations import Timed
from ..team.idleness import (
    Idleness,
    RobotShares,
    idleness_over_vertices,
    long_run,
    steps_between_visits,
)
from ..team.news import News
from ..team.times import move_times, names_of
from .arrival import captured_by_any, walk_capture_probabilities
from .game import StrategyGame
from .measures import Measures, measure
from .memory import MemoryPatrol
from .optimal.constraints import MetConstraints


# Largest number that solvers and scaling may return for a probability of 0.
_NOTHING = 1e-9
# Largest share of all steps that a solver may return for an unused edge.
_USED = 1e-6
# Entropy in nats per step below which the next step is predictable.
_FORESEEN = 0.01
MAX_ARRIVALS = 256
"Largest number of vertices for which first arrivals are computed, which then takes 10 s."


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class GraphPatrol(Measures):
    """The random walks of independent robots that patrol a graph, and their measures."""

    title: ClassVar[str] = "Random walk of a patroller on a graph"
    tables: ClassVar[Mapping[str, str]] = {"vertex": "vertices", "edge": "edges"}

    graph: Graph
    names: Sequence[str]
    goal: Annotated[str | None, quantity("", "objective of the walk")] = None
    value: Annotated[float | None, quantity("", "value of the objective")] = None
    certificate: Certificate | None = None
    "The accuracy of the optimum, or `None` if the walk is not an optimum."
    local: bool = False
    "`True` if the walk is only a local optimum, because the problem is not convex."
    bounds: MetConstraints | None = None
    "The constraints on the walk and how the walk meets them, or `None`."
    game: StrategyGame | None = None
    shares: RobotShares
    team: Float[np.ndarray, "robots vertices vertices"] | None = None
    "The transition matrix of each robot, if robots differ; the measures are then those of robot 0."
    timed: Timed | None = None
    "Times of the walk in seconds, if edges have travel times."
    by_steps: bool = False
    "`True` if the walk was optimised for times in steps although edges differ in travel time."
    division: Division | None = None
    "A comparison of robots that share the graph with robots that divide it, or `None`."
    news: News | None = None
    charged: Charged | None = None
    walks_with_memory: MemoryPatrol | None = None
    "The walks of robots with memory, or `None`. Other results are for the walk without memory."
    idleness: Idleness | None = None
    "The times between visits to vertices, for these walks and three other patrols, or `None`."
    weights_unused: bool = False
    "`True` if the file of the graph has weights of edges, which the walk does not use."
    robots: int = 1
    first_arrival: Annotated[
        Float[np.ndarray, "vertices"] | None,
        quantity("vertex", "mean steps until one patroller is there", "steps", kind="time"),
    ] = None
    "The mean time until any robot visits the vertex, if all start at random as in the long run."
    captured: Annotated[
        Float[np.ndarray, "vertices"] | None,
        quantity("vertex", "least chance of capture there", "1", kind="share"),
    ] = None
    "The probability that any robot arrives in time if each starts at its worst vertex."
    seed: int = 0
    "Seed of the recorded walks."

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
        """Measure the chain of one or several independent patrollers.

        **Arguments:**

        - `graph`: a connected graph.
        - `chain`: a chain that moves along edges of the graph, or stays.
        - `names`: names of the vertices; by default their numbers.
        - `robots`: number of robots.
        - `attack_time`: number of steps of an attack, a whole number, or array `[vertices]`.
        - further keywords: the other fields of [`GraphPatrol`][].

        Two random walks on a line of three vertices:

            >>> from jaxcell import patrol, record
            >>> graph = patrol.Graph([[0, 1], [1, 2]])
            >>> walk = patrol.random_walk(graph, [1, 1])
            >>> team = patrol.GraphPatrol.of(graph, walk, names="abc", robots=2, attack_time=2)
            >>> record.dataset(team).hitting_time.sel(start="a", target="c").round(6).item()
            4.0
            >>> team.captured.tolist()
            [0.75, 1.0, 0.75]
        """
        check_count("robots", robots)
        names = names_of(graph.vertices, names)
        measures = measure(chain)
        team = more.get("team")
        if robots > 1 and team is None and graph.vertices <= MAX_ARRIVALS:
            start = [measures.stationary] * robots
            arrivals = [
                mean_first_arrival([chain] * robots, start, vertex, throw=False).value
                for vertex in range(graph.vertices)
            ]
            more["first_arrival"] = np.array(arrivals)
        if attack_time is not None:
            walks = [measures.transition] if team is None else team
            each = [walk_capture_probabilities(graph, walk, attack_time) for walk in walks]
            more["captured"] = captured_by_any(np.broadcast_to(each, (robots, *each[0].shape)))
        alike = np.broadcast_to(measures.stationary, (robots, measures.stationary.size))
        more["shares"] = alike if team is None else long_run(team)
        return cls(**vars(measures), graph=graph, names=names, robots=robots, **more)

    def __post_init__(self) -> None:
        graph, vertices = self.graph, self.stationary.size
        if vertices != graph.vertices:
            raise ValueError(f"chain: expected {graph.vertices} vertices, got {vertices}")
        if len(self.names) != vertices:
            raise ValueError(f"names: expected {vertices}, one per vertex, got {len(self.names)}")
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
    def walks(self) -> Float[np.ndarray, "robots states states"]:
        """The transition matrix of each robot; its states include the memory, if any."""
        return self.matrices if self.walks_with_memory is None else self.walks_with_memory.chance

    @property
    def remarks(self) -> tuple[str, ...]:
        remarks = []
        if self.team is not None:
            remarks.append("robots walk differently; times and entropy are those of robot 0")
        if self.walks_with_memory is not None:
            remarks.append("times, shares and entropy above are those of the walk without memory")
        if self.weights_unused:
            remarks.append("the weights of edges in the file are not used; the walk has its own")
        if self.by_steps:
            remarks.append(
                "the walk is chosen by steps; the times in seconds are those it then has"
            )
        if self.timed is not None and self.game is not None:
            remarks.append("the game counts steps, not seconds")
        if self.local:
            remarks.append(
                "the walk is a local optimum, the best that several starts lead to; another may be "
                "better"
            )
        if self.certificate is not None and self.certificate.outcome is not Outcome.CONVERGED:
            remarks.append(
                f"{self.certificate.outcome.value} (residual {self.certificate.residual:.3g}, "
                f"tolerance {self.certificate.tolerance:.3g})"
            )
        if self.robots > 1 and self.team is None and self.first_arrival is None:
            remarks.append(
                "the first arrival of any patroller is computed on graphs of up to "
                f"{MAX_ARRIVALS} vertices; other times are of one patroller"
            )
        left_out = int((self.stationary <= 0).sum())
        if left_out:
            remarks.append(f"in the long run the walk leaves out {left_out:,} of the vertices")
        if self.entropy_rate_nats < _FORESEEN:
            remarks.append(
                f"the walk is nearly deterministic, with {self.entropy_rate_nats:.1g} nats a step: "
                "an observer knows where the patroller goes"
            )
        return tuple(remarks)

    @derived("", "mean steps until the first patroller is at a vertex", "steps", kind="time")
    def mean_first_arrival(self) -> float | None:
        return None if self.first_arrival is None else float(self.first_arrival.mean())

    vertex = from_part("names", "vertex", "vertex", kind="coordinate")
    start = from_part("names", "start", "vertex of the row", kind="coordinate")
    target = from_part("names", "target", "vertex of the column", kind="coordinate")

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
        tail, head = self.graph.edges.T
        return np.stack([self.transition[tail, head], self.transition[head, tail]], axis=1)

    @derived("edge", "share of steps along it, mean over robots", "1", kind="share")
    def weight(self) -> Float[np.ndarray, "edges"]:
        flow = (self.shares[:, :, None] * self.matrices).mean(axis=0)
        tail, head = self.graph.edges.T
        return flow[tail, head] + flow[head, tail]

    @derived("", "largest share of the steps on one edge", kind="share")
    def largest_weight(self) -> float:
        return float(self.weight.max())

    @derived("", "edges with a share of the steps above 1e-6", kind="count")
    def edges_used(self) -> int:
        return int((self.weight > _USED).sum())

    @derived("", "relative improvement left, to first order, at most", kind="residual")
    def gap(self) -> float | None:
        return None if self.certificate is None else float(self.certificate.residual)

    iterations = from_part("certificate.iterations", "", "steps of the solver", kind="count")
    mean_idleness, worst_idleness = idleness_over_vertices(
        "steps", lambda self: steps_between_visits(self.shares)
    )
