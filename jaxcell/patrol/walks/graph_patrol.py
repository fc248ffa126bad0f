import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.special
from jaxtyping import Float

from ...base.certificate import Certificate
from ...base.formatting import percent
from ...base.quantities import derived, from_part, quantity
from ...base.secondary import Secondary
from ...mapping import Chain
from ...markov import mean_first_arrival
from ...optimize import Graph
from ...optimize.validation import check_count
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
from ..team.rounds import Round
from ..team.times import check_whole, move_times, names_of
from .arrival import captures_over_time
from .game import StrategyGame
from .measures import Measures, measure
from .memory import MemoryPatrol
from .optimal.constraints import MetConstraints


# Largest number that solvers and scaling may return for a probability of 0.
_NOTHING = 1e-9
# Difference below which two probabilities, or two times in seconds, are the same.
_SAME = 1e-6
# Largest share of all steps that a solver may return for an unused edge.
_USED = 1e-6
# Entropy in nats per step below which the next step is predictable.
_FORESEEN = 0.01
# Largest number of steps after which a robot may still not have arrived, in first arrivals.
_STEPS = 2**17
MAX_ARRIVALS = 256
"Largest number of vertices for which first arrivals are computed, which then takes 10 s."


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class GraphPatrol(Measures):
    """The random walks of independent robots that patrol a graph, and their measures."""

    title: ClassVar[str] = "Random walk of a patroller on a graph"
    tables: ClassVar[Mapping[str, str]] = {"vertex": "vertices", "edge": "edges"}
    leading: ClassVar[tuple[str, ...]] = (
        "least_capture",
        "least_captured",
        "least_blind_capture",
        "time_unit",
        "goal",
        "value",
        "mean_first_arrival",
        "mean_idleness",
        "worst_idleness",
    )

    graph: Graph
    names: Sequence[str]
    goal: Annotated[str | None, quantity("", "objective of the walk")] = None
    value: Annotated[float | None, quantity("", "value of the objective")] = None
    toward: int | None = None
    "The vertex to which the walk leads, or `None`."
    certificate: Certificate | None = None
    "The accuracy of the optimum, or `None` if the walk is not an optimum."
    local: bool = False
    "`True` if the walk is only a local optimum, because the problem is not convex."
    bounds: MetConstraints | None = None
    "The constraints on the walk and how the walk meets them, or `None`."
    game: StrategyGame | None = None
    shares: RobotShares
    team: Float[np.ndarray, "robots vertices vertices"] | None = None
    """The transition matrix of each robot, if robots differ. Other measures are then those of a
    robot drawn at random: its probabilities of steps, its shares of time and its entropy."""
    timed: Timed | None = None
    "Times of the walk in seconds, if edges have travel times."
    by_steps: bool = False
    "`True` if the walk was optimised for times in steps although edges differ in travel time."
    time_unit: Annotated[float | None, quantity("", "unit of time", "s", kind="time")] = None
    "The unit of which travel times are multiples, if edges have travel times."
    rounded_up: float = 0.0
    "The largest time in seconds by which the travel time of an edge is rounded up, or 0."
    division: Division | None = None
    "A comparison of robots that share the graph with robots that divide it, or `None`."
    news: News | None = None
    charged: Charged | None = None
    walks_with_memory: MemoryPatrol | None = None
    "The walks of robots with memory, or `None`. Other results are for the walk without memory."
    idleness: Idleness | None = None
    "The times between visits to vertices, for these walks and three other patrols, or `None`."
    round: Round | None = None
    "The closed tour with evenly spaced robots on a shared clock, to compare, or `None`."
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
    """The probability that any robot arrives in time if each starts at the worst of the vertices
    that it visits in the long run, so that the adversary sees the robots."""
    blind_captured: Annotated[
        Float[np.ndarray, "vertices"] | None,
        quantity("vertex", "capture there of an attack at any time", "1", kind="share"),
    ] = None
    """The probability that any robot arrives in time if the attack begins at a random time, so that
    the adversary does not see the robots."""
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
        travel_times: Any = None,
        team: Float[np.ndarray, "robots vertices vertices"] | None = None,
        **others: Any,
    ) -> "GraphPatrol":
        """Measure the chain of one or several independent patrollers.

        **Arguments:**

        - `graph`: a connected graph.
        - `chain`: a chain that moves along edges of the graph, or stays.
        - `names`: names of the vertices; by default their numbers.
        - `robots`: number of robots.
        - `attack_time`: duration of an attack, a whole number, or array `[vertices]`.
        - `travel_times`: array `[edges]`, whole numbers, travel times for attacks; by default 1.
        - `team`: the transition matrix of each robot, if robots differ, in place of `chain`.
        - further keywords: fields of [`GraphPatrol`][] that do not follow from the walk.

        Two random walks on a line of three vertices:

            >>> from jaxcell import patrol, record
            >>> graph = patrol.Graph([[0, 1], [1, 2]])
            >>> walk = patrol.random_walk(graph, [1, 1])
            >>> team = patrol.GraphPatrol.of(graph, walk, names="abc", robots=2, attack_time=2)
            >>> record.dataset(team).hitting_time.sel(start="a", target="c").round(6).item()
            4.0
            >>> team.captured.tolist(), team.blind_captured.tolist()
            ([0.75, 1.0, 0.75], [0.75, 1.0, 0.75])
        """
        check_count("robots", robots)
        if team is None:
            measures, chains = measure(chain), [chain] * robots
            shares = np.broadcast_to(measures.stationary, (robots, chain.cells))
            walks = np.broadcast_to(measures.transition, (robots, chain.cells, chain.cells))
        else:
            measures, chains = _of_team(team), [Chain.from_scipy(walk) for walk in team]
            shares, walks = long_run(team), team
        beside, first_arrival, captured, blind_captured = Secondary(), None, None, None
        if robots > 1 and graph.vertices <= MAX_ARRIVALS:
            first_arrival = beside.compute(
                "the mean time until the first patroller arrives",
                lambda: _first_arrivals(chains, shares),
            )
        if attack_time is not None:
            attack = check_whole("attack_time", attack_time, graph.vertices, "vertex")
            given = walks, shares, int(attack.max()), travel_times
            captured, blind_captured = (
                each[attack, range(attack.size)] for each in captures_over_time(graph, *given)
            )
        return cls(
            **vars(measures) | {"left_out": measures.left_out + beside.left_out},
            graph=graph,
            names=names_of(graph.vertices, names),
            robots=robots,
            team=team,
            shares=shares,
            first_arrival=first_arrival,
            captured=captured,
            blind_captured=blind_captured,
            **others,
        )

    def __post_init__(self) -> None:
        graph, vertices = self.graph, self.stationary.size
        if vertices != graph.vertices:
            raise ValueError(f"chain: expected {graph.vertices} vertices, got {vertices}")
        names_of(vertices, self.names)
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
            remarks.append(
                "robots walk differently; probabilities of steps, shares of time and entropy are "
                "those of a robot drawn at random"
            )
            if (np.count_nonzero(self.shares, axis=0) == 1).all():
                remarks.append("each robot stays in its own part of the graph")
        if self.round is not None and self.least_capture is not None:
            watched, least = self.round.watched_capture or 0.0, self.least_capture
            at_any_time = self.round.least_capture or 0.0
            blind, how = self.least_blind_capture or 0.0, self.round.followers
            if watched > least + _SAME:
                remarks.append(
                    f"a round captures more than {least:.3f}: with {how}, no attack succeeds"
                )
            elif at_any_time > blind + _SAME:
                remarks.append(
                    f"a round captures attacks that begin at a random time with {at_any_time:.3f} "
                    f"at least, and the walk with {blind:.3f} (with {least:.3f} if the adversary "
                    f"sees it): {how}"
                )
        if self.walks_with_memory is not None:
            remarks.append("times, shares and entropy above are those of the walk without memory")
        if self.rounded_up > _SAME:
            remarks.append(
                "the walk has travel times rounded up to whole units of time, by up to "
                f"{self.rounded_up:.3g} s; with a smaller --time-unit they are nearer to the truth"
            )
        if self.by_steps:
            remarks.append(
                "the walk is chosen by steps; the times in seconds are those it then has"
            )
        if self.timed is not None and self.game is not None:
            remarks.append("the game counts steps, not seconds")
        if self.local:
            remarks.append(
                "the walk is a local optimum of a search from several starts; another walk may be "
                "better"
            )
        if self.certificate is not None and not self.certificate.converged:
            remarks.append(
                f"{self.certificate.outcome.value} (residual {self.certificate.residual:.3g}, "
                f"tolerance {self.certificate.tolerance:.3g})"
            )
        if self.robots > 1 and self.stationary.size > MAX_ARRIVALS:
            remarks.append(
                "the first arrival of any patroller is computed on graphs of up to "
                f"{MAX_ARRIVALS} vertices"
                + "; other times are of one patroller"
                * (self.team is None)
            )
        left_out = int((self.stationary <= 0).sum())
        if left_out:
            remarks.append(f"in the long run the walk leaves out {left_out:,} of the vertices")
        if self.entropy_rate_nats < _FORESEEN:
            remarks.append(
                f"the walk is nearly deterministic, with {self.entropy_rate_nats:.1g} nats a step: "
                "an observer knows where the patroller goes"
            )
        return (*remarks, *self.left_out)

    @derived(
        "",
        "least chance of capture, if the adversary sees the patrollers at vertices",
        "1",
        kind="share",
    )
    def least_capture(self) -> float | None:
        captured = self._captured
        return None if captured is None else float(captured.min())

    @derived("", "least capture of attacks that begin at any time", "1", kind="share")
    def least_blind_capture(self) -> float | None:
        walks = self.walks_with_memory
        blind = self.blind_captured if walks is None else walks.blind_captured
        return None if blind is None else float(blind.min())

    @derived("", "vertex where it is least", kind="text")
    def least_captured(self) -> str | None:
        captured = self._captured
        if captured is None:
            return None
        least = np.flatnonzero(captured <= captured.min() + _SAME)
        rest = ("", " and 1 other", f" and {least.size - 1} others")[min(least.size - 1, 2)]
        return self.names[int(least[0])] + rest

    @property
    def _captured(self) -> Float[np.ndarray, "vertices"] | None:
        """The least probability of capture at each vertex by the walks that robots take."""
        walks = self.walks_with_memory
        return self.captured if walks is None else walks.captured

    @property
    def answer(self) -> tuple[str, ...]:
        lines = [] if self.game is None else list(self.game.answer)
        if self.toward is not None and self.mean_time_to is not None:
            steps, name = self.mean_time_to[self.toward], self.names[self.toward]
            lines.append(f"The walk takes {steps:.3g} steps to vertex {name} in the mean.")
        if (least := self.least_capture) is not None:
            blind = self.least_blind_capture
            round = 0.0 if self.round is None else self.round.least_capture or 0.0
            if round > max(least, blind or 0.0) + _SAME:
                lines.append(
                    f"A shared clock stops at least {percent(round)} of blind attacks: `jaxcell "
                    "patrol guard` finds the rounds. Without it:"
                )
            unseen = "" if blind is None else f" ({percent(blind)} if the adversary is blind)"
            lines.append(
                f"An attack is stopped with a probability of at least {percent(least)}{unseen}; "
                f"it is least at vertex {self.least_captured}."
            )
        idle, unit = self.worst_idleness, "steps"
        if self.timed is not None:
            idle, unit = self.timed.worst_idleness, "s"
        if idle is not None and not np.isfinite(idle):
            missed = f"{np.count_nonzero(self.stationary <= 0):,} of {self.stationary.size:,}"
            lines.append(f"In the long run the walk leaves out {missed} vertices.")
        elif idle is not None:
            lines.append(f"Every vertex is visited at least every {idle:.3g} {unit} in the mean.")
        return tuple(lines)

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


def _first_arrivals(
    chains: Sequence[Chain], shares: Float[np.ndarray, "robots vertices"]
) -> Float[np.ndarray, "vertices"]:
    """Compute the mean steps until any robot is at each vertex, from starts as in the long run."""
    starts, vertices = list(shares), range(shares.shape[1])
    arrivals = [mean_first_arrival(chains, starts, v, max_steps=_STEPS) for v in vertices]
    return np.array([arrival.value for arrival in arrivals])


def _of_team(team: Float[np.ndarray, "robots vertices vertices"]) -> Measures:
    """Measure the steps of a robot drawn at random from a team whose robots walk differently."""
    shares = long_run(team)
    mean = shares.mean(axis=0)
    # At vertices that no robot visits in the long run, all robots count equally.
    weight = np.where(mean > 0, shares, 1.0)
    weight /= weight.sum(axis=0)
    entropy = (shares * scipy.special.entr(team).sum(axis=2)).sum(axis=1).mean()
    return Measures(
        transition=(weight[:, :, None] * team).sum(axis=0),
        stationary=mean,
        entropy_rate_nats=float(entropy),
    )
