import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

import tyro

from ... import optimize, patrol, space, verify as verification
from ...base import memory
from ...base.formatting import did_you_mean
from ...base.limits import MAX_VERTICES
from ...base.secondary import Secondary
from ..batches import Numbers, stacked
from ..parameters import AtLeastOne, Headings, Limit, Needed, Only, Share, Unit
from ..study import Say, Study, Wanted, every as all_of_them, scalars, silent


if TYPE_CHECKING:
    import os

    import numpy as np

    GraphFile: TypeAlias = str | os.PathLike[str] | optimize.GraphLike
    Vertex: TypeAlias = str | int
    """The name of a vertex."""
else:
    GraphFile, Vertex = Path | Any, str


# Steps, or seconds if travel times are known.
_Time: TypeAlias = int | Annotated[int, Unit("", "s"), Only(speed=True)]
# Parameters that may name vertices outside a part of the graph.
_OF_VERTICES = ("vertex", "emphasis", "visits", "attack_times", "constraints")
# The least travel time of a round in seconds, between vertices in one place.
_BRIEFEST = 1e-6
# The strategies whose walks do not depend on travel times.
_BY_STEPS = ("mixing", "kemeny", "entropy", "return-time")


@dataclasses.dataclass(frozen=True, kw_only=True)
class PatrolGraph(Study):
    """Find a random walk that patrols a graph, and solve its game against an adversary."""

    name: ClassVar[str] = "patrol"
    command: ClassVar[str] = "patrol graph"
    example: ClassVar[str] = "@random --robots 2"
    task: ClassVar[str] = "patrol"
    varied: ClassVar[tuple[str, ...]] = ("attack_time",)
    headings: ClassVar[Headings] = {
        "How may a robot walk?": ("share", "constraints", "paths", "memory_states"),
        "What can an adversary do?": ("attack_times", "values", "time_unit"),
        "How is the file read?": ("weight",),
        "How do robots work together?": ("division", "base", "charger", "every", "baselines"),
    }

    file: tyro.conf.Positional[Annotated[GraphFile, tyro.conf.arg(constructor=Path)]] = (
        dataclasses.field(kw_only=False)
    )
    """Graph: a name such as @eight, or a file: node-link .json, .graphml, .gml, .adjlist, .graph of
    patrolling_sim, or a list of vertices and edges in .edges or .txt. If vertices have no
    positions, all edges have the same length."""
    strategy: Literal[
        "commute", "toward", "mixing", "kemeny", "entropy", "return-time", "capture"
    ] = "commute"
    """Aim of the walk: a short mean commute time (commute), shortest paths to --vertex (toward),
    fast convergence to the long-run distribution (mixing), a short mean time to a random vertex
    (kemeny), maximal entropy of steps (entropy) or of return times (return-time), or a high
    probability of capture within --attack-time (capture). With mixing, kemeny and return-time, all
    vertices have equal shares of time, or those in --visits, and a robot may stay at a vertex."""
    emphasis: Annotated[tuple[Vertex, ...], Only(strategy="commute"), Only(game=True)] = ()
    """Two or more vertices to visit more often."""
    share: Share = 0.8
    """Minimum share of steps on the shortest closed tour through the vertices of --emphasis."""
    constraints: Annotated[Path | None, Only(strategy="commute", speed=False)] = None
    """JSON file of bounds on the shares of steps along edges and of time at vertices:
    {"constraints": [{"edges": [["a", "b"]], "most": 0.2}]}."""
    vertex: Annotated[Vertex | None, Needed(strategy="toward")] = None
    """Vertex to walk toward."""
    paths: Annotated[AtLeastOne, Only(strategy="toward"), Only(game=True)] = 1
    """Number of shortest paths from each vertex that determine the walk toward a vertex. With one
    path, as in Table 4.2 of Alam 2018, the walk takes the shortest path."""
    attack_times: Annotated[Path | None, Only(attack_time=False)] = None
    """File with a line "vertex steps" for each vertex: the duration of an attack on it in steps, or
    in seconds with --speed."""
    memory_states: Annotated[AtLeastOne, Only(strategy="capture")] = 1
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
    attack_time: Annotated[_Time | None, Only(attack_times=False)] = None
    """Duration of an attack in steps, or in seconds with --speed. The strategy capture needs it, or
    --attack-times; of other walks it only measures the capture."""
    robots: AtLeastOne = 1
    """Number of patrollers, which walk independently."""
    division: Annotated[
        Literal["shared", "partition"] | None, Only(robots=True, memory_states=False)
    ] = None
    """Division of the graph among several robots: all patrol the whole graph (shared), or each
    patrols a part of it (partition). The result compares both. By default all patrol the whole
    graph, and nothing is compared. A walk on a part has no options that name vertices."""
    speed: Annotated[float, Unit("", "m/s"), Limit(gt=0)] | None = None
    """Speed in metres per second, which determines the travel time of each edge. By default an edge
    takes one step."""
    time_unit: Annotated[Annotated[float, Unit("", "s"), Limit(gt=0)] | None, Only(speed=True)] = (
        None
    )
    """Unit of time in seconds. Travel times of edges are rounded up to multiples of this unit, and
    durations of attacks down, so that the walk captures at least what is computed. A smaller unit
    takes longer. By default it is 1 s or, with attacks, a fraction of the longest attack down to
    1/24, for which times are rounded least."""
    base: Annotated[Vertex | None, Only(memory_states=False)] = None
    """Base station: a vertex where robots report news. The result contains the age of the news at
    the base."""
    charger: Annotated[Vertex | None, Only(speed=False, memory_states=False)] = None
    """Vertex to which each robot must return within --every steps. The walk is changed to meet this
    condition; with --attack-time, a new walk is optimized under this condition instead."""
    every: Annotated[int | None, Needed(charger=True)] = None
    """Largest number of steps between two visits to the charger."""
    baselines: bool = False
    """Simulate the times between visits to a vertex: for this walk, for robots on a tour, for
    robots that choose a neighbour uniformly, and for robots that choose the neighbour whose last
    visit is longest ago."""
    seed: int = 0
    """Seed of the recorded walk, and of simulations."""
    weight: str | None = None
    """Attribute of edges that is their length, such as weight; by default length. In a list of
    edges, the third word of an edge is its length then, whatever the name."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.strategy == "capture" and not self.guards:
            raise ValueError(
                "attack_time: it is needed with `strategy` capture and without `attack_times`"
            )
        if len(self.emphasis) == 1:
            raise ValueError("emphasis: expected two or more vertices, got one")
        for i, name in enumerate(self.emphasis):
            if name in self.emphasis[:i]:
                raise ValueError(f"emphasis: vertex {name!r} comes twice")
        for name in _OF_VERTICES:
            if self.division is not None and getattr(self, name):
                raise ValueError(f"division: a part of the graph may lack vertices of `{name}`")

    def memory(self, written: bool = False) -> float | int:
        graph, _ = patrol.load_graph(self.file, self.weight)
        weighted = self.strategy == "commute" or self.game
        states = graph.vertices * self.memory_states
        needed = space.estimates.walk(states, len(graph.edges), weighted)
        doing = f"a walk on {graph.vertices:,} vertices and {len(graph.edges):,} edges"
        memory.check(needed, doing, "expected a smaller graph, or another strategy")
        return needed

    def run(self, say: Say = silent) -> "patrol.GraphPatrol":
        from .strategies import find_walks

        graph, names = patrol.load_graph(self.file, self.weight)
        if self.speed is not None and self.time_unit is None:
            unit = 1.0
            if self.guards and graph.lengths.any():
                unit = patrol.team.time_unit_of(graph, self.speed, self._attack_times(names))
            return dataclasses.replace(self, time_unit=unit).run(say)
        self._check(graph, names)
        say(f"seeking a walk on {graph.vertices:,} vertices")
        walk, division = find_walks(self, graph, names, say)
        beside = Secondary()
        patrolled = patrol.GraphPatrol.of(
            graph,
            **vars(walk),
            names=names,
            robots=self.robots,
            attack_time=self.attack(names) if self.guards else None,
            travel_times=self.times(graph),
            division=division,
            game=self._game(graph, names, beside, say),
            by_steps=self.speed is not None and self.strategy in _BY_STEPS,
            time_unit=self.time_unit,
            rounded_up=self._rounded_up(graph),
            seed=self.seed,
        )
        with_memory = self._walks_with_memory(patrolled, beside, say)
        patrolled = dataclasses.replace(patrolled, walks_with_memory=with_memory)
        return dataclasses.replace(
            patrolled,
            round=self._round(patrolled, beside),
            timed=self._timed(patrolled, beside),
            news=self._news(patrolled, beside, say),
            charged=self._charged(patrolled, beside, say),
            idleness=self._idleness(patrolled, beside, say),
            left_out=patrolled.left_out + beside.left_out,
        )

    def numbers(self, columns: "Mapping[str, np.ndarray]", wanted: Wanted = all_of_them) -> Numbers:
        if not columns:
            return super().numbers(columns, wanted)
        import numpy as np

        each, which = np.unique(columns["attack_time"], return_inverse=True)
        members = [dataclasses.replace(self, attack_time=time) for time in each.tolist()]
        own_unit = self.speed is not None and self.time_unit is None
        if self.strategy == "capture" or own_unit:
            return stacked([scalars(one.run(), (), wanted) for one in members], which)
        # The walk, and all else that does not depend on attacks, is that of the first member.
        result = members[0].run()
        found = scalars(result, (), wanted)
        attacks = np.array([int(one.attack(result.names)) for one in members])
        team = result.graph, result.matrices, result.shares
        captures = patrol.walks.captures_over_time(
            *team, attacks[-1].item(), self.times(result.graph)
        )
        for name, part in zip(("least_capture", "least_blind_capture"), captures, strict=True):
            if name in found:
                found[name] = found[name][0], np.asarray(part)[attacks].min(axis=1)[which]
        return found

    def headline(self, spec: dict[str, Any]) -> str:
        return f"{spec['file']}: {self.strategy}"

    def spec(self, result: "patrol.GraphPatrol") -> dict[str, Any]:  # type: ignore[override]
        spec = super().spec(result)
        return spec if self.speed is None else spec | {"time_unit": result.time_unit}

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        compared = verification.compare_walk(result)
        if self.strategy == "commute" and self.division != "partition":
            emphasis = self.vertices(result.names, "emphasis", *self.emphasis)
            rules = self.rules(result.graph, result.names)
            compared += verification.compare_commute(result, emphasis, self.share, rules)
        if result.game is None:
            return compared
        return [*compared, *verification.compare_game(result.game)]

    @property
    def guards(self) -> bool:
        """`True` if there are attacks."""
        return self.attack_time is not None or self.attack_times is not None

    @property
    def unit(self) -> float:
        """The unit of time: a step, or with a speed, the unit in seconds."""
        return 1.0 if self.time_unit is None else self.time_unit

    def times(self, graph: "optimize.Graph") -> Any:
        """Return the travel time of each edge in units of `time_unit`; `None` without a speed."""
        if self.speed is None:
            return None
        return patrol.team.whole_times(graph, self.speed, self.unit)

    def attack(self, names: Sequence[str]) -> "np.ndarray":
        """Return the durations of attacks in steps or, with a speed, in units of `time_unit`."""
        import numpy as np

        times = np.asarray(self._attack_times(names))
        return np.floor(times / self.unit + 1e-9).astype(np.int64)

    def _attack_times(self, names: Sequence[str]) -> Any:
        """Return the durations of attacks in steps or, with a speed, in seconds."""
        if self.attack_times is None:
            return self.attack_time
        return patrol.files.load_values(self.attack_times, names, whole=self.speed is None)

    def rules(self, graph: "optimize.Graph", names: Sequence[str]) -> "list[optimize.Linear]":
        """Read the constraints on the walk, if there are any."""
        file = self.constraints
        return [] if file is None else patrol.walks.load_constraints(file, graph, names)

    def vertices(self, names: Sequence[str], parameter: str, *wanted: Vertex) -> list[int]:
        """Return the index in `names` of each vertex in `wanted`. Errors name `parameter`."""
        texts = [str(name) for name in wanted]
        for name in texts:
            if name not in names:
                listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
                meant = did_you_mean(name, names) or f"; there are {listed}"
                raise ValueError(f"{parameter}: there is no vertex {name!r}{meant}")
        return [names.index(name) for name in texts]

    def _check(self, graph: "optimize.Graph", names: Sequence[str]) -> None:
        """Raise if the graph does not suit the parameters, or if an attack is too short."""
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
            self.check_reach(graph, names, 1 if self.division == "shared" else self.robots)
        self.vertices(names, "emphasis", *self.emphasis)
        for parameter, vertex in (("base", self.base), ("charger", self.charger)):
            if vertex is not None:
                self.vertices(names, parameter, vertex)

    def check_reach(self, graph: "optimize.Graph", names: Sequence[str], robots: int) -> None:
        """Raise if robots are too slow for the graph or, in a team, for their parts of it."""
        from ...patrol.walks import arrival

        if self.strategy != "capture":
            return
        numbers = arrival.whole_numbers(graph, self.attack(names), self.times(graph))
        try:
            if robots == 1:
                arrival.check_reach(*numbers, names, self.unit)
            elif arrival.out_of_reach(*numbers) is not None:
                arrival.parts_within_reach(graph, *numbers, robots, names, self.unit)
        except ValueError as error:
            finer = ""
            if self.speed is not None:
                finer = (
                    f", or a smaller `time_unit`; times are rounded to units of {self.unit:.4g} s"
                )
            raise ValueError(
                f"{error}{finer}; with a shared clock, `jaxcell patrol guard` finds rounds"
            ) from None

    def _rounded_up(self, graph: "optimize.Graph") -> float:
        """Return the largest time in seconds by which the travel time of an edge is rounded up."""
        if self.speed is None:
            return 0.0
        return float((self.unit * self.times(graph) - graph.lengths / self.speed).max())

    def _game(
        self, graph: "optimize.Graph", names: Sequence[str], beside: Secondary, say: Say
    ) -> Any:
        if not self.game:
            return None
        say("mixing strategies")
        stakes = None if self.values is None else patrol.files.load_stakes(self.values, names)
        emphasis = self.vertices(names, "emphasis", *self.emphasis) or None
        return beside.compute(
            "the game",
            lambda: patrol.strategy_game(
                graph, emphasis, self.share, paths=self.paths, names=names, stakes=stakes
            ),
        )

    def _walks_with_memory(
        self, patrolled: "patrol.GraphPatrol", beside: Secondary, say: Say
    ) -> Any:
        if self.memory_states == 1:
            return None
        return beside.compute(
            "the search for walks with memory",
            lambda: patrol.walks.memory_patrol(
                patrolled.graph,
                self.attack(patrolled.names),
                self.memory_states,
                patrolled.matrices,
                travel_times=self.times(patrolled.graph),
                names=patrolled.names,
                say=say,
            ),
        )

    def _round(self, patrolled: "patrol.GraphPatrol", beside: Secondary) -> Any:
        import numpy as np

        if self.robots == 1 and not self.guards:
            return None
        # A round needs no whole times.
        exact = None
        if self.speed is not None:
            exact = np.maximum(patrolled.graph.lengths / self.speed, _BRIEFEST)
        return beside.compute(
            "the evenly spaced round",
            lambda: patrol.team.evenly_spaced_round(
                patrolled.graph,
                self.robots,
                self._attack_times(patrolled.names),
                travel_times=exact,
                unit=None if exact is None else 1.0,
                names=patrolled.names,
            ),
        )

    def _timed(self, patrolled: "patrol.GraphPatrol", beside: Secondary) -> Any:
        if self.speed is None:
            return None
        seconds = self.unit * self.times(patrolled.graph)
        walks = patrolled.matrices, patrolled.shares
        return beside.compute(
            "the table of times in seconds",
            lambda: patrol.team.timed(patrolled.graph, *walks, seconds, self.unit),
        )

    def _news(self, patrolled: "patrol.GraphPatrol", beside: Secondary, say: Say) -> Any:
        if self.base is None:
            return None
        say("following news")
        (base,) = self.vertices(patrolled.names, "base", self.base)
        return beside.compute(
            "the age of news",
            lambda: patrol.team.age_of_news(
                patrolled.graph,
                patrolled.matrices,
                base,
                times=self.times(patrolled.graph),
                unit=self.unit,
                names=patrolled.names,
            ),
        )

    def _charged(self, patrolled: "patrol.GraphPatrol", beside: Secondary, say: Say) -> Any:
        if self.charger is None or self.every is None:
            return None
        (charger,) = self.vertices(patrolled.names, "charger", self.charger)
        walk = patrolled.graph, patrolled.matrices, charger, self.every
        what, names = "the walk that returns to the charger", patrolled.names
        if self.attack_time is None:
            return beside.compute(what, lambda: patrol.team.charged(*walk, names=names))
        say("seeking a walk that is back at the charger in time")
        options: Any = {"attack_time": self.attack_time, "seed": self.seed, "names": names}
        return beside.compute(what, lambda: patrol.walks.charged_capture(*walk, **options))

    def _idleness(self, patrolled: "patrol.GraphPatrol", beside: Secondary, say: Say) -> Any:
        if not self.baselines:
            return None
        say("simulating patrols")
        times = self.times(patrolled.graph)
        return beside.compute(
            "the simulation of patrols",
            lambda: patrol.team.simulate_idleness(
                patrolled.graph,
                patrolled.walks,
                times=None if times is None else times * self.unit,
                attack_time=self.attack_time,
                seed=self.seed,
            ),
        )
