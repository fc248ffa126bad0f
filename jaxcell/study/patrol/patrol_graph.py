import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from ... import optimize, patrol, space, verify as verification
from ...base import memory
from ...base.limits import MAX_VERTICES
from ...base.secondary import Secondary
from ..parameters import AtLeastOne, Needed, Only, Share
from ..study import Say, about, silent
from .graph_study import GraphStudy


if TYPE_CHECKING:
    import numpy as np


# The least travel time of a round in seconds, between vertices in one place.
_BRIEFEST = 1e-6
_CHANCE = "least chance that"


@dataclasses.dataclass(frozen=True, kw_only=True)
class PatrolGraph(GraphStudy):
    """Find a random walk that patrols a graph, and solve its game against an adversary."""

    name: ClassVar[str] = "patrol"
    command: ClassVar[str] = "patrol graph"
    example: ClassVar[str] = "@random --robots 2"
    task: ClassVar[str] = "patrol"

    strategy: Literal[
        "commute", "toward", "mixing", "kemeny", "entropy", "return-time", "capture"
    ] = "commute"
    """Aim of the walk: a short mean commute time (commute), shortest paths to --vertex (toward),
    fast convergence to the long-run distribution (mixing), a short mean time to a random vertex
    (kemeny), maximal entropy of steps (entropy) or of return times (return-time), or a high
    probability of capture within --attack-time (capture). With mixing, kemeny and return-time, all
    vertices have equal shares of time, or those in --visits, and a robot may stay at a vertex."""
    emphasis: Annotated[tuple[str, ...], Only(strategy="commute"), Only(game=True)] = ()
    """Two or more vertices to visit more often."""
    share: Share = 0.8
    """Minimum share of steps on the shortest closed tour through the vertices of --emphasis."""
    constraints: Annotated[Path | None, Only(strategy="commute", speed=False)] = None
    """JSON file of bounds on the shares of steps along edges and of time at vertices:
    {"constraints": [{"edges": [["a", "b"]], "most": 0.2}]}."""
    vertex: Annotated[str | None, Needed(strategy="toward")] = None
    """Vertex to walk toward."""
    paths: Annotated[AtLeastOne, Only(strategy="toward"), Only(game=True)] = 1
    """Number of shortest paths from each vertex that determine the walk toward a vertex. With one
    path, as in Table 4.2 of Alam 2018, the walk takes the shortest path."""
    attack_times: Annotated[Path | None, Only(strategy="capture", attack_time=False)] = None
    """File with a line "vertex steps" for each vertex: the duration of an attack on it in steps, or
    in seconds with --speed."""
    memory_states: Annotated[
        AtLeastOne, Only(strategy="capture", division=False, base=False, charger=False)
    ] = 1
    """Number of memory states of a robot; its state may change at each move. The result compares
    walks with 1, 2, 4, ... states, a tour, and an upper bound."""
    visits: Annotated[
        Path | None, Only(strategy=("mixing", "kemeny", "entropy", "return-time"))
    ] = None
    """File with a line "vertex weight" per vertex; shares of time are proportional to weights."""
    values: Annotated[Path | None, Only(game=True)] = None
    """File with a line for each vertex: its name and one, two or four numbers. They are the value
    of the vertex to the patroller, its value to the adversary if that differs, and, for a capture
    at the vertex, the reward of the patroller and the cost to the adversary."""
    game: bool = False
    """Also find the best probabilities of choosing the commute walk or a walk toward a vertex,
    against an adversary who knows these probabilities."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.emphasis) == 1:
            raise ValueError("emphasis: expected two or more vertices, got one")
        for i, name in enumerate(self.emphasis):
            if name in self.emphasis[:i]:
                raise ValueError(f"emphasis: vertex {name!r} comes twice")

    def memory(self, written: bool = False) -> float | int:
        graph, _ = patrol.load_graph(self.file)
        weighted = self.strategy == "commute" or self.game
        states = graph.vertices * self.memory_states
        needed = space.estimates.walk(states, len(graph.edges), weighted)
        doing = f"a walk on {graph.vertices:,} vertices and {len(graph.edges):,} edges"
        memory.check(needed, doing, "expected a smaller graph, or another strategy")
        return needed

    def run(self, say: Say = silent) -> "patrol.GraphPatrol":
        import numpy as np

        graph, names = patrol.load_graph(self.file)
        if self.speed is not None and self.time_unit is None:
            unit = 1.0
            if self._guards and graph.lengths.any():
                unit = patrol.team.time_unit_of(graph, self.speed, self._attack_times(names))
            return dataclasses.replace(self, time_unit=unit).run(say)
        self._check(graph, names)
        emphasis = self.vertices(names, "emphasis", *self.emphasis) or None
        for name, vertex in (("base", self.base), ("charger", self.charger)):
            self.vertices(names, name, *([] if vertex is None else [vertex]))
        say(f"seeking a walk on {graph.vertices:,} vertices")
        walk, game, beside = self._walks(graph, names, emphasis, say), None, Secondary()
        if self.game:
            say("mixing strategies")
            values = self.values
            stakes = None if values is None else patrol.files.load_stakes(values, names)
            game = beside.compute(
                "the game",
                lambda: patrol.strategy_game(
                    graph, emphasis, self.share, paths=self.paths, names=names, stakes=stakes
                ),
            )
        options: dict[str, Any] = {"names": names, "robots": self.robots, "seed": self.seed}
        options["weights_unused"] = patrol.files.has_weights(self.file)
        by_steps = ("mixing", "kemeny", "entropy", "return-time")
        options["by_steps"] = self.speed is not None and self.strategy in by_steps
        if self.speed is not None:
            longer = self.unit * self.times(graph) - graph.lengths / self.speed
            options["time_unit"] = self.unit
            options["rounded_up"] = float(longer.max())
        patrolled = patrol.GraphPatrol.of(graph, **walk, game=game, **options)
        if self.memory_states > 1:
            walks_with_memory = beside.compute(
                "the search for walks with memory",
                lambda: patrol.walks.memory_patrol(
                    graph,
                    self._attack(names),
                    self.memory_states,
                    patrolled.matrices,
                    travel_times=self.times(graph),
                    names=names,
                    say=say,
                ),
            )
            patrolled = dataclasses.replace(patrolled, walks_with_memory=walks_with_memory)
        if self.robots > 1 or self._guards:
            attack = self._attack_times(names) if self._guards else None
            given: dict[str, Any] = {"names": names}
            if self.speed is not None:
                # A round needs no whole times.
                exact = np.maximum(graph.lengths / self.speed, _BRIEFEST)
                given |= {"travel_times": exact, "unit": 1.0}
            round = beside.compute(
                "the evenly spaced round",
                lambda: patrol.team.evenly_spaced_round(graph, self.robots, attack, **given),
            )
            patrolled = dataclasses.replace(patrolled, round=round)
        left_out = patrolled.left_out + beside.left_out
        patrolled = dataclasses.replace(patrolled, left_out=left_out)
        return dataclasses.replace(patrolled, **self.more(patrolled, say))

    def headline(self, spec: dict[str, Any]) -> str:
        return f"{self.file}: {self.strategy}"

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        compared = verification.compare_walk(result)
        if self.strategy == "commute" and self.division != "partition":
            emphasis = self.vertices(result.names, "emphasis", *self.emphasis)
            rules = self._constraints(result.graph, result.names)
            compared += verification.compare_commute(result, emphasis, self.share, rules)
        if result.game is None:
            return compared
        return [*compared, *verification.compare_game(result.game)]

    def _check(self, graph: "optimize.Graph", names: Sequence[str]) -> None:
        """Raise if the graph is too large or not connected, or if an attack is too short."""
        from ...base.connected import vertices_apart

        if self.speed is not None and graph.xy is None and graph.ways is None:
            raise ValueError(
                f"speed: edges of {self.file} have no lengths, and its vertices no positions"
            )
        if graph.vertices * self.memory_states > MAX_VERTICES:
            raise ValueError(
                f"{self.file}: {graph.vertices:,} vertices with {self.memory_states} states of "
                f"memory are too many; times are computed for at most {MAX_VERTICES:,} states"
            )
        apart = vertices_apart(graph.vertices, graph.edges)
        if apart is not None:
            raise ValueError(
                f"{self.file}: no walk leads from vertex {names[apart[1]]!r} to "
                f"{names[apart[0][0]]!r}; expected a connected graph"
            )
        if self.division != "partition":
            self._check_reach(graph, names, 1 if self.division == "shared" else self.robots)

    @property
    def _guards(self) -> bool:
        """`True` if there are attacks."""
        return self.attack_time is not None or self.attack_times is not None

    def _check_reach(self, graph: "optimize.Graph", names: Sequence[str], robots: int) -> None:
        """Raise if robots are too slow for the graph or, in a team, for their parts of it."""
        from ...patrol.walks import arrival

        if not self._guards:
            return
        numbers = arrival.whole_numbers(graph, self._attack(names), self.times(graph))
        try:
            if robots == 1:
                arrival.check_reach(*numbers, names, self.unit)
            elif arrival.out_of_reach(*numbers) is not None and self.strategy == "capture":
                arrival.parts_within_reach(graph, *numbers, robots, names, self.unit)
        except ValueError as error:
            if self.speed is None:
                raise
            raise ValueError(
                f"{error}, or a smaller `time_unit`; times are rounded to units of "
                f"{self.unit:.4g} s"
            ) from None

    def _walks(
        self, graph: "optimize.Graph", names: Sequence[str], emphasis: list[int] | None, say: Say
    ) -> dict[str, Any]:
        """Find the walks of all robots. With `division`, compare sharing and dividing the graph."""
        import numpy as np
        import scipy.sparse

        from ...mapping import Chain

        if self.division is None:
            return self._walk(graph, names, emphasis, self.robots)
        with about("robots"):
            region = patrol.team.divide_graph(graph, self.robots, names=names)
        parts, matrices = [], []
        for robot in range(self.robots):
            say(f"seeking a walk on part {robot + 1} of {self.robots}")
            inside = np.flatnonzero(region == robot)
            part = patrol.team.part_of_graph(graph, inside)
            called = [names[v] for v in inside.tolist()]
            self._check_reach(part, called, 1)
            parts.append(self._walk(part, called, None, 1))
            within = parts[-1]["chain"].to_scipy().toarray()
            matrices.append(patrol.team.walk_in_part(graph, inside, within))
        worst = min(parts, key=lambda part: part["value"] or 0.0)
        divided = worst | {
            "chain": Chain.from_scipy(scipy.sparse.csr_array(matrices[0])),
            "team": np.stack(matrices),
            "travel_times": self.times(graph),
        }
        shared = None
        try:
            self._check_reach(graph, names, 1)
        except ValueError:
            if self.division == "shared":
                raise
        else:
            say(f"seeking walks of {self.robots} robots on the whole graph")
            shared = self._walk(graph, names, emphasis, self.robots)
        walks = divided if shared is None or self.division == "partition" else shared
        return walks | {"division": _compared(shared, divided, region, self.robots)}

    def _constraints(
        self, graph: "optimize.Graph", names: Sequence[str]
    ) -> "list[optimize.Linear]":
        file = self.constraints
        return [] if file is None else patrol.walks.load_constraints(file, graph, names)

    def _walk(
        self, graph: "optimize.Graph", names: Sequence[str], emphasis: list[int] | None, robots: int
    ) -> dict[str, Any]:
        """Find the walk of the strategy; return it as keyword arguments of `GraphPatrol.of`."""
        import numpy as np

        if self.strategy == "toward":
            (vertex,) = self.vertices(names, "vertex", str(self.vertex))
            return {"chain": patrol.toward(graph, vertex, self.paths), "value": None}
        # With free shares of time, the best walks leave some vertices out.
        even = np.full(graph.vertices, 1 / graph.vertices)
        visits = None
        if self.visits is not None:
            visits = patrol.files.load_values(self.visits, names)
            visits = even = visits / visits.sum()
        best: Any
        team: Any = None
        who = "one patroller captures" if robots == 1 else f"{robots} patrollers capture"
        within = f"{self.attack_time} {'steps' if self.speed is None else 's'}"
        within = "its attack time" if self.attack_time is None else within
        goal = {
            "return-time": "return-time entropy, in nats",
            "capture": f"{_CHANCE} {who} within {within}",
        }.get(self.strategy)
        bounds = None
        if self.strategy == "commute":
            rules = self._constraints(graph, names)
            best = optimize.minimum_commute(
                graph, emphasis, self.share, durations=self.times(graph), constraints=rules
            )
            chain = patrol.random_walk(graph, best.weights)
            if rules:
                bounds = patrol.walks.MetConstraints(rules, best.weights, best.prices)
        elif self.strategy == "capture":
            best = patrol.maximin_capture(
                graph,
                self._attack(names),
                travel_times=self.times(graph),
                robots=robots,
                throw=False,
            )
            chain, team = best.chains[0], best.matrices if robots > 1 else None
        else:
            seek: Any = {
                "mixing": lambda: optimize.fastest_mixing(graph, even),
                "kemeny": lambda: patrol.walks.minimum_kemeny(graph, even, stay=True, throw=False),
                "entropy": lambda: patrol.walks.maximum_entropy_rate(
                    graph, visits, stay=visits is not None
                ),
                "return-time": lambda: patrol.walks.maximum_return_time_entropy(
                    graph, even, stay=True, throw=False
                ),
            }[self.strategy]
            best = seek()
            chain = best.chain
        value = None if goal is None else best.value
        return {
            "attack_time": self._attack(names) if self._guards else None,
            "travel_times": self.times(graph),
            "bounds": bounds,
            "chain": chain,
            "team": team,
            "certificate": best.certificate,
            "goal": goal,
            "value": value,
            "local": self.strategy in ("kemeny", "return-time", "capture"),
        }

    def _attack_times(self, names: Sequence[str]) -> Any:
        """Return the durations of attacks in steps or, with a speed, in seconds."""
        if self.attack_times is None:
            return self.attack_time
        return patrol.files.load_values(self.attack_times, names, whole=self.speed is None)

    def _attack(self, names: Sequence[str]) -> "np.ndarray":
        """Return the durations of attacks in steps or, with a speed, in units of `time_unit`."""
        import numpy as np

        times = np.asarray(self._attack_times(names))
        return np.floor(times / self.unit + 1e-9).astype(np.int64)


def _compared(
    shared: dict[str, Any] | None, divided: dict[str, Any], region: "np.ndarray", robots: int
) -> "patrol.team.Division":
    """Compare robots that divide the graph with robots that share it, if `shared` is given."""
    import numpy as np

    rows, nothing = [], np.full(region.size, np.nan)
    for walks in (shared, divided):
        visits = nothing
        if walks is not None:
            team = walks["team"]
            if team is None:
                team = np.stack([walks["chain"].to_scipy().toarray()] * robots)
            visits = patrol.team.steps_between_visits(patrol.team.long_run(team))
        value = np.nan if walks is None or walks["value"] is None else walks["value"]
        rows.append((visits.mean(), visits.max(), value))
    mean, worst, value = np.array(rows).T
    caught = value if str(divided["goal"]).startswith(_CHANCE) else None
    return patrol.team.Division(["shared", "partition"], mean, worst, caught, region)
