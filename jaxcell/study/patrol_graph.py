import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import tyro

from ..base.limits import MAX_VERTICES
from .study import Say, Study, require, silent


if TYPE_CHECKING:
    from ..optimize import Graph, Linear
    from ..patrol import GraphPatrol
    from ..verify import Comparison


@dataclasses.dataclass(frozen=True, kw_only=True)
class PatrolGraph(Study):
    """Find a random walk with which to patrol a graph, and play against an adversary."""

    name: ClassVar[str] = "patrol"

    file: tyro.conf.Positional[Path]
    """Graph file: node-link .json, .graphml, .gml, .adjlist, or a list of vertices and edges .edges
    or .txt. Vertices may have no positions; edges are then alike."""
    strategy: Literal[
        "commute", "toward", "mixing", "kemeny", "entropy", "return-time", "capture"
    ] = "commute"
    """What the walk is for: a short time there and back (commute), --vertex (toward), forgetting
    its start (mixing), a short time to any vertex (kemeny), steps that are hard to guess (entropy),
    returns that are (return-time), or capture within --attack-time (capture). For mixing, kemeny
    and return-time it spends the same time at all vertices, and may wait."""
    emphasis: tuple[str, ...] = ()
    """Two or more vertices to visit more often, for "commute" and the game."""
    share: float = 0.8
    """Least share of steps on the shortest closed tour through them."""
    constraints: Path | None = None
    """JSON file of bounds on the shares of steps along edges and of time at vertices, for
    "commute": {"constraints": [{"edges": [["a", "b"]], "most": 0.2}]}."""
    vertex: str | None = None
    """The vertex that "toward" is toward."""
    paths: int = 1
    """Shortest paths from each vertex that lead there, for "toward" and the game; along 1, as in
    the dissertation's table, the walk goes straight there."""
    attack_time: int | None = None
    """Steps that an attack takes, for "capture"."""
    robots: int = 1
    """How many patrollers walk, each by itself: what the first of them does is reported."""
    attack_times: Path | None = None
    """File of a line "vertex steps" for each vertex: the steps that an attack on it takes, for
    "capture"."""
    visits: Path | None = None
    """File of a line "vertex share" for each vertex: how often the walk is there, relative to the
    others, for mixing, kemeny, entropy and return-time."""
    values: Path | None = None
    """File of a line "vertex value" for each vertex, what its goods are worth in the game; or
    "vertex value value reward cost": what they are worth to the patroller and to the adversary, and
    what the patroller that catches the adversary there gains, and the adversary pays."""
    game: bool = False
    """Also mix the walks toward each vertex and "commute", against an adversary who knows it."""
    seed: int = 0
    """Seed of the walk that is recorded."""

    def __post_init__(self) -> None:
        require("share", self.share, "0 to 1", lambda x: 0 <= x <= 1)
        require("paths", self.paths, "at least 1", lambda x: x >= 1)
        require("robots", self.robots, "at least 1", lambda x: x >= 1)
        if self.emphasis and not (self.strategy == "commute" or self.game):
            raise ValueError(f"emphasis has no meaning for {self.strategy!r} without a game")
        if len(self.emphasis) == 1:
            raise ValueError("emphasis: expected two or more vertices, got one")
        for i, name in enumerate(self.emphasis):
            if name in self.emphasis[:i]:
                raise ValueError(f"emphasis: vertex {name!r} comes twice")
        if self.attack_times is not None and self.attack_time is not None:
            raise ValueError("attack_times: expected either this file or one attack_time, got both")
        if self.values is not None and not self.game:
            raise ValueError("values has no meaning without a game")
        prescribed = ("mixing", "kemeny", "entropy", "return-time")
        if self.visits is not None and self.strategy not in prescribed:
            raise ValueError(f"visits has no meaning for {self.strategy!r}")
        if self.constraints is not None and self.strategy != "commute":
            raise ValueError(f"constraints has no meaning for {self.strategy!r}")
        if self.attack_times is not None and self.strategy != "capture":
            raise ValueError(f"attack_times has no meaning for {self.strategy!r}")
        for parameter, strategy in (("vertex", "toward"), ("attack_time", "capture")):
            given, wanted = getattr(self, parameter) is not None, self.strategy == strategy
            wanted = wanted and (parameter != "attack_time" or self.attack_times is None)
            if given and not wanted:
                raise ValueError(f"{parameter} has no meaning for {self.strategy!r}")
            if wanted and not given:
                raise ValueError(f"{parameter}: {strategy!r} needs it")

    def memory(self) -> float | int:
        from ..base import memory
        from ..patrol import load_graph
        from ..space import estimates

        graph, _ = load_graph(self.file)
        weighted = self.strategy == "commute" or self.game
        needed = estimates.walk(graph.vertices, len(graph.edges), weighted)
        doing = f"a walk on {graph.vertices:,} vertices and {len(graph.edges):,} edges"
        memory.check(needed, doing, "expected a smaller graph, or another strategy")
        return needed

    def run(self, say: Say = silent) -> "GraphPatrol":
        from ..patrol import GraphPatrol, has_weights, load_graph, load_stakes, strategy_game

        graph, names = load_graph(self.file)
        self._check(graph, names)
        emphasis = self._vertices(names, "emphasis", *self.emphasis) or None
        say(f"seeking a walk on {graph.vertices:,} vertices")
        walk, game = self._walk(graph, names, emphasis), None
        if self.game:
            say("mixing strategies")
            stakes = None if self.values is None else load_stakes(self.values, names)
            game = strategy_game(
                graph, emphasis, self.share, paths=self.paths, names=names, stakes=stakes
            )
        options: dict[str, Any] = {"names": names, "robots": self.robots, "seed": self.seed}
        options["weights_unused"] = has_weights(self.file)
        return GraphPatrol.of(graph, **walk, game=game, **options)

    def heading(self, spec: dict[str, Any]) -> str:
        return f"{self.file}: {self.strategy}"

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..verify import compare_commute, compare_game, compare_walk

        found = compare_walk(result)
        if self.strategy == "commute":
            emphasis = self._vertices(result.names, "emphasis", *self.emphasis)
            rules = self._constraints(result.graph, result.names)
            found += compare_commute(result, emphasis, self.share, rules)
        return found if result.game is None else [*found, *compare_game(result.game)]

    def _check(self, graph: "Graph", names: Sequence[str]) -> None:
        """Refuse a graph that is too large or not connected, and an attack that is too short."""
        import numpy as np
        from scipy.sparse.csgraph import shortest_path

        if graph.vertices > MAX_VERTICES:
            raise ValueError(
                f"{self.file}: it has {graph.vertices:,} vertices; the times between all pairs are "
                f"computed for at most {MAX_VERTICES:,}"
            )
        hops = shortest_path(graph.matrix(np.ones(len(graph.edges))), unweighted=True)
        apart = np.flatnonzero(np.isinf(hops[0]))
        if apart.size:
            raise ValueError(
                f"{self.file}: no walk leads from vertex {names[0]!r} to {names[apart[0]]!r}; "
                "expected a connected graph"
            )
        # To a vertex and back it takes two steps.
        np.fill_diagonal(hops, 2)
        if self.attack_time is not None and self.attack_time < hops.max():
            start, end = (names[v] for v in np.unravel_index(hops.argmax(), hops.shape))
            raise ValueError(
                f"attack_time: {self.attack_time} steps are over before a patroller comes from "
                f"vertex {start!r} to {end!r}, which takes {hops.max():g}"
            )

    def _constraints(self, graph: "Graph", names: Sequence[str]) -> "list[Linear]":
        from ..patrol import load_constraints

        return [] if self.constraints is None else load_constraints(self.constraints, graph, names)

    def _vertices(self, names: Sequence[str], parameter: str, *wanted: str) -> list[int]:
        """The numbers of vertices that a parameter names."""
        for name in wanted:
            if name not in names:
                listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
                raise ValueError(f"{parameter}: there is no vertex {name!r}; there are {listed}")
        return [names.index(name) for name in wanted]

    def _walk(
        self, graph: "Graph", names: Sequence[str], emphasis: list[int] | None
    ) -> dict[str, Any]:
        """The chain that the strategy finds, with its certificate, goal and value."""
        import numpy as np

        from .. import optimize, patrol

        if self.strategy == "toward":
            (vertex,) = self._vertices(names, "vertex", str(self.vertex))
            return {"chain": patrol.toward(graph, vertex, self.paths)}
        # Without given shares of time, the best walks leave some vertices out.
        even = np.full(graph.vertices, 1 / graph.vertices)
        visits = None
        if self.visits is not None:
            visits = patrol.load_values(self.visits, names)
            visits = even = visits / visits.sum()
        best: Any
        times: Any = None
        goal = {
            "return-time": "return-time entropy, in nats",
            "capture": f"least chance that {_who(self.robots)} captures within "
            + ("its attack time" if self.attack_time is None else f"{self.attack_time} steps"),
        }.get(self.strategy)
        bounds = None
        if self.strategy == "commute":
            rules = self._constraints(graph, names)
            best = optimize.minimum_commute(graph, emphasis, self.share, constraints=rules)
            chain = patrol.random_walk(graph, best.weights)
            if rules:
                bounds = patrol.MetConstraints(rules, best.weights, best.prices)
        elif self.strategy == "capture":
            times = self.attack_time
            if self.attack_times is not None:
                times = patrol.load_values(self.attack_times, names, whole=True).astype(np.int64)
            best = patrol.maximin_capture(graph, times, throw=False)
            chain = best.chains[0]
        else:
            seek: Any = {
                "mixing": lambda: optimize.fastest_mixing(graph, even),
                "kemeny": lambda: patrol.minimum_kemeny(graph, even, stay=True, throw=False),
                "entropy": lambda: patrol.maximum_entropy_rate(
                    graph, visits, stay=visits is not None
                ),
                "return-time": lambda: patrol.maximum_return_time_entropy(
                    graph, even, stay=True, throw=False
                ),
            }[self.strategy]
            best = seek()
            chain = best.chain
        value = None if goal is None else best.value
        if self.strategy == "capture":
            # Those that walk alike, each wherever it is worst.
            value = 1 - (1 - best.value) ** self.robots
        return {
            "attack_time": times,
            "bounds": bounds,
            "chain": chain,
            "certificate": best.certificate,
            "goal": goal,
            "value": value,
            "local": self.strategy in ("kemeny", "return-time", "capture"),
        }


def _who(robots: int) -> str:
    return "one patroller" if robots == 1 else f"one of {robots} patrollers"
